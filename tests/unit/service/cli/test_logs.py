"""What is held back of a start's log, in a process of its own: logging belongs to all of a process."""

import subprocess
import sys

import pytest

START = """
import logging
from service.cli.server import HeldBack
from service.process.logs import configure_logs
configure_logs("INFO")
held = HeldBack()
log = logging.getLogger("start")
log.info("before")
{ends}
log.info("after")
held.let_through()
log.info("last")
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ends", "written"),
    [
        pytest.param("", ["before", "after", "last"], id="it starts"),
        pytest.param("held.drop()", [], id="it fails for a known reason, and what is closed after it speaks too"),
        pytest.param("held.let_through()", ["before", "after", "last"], id="it runs"),
    ],
)
def test_what_is_written_of_a_start(ends: str, written: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-c", START.format(ends=ends)], capture_output=True, text=True, timeout=120, check=True
    )
    assert [word for word in ("before", "after", "last") if f'"{word}"' in done.stderr] == written, done.stderr
    assert done.stderr.count("\n") == len(written)
