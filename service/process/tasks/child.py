"""A process beside the service gives way to the one that streams set-points."""

import os
import sys

_NICE = 10


def give_way(process: int = 0) -> None:
    """Give a process (by its id, 0: this one) a lower priority than that of the service."""
    if sys.platform != "win32":
        present = os.getpriority(os.PRIO_PROCESS, process)  # to raise it again is not permitted
        os.setpriority(os.PRIO_PROCESS, process, max(present, _NICE))
