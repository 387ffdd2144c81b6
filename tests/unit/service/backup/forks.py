"""``python -m tests.unit.service.backup.forks``: commands in forks of one process, which has loaded all once.

Each line on stdin is a JSON object: ``words`` of a command, and how it is to end. ``limit``: it can write files of so
many bytes. ``killed``: it is run again and again, `N` in all words the number of the run, and run N is killed (SIGKILL)
at the N-th file or folder with this word in its path, until one is not. Each line on stdout is one: ``ended``, the exit
code of each run as `os.waitstatus_to_exitcode` has it, ``out`` and ``err``, what the last one wrote.
"""

import json
import os
import resource
import signal
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import service.cli.database
import service.store.back_up  # noqa: F401  once, not once a run
from service.cli import main

_NAMED = {"open", "os.mkdir", "os.rename", "os.rmdir", "sqlite3.connect", "shutil.rmtree"}


def die_at(number: int, mark: str) -> None:
    """Be killed where this process names the `number`-th file with `mark` in its path."""
    met: set[tuple[str, str]] = set()

    def see(event: str, arguments: tuple[object, ...]) -> None:
        if event in _NAMED and mark in str(arguments[0]):
            met.add((event, str(arguments[0])))
            if len(met) == number:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(see)


def run(order: dict[str, Any], number: int, said: Path) -> int:
    """How the run ended."""
    child = os.fork()
    if not child:
        for name, descriptor in (("out", 1), ("err", 2)):
            os.dup2(os.open(said / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), descriptor)
        if "limit" in order:
            resource.setrlimit(resource.RLIMIT_FSIZE, (order["limit"], order["limit"]))
        if "killed" in order:
            die_at(number, order["killed"].replace("N", str(number)))
        sys.argv = ["sweepid", *(word.replace("N", str(number)) for word in order["words"])]
        code: object = 1
        try:
            main()
        except SystemExit as left:
            code = left.code
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code if isinstance(code, int) else int(code is not None))
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def serve() -> None:
    """Until stdin ends."""
    for line in sys.stdin:
        order, ended = json.loads(line), list[int]()
        with TemporaryDirectory() as folder:
            while not ended or ("killed" in order and ended[-1] < 0):
                ended.append(run(order, len(ended) + 1, Path(folder)))
            said = {name: Path(folder, name).read_text("utf-8") for name in ("out", "err")}
        print(json.dumps({"ended": ended, **said}), flush=True)


if __name__ == "__main__":
    serve()
