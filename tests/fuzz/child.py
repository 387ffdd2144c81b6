"""The process that reads many cases under limits. It tells a line each on the way that it is given:

``begin N``, then ``end N OUTCOME SECONDS BYTES``, before that ``found N WHAT`` where something is wrong. Where it dies,
the last line says in which case.
"""

import faulthandler
import os
import resource
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from itertools import count
from pathlib import Path
from time import process_time
from typing import TextIO

from tests.fuzz.case import Case, read

MEMORY = 2**30  # bytes of address space above what the process has when it begins
TIME = 20.0  # s of CPU a case, by a signal that ends the process


def read_all(
    case: Callable[[int], Case], first: int, least: int, cpu: float, folder: Path, told: TextIO, errors: int
) -> None:
    """Cases from the first number on until `cpu`, s, are over and `least` were read; stderr goes to `errors`."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for own, other in ((0, nowhere), (1, nowhere), (2, errors)):
        os.dup2(other, own)
    sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - what a command prints is not ours
    faulthandler.enable(2)
    warnings.simplefilter("ignore")
    _limit_memory()
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    end = process_time() + cpu
    for number in count(first):
        if process_time() >= end and number >= first + least:
            return
        _one(case(number), folder, told)


def _one(case: Case, folder: Path, told: TextIO) -> None:
    told.write(f"begin {case.number}\n")
    before, begun = _peak(), process_time()
    signal.setitimer(signal.ITIMER_PROF, TIME)
    try:
        outcome = read(case, folder)
    except Exception as error:  # noqa: BLE001 - whatever it is, it is the finding
        outcome = "finding"
        told.write(f"found {case.number} {_place(error)} {_words(error)}\n")
        os.write(2, "".join(traceback.format_exception(error, limit=-40)).encode("ascii", "replace"))
    signal.setitimer(signal.ITIMER_PROF, 0.0)
    told.write(f"end {case.number} {outcome} {process_time() - begun:.6f} {max(0, _peak() - before)}\n")


def _place(error: Exception) -> str:
    """The last line of ours that it went through."""
    frames = traceback.extract_tb(error.__traceback__)
    product = [f for f in frames if f.filename.startswith(tuple(f"{os.getcwd()}/{room}/" for room in _ROOMS))]
    last = (product or frames)[-1]
    return f"{Path(last.filename).name}:{last.lineno}"


def _words(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:300].encode("ascii", "replace").decode()


_ROOMS = ("service", "drivers", "simulator")


def _peak() -> int:
    """Bytes that this process, or one of those that it started, had in memory at most."""
    own, others = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return max(own, others) * 1024


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
    most = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
