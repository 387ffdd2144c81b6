"""On a terminal a command that takes its time says so on stderr, and nowhere else."""

import os
import pty
import subprocess
from pathlib import Path

import pytest

from service.cli.progress_indicator import waiting
from tests.command import SWEEPID
from tests.unit.service.cli.test_identify import bundle

pytestmark = pytest.mark.slow

__all__ = ["bundle"]  # the fixture


def on_a_terminal(*arguments: str) -> tuple[int, str, str]:
    """Exit code, stdout, and what a terminal at stderr was shown."""
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        [SWEEPID, *arguments], stdout=subprocess.PIPE, stderr=theirs, env=os.environ | {"TERM": "xterm"}
    ) as process:
        os.close(theirs)
        shown = b""
        try:
            while piece := os.read(ours, 4096):
                shown += piece
        except OSError:  # the other side is closed
            pass
        out = process.stdout.read() if process.stdout else b""
    os.close(ours)
    return process.returncode, out.decode(), shown.decode()


@pytest.mark.parametrize(
    ("command", "line"),
    [("check", "checking the data"), ("diagnose", "diagnosing"), ("identify", "reading the bundle")],
)
def test_a_terminal_shows_what_is_waited_for(bundle: Path, command: str, line: str) -> None:
    code, out, shown = on_a_terminal(command, str(bundle), "--json", "-")
    assert (code, out[:1]) == (0, "{"), shown
    assert line in shown
    assert line not in out


def test_one_in_another_shows_one_line() -> None:
    with waiting("all of it"), waiting("a part"):
        pass
