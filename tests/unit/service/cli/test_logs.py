"""What is held back of a start's log, in processes of their own: logging belongs to all of a process."""

import subprocess
import sys

import pytest

STARTS = """
import logging, os, sys
from service.cli.server import HeldBack
from service.process.logs import configure_logs
for end in (None, HeldBack.drop, HeldBack.let_through):
    if os.fork() == 0:
        configure_logs("INFO")
        held = HeldBack()
        log = logging.getLogger("start")
        log.info("before")
        if end is not None:
            end(held)
        log.info("after")
        held.let_through()
        log.info("last")
        break
    assert os.wait()[1] == 0
    print("next", file=sys.stderr)
"""


@pytest.mark.slow
def test_what_is_written_of_a_start() -> None:
    """It starts; it fails for a known reason, and what is closed after it speaks too; it runs."""
    done = subprocess.run([sys.executable, "-c", STARTS], capture_output=True, text=True, timeout=120, check=True)
    starts, fails, runs, rest = done.stderr.split("next\n")
    assert (fails, rest) == ("", "")
    for written in (starts, runs):
        assert [word for word in ("before", "after", "last") if f'"{word}"' in written] == ["before", "after", "last"]
        assert written.count("\n") == 3
