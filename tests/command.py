"""`sweepid` as its console script runs it, but in the test's own process: libraries are loaded once, not once a call.

`tests/unit/service/cli/test_cli_main.py` shows that the script itself leaves with such codes and words.
"""

import io
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from subprocess import CompletedProcess

from service.cli import main

SWEEPID = str(Path(sys.executable).with_name("sweepid"))


def console(*arguments: str, stdin: str = "", **environment: str) -> CompletedProcess[str]:
    """The console script itself, in a process of its own: for what belongs to all of a process."""
    command, around = [SWEEPID, *arguments], os.environ | environment
    return subprocess.run(command, input=stdin, capture_output=True, text=True, check=False, env=around)


def carried_out(*arguments: str) -> str:
    """What a command that succeeds writes to stdout."""
    done = sweepid(*arguments)
    assert done.returncode == 0, done.stderr
    return done.stdout


def refused(*arguments: str, code: int = 2) -> str:
    """What a command that is refused writes to stderr; to stdout it writes nothing."""
    done = sweepid(*arguments)
    assert (done.returncode, done.stdout) == (code, ""), done.stderr
    return done.stderr


def sweepid(*arguments: str, stdin: str = "") -> CompletedProcess[str]:
    """Exit code, stdout and stderr of a command that ends by itself."""
    given, out, err = (sys.argv, sys.stdin), io.StringIO(), io.StringIO()
    sys.argv, sys.stdin = ["sweepid", *arguments], io.StringIO(stdin)
    try:
        with redirect_stdout(out), redirect_stderr(err):
            main()
        code: object = 0
    except SystemExit as left:
        code = left.code
    finally:
        sys.argv, sys.stdin = given
    return CompletedProcess(
        sys.argv, code if isinstance(code, int) else int(code is not None), out.getvalue(), err.getvalue()
    )
