"""The service's end of the stop process."""

import signal
import sys
from pathlib import Path

import pytest

from service.stop_process.handle import StopProcess

pytestmark = pytest.mark.slow


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no wake-up descriptor for signals")
def test_signals_are_told_to_no_closed_pipe(root: Path) -> None:
    with StopProcess(root / "config" / "drives" / "virtual-max100.yaml", "127.0.0.1", 0) as process:
        process.watch_signals()
        watched = signal.set_wakeup_fd(-1)
        assert watched >= 0
        process.watch_signals()
    assert signal.set_wakeup_fd(-1) == -1
