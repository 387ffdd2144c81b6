"""The service's end of the stop process."""

import os
import signal
import sys
from pathlib import Path

import pytest

from service.stop_process.handle import StopProcess
from tests.system.rest_bench import until

pytestmark = pytest.mark.slow


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no wake-up descriptor for signals")
def test_signals_are_told_to_no_closed_pipe(root: Path) -> None:
    with StopProcess(root / "config" / "drives" / "virtual-max100.yaml", "127.0.0.1", 0) as process:
        process.watch_signals()
        watched = signal.set_wakeup_fd(-1)
        assert watched >= 0
        process.watch_signals()
    assert signal.set_wakeup_fd(-1) == -1


@pytest.mark.skipif(sys.platform == "win32", reason="Windows cannot suspend a process by a signal")
def test_a_stop_process_that_hangs_is_missed_until_it_goes_on(root: Path) -> None:
    with StopProcess(root / "config" / "drives" / "virtual-max100.yaml", "127.0.0.1", 0) as process:
        assert process.failed == ""
        os.kill(process.pid, signal.SIGSTOP)
        until(lambda: "the stop process has not answered for" in process.failed, "it is missed")
        assert process.trouble == process.failed
        os.kill(process.pid, signal.SIGCONT)
        until(lambda: process.failed == "", "it is there again")
