"""Children that read cases, watched: what they tell, and in which case they die."""

import os
import signal
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Timer
from typing import IO

from tests.fuzz.case import KNOWN, Case, keep, kept, make, read
from tests.fuzz.child import TIME, read_all

KEPT = 20  # cases of a kind whose files are written
HUNG = 600.0  # s without a word: it waits for something; what takes CPU time, its own limit ends


@dataclass
class Tally:
    """Of one parser."""

    outcomes: Counter[str] = field(default_factory=Counter)
    findings: dict[str, list[Path]] = field(default_factory=dict[str, list[Path]])  # by kind, as far as they are kept
    found: int = 0
    cpu: float = 0.0  # s
    slowest: tuple[float, int] = (0.0, -1)  # s, number
    largest: tuple[int, int] = (0, -1)  # bytes more in memory than ever before, number

    @property
    def cases(self) -> int:
        return sum(self.outcomes.values())


Progress = Callable[[Tally], None]


def fuzz(parser: str, seed: int, cpu: float, least: int, findings: Path, progress: Progress) -> Tally:
    """Cases from number 0 on, until their CPU time is over and at least so many were read."""
    tally, number = Tally(), 0
    chosen = list(KNOWN[parser].seeds())
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        for one in chosen:  # loads what is loaded late; and a seed is to be readable
            read(Case(parser, 0, 0, one.entry, one.files), Path(folder))
    case = partial(make, parser, chosen, seed)
    while tally.cpu < cpu or number < least:
        number = _child(case, number, least - number, cpu - tally.cpu, findings, tally, progress) + 1
    return tally


def repeat(file: Path) -> Tally:
    """The case of a finding's file alone."""
    case, tally = kept(file), Tally()
    _child(lambda _: case, case.number, 1, 0.0, None, tally, lambda *_: None)
    return tally


def _child(
    case: Callable[[int], Case],
    number: int,
    least: int,
    cpu: float,
    findings: Path | None,
    tally: Tally,
    progress: Progress,
) -> int:
    """One process, until its time is over or it dies; the last number that it began."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder, tempfile.TemporaryFile() as errors:
        ours, theirs = os.pipe()
        child = os.fork()  # with all libraries loaded, which takes seconds
        if child == 0:
            code = 1
            try:
                with os.fdopen(theirs, "w", buffering=1) as told:
                    read_all(case, number, least, cpu, Path(folder), told, errors.fileno())
                code = 0
            except BaseException:
                os.write(2, traceback.format_exc().encode("ascii", "replace"))
                raise
            finally:
                os._exit(code)
        os.close(theirs)
        open_case: int | None = None
        with os.fdopen(ours) as lines:
            while line := _line(lines, child):
                word, at, *rest = line.rstrip("\n").split(" ", 2)
                number = int(at)
                if word == "begin":
                    open_case = number
                elif word == "found":
                    _found(case(number), rest[0], findings, tally)
                else:
                    open_case = None
                    outcome, seconds, grown = rest[0].split()
                    tally.outcomes[outcome] += 1
                    tally.slowest = max(tally.slowest, (float(seconds), number))
                    tally.largest = max(tally.largest, (int(grown), number))
                    progress(tally)
        _, status, used = os.wait4(child, 0)
        code = os.waitstatus_to_exitcode(status)
        tally.cpu += used.ru_utime + used.ru_stime
        errors.seek(0)
        words = errors.read().decode("ascii", "replace")
        if findings is None:
            sys.stderr.write(words)
        if open_case is not None:
            tally.outcomes["death"] += 1
            _found(case(open_case), f"death {_ended(code)}", findings, tally)
        elif code:
            raise RuntimeError(f"a child ended with {code} outside of a case\n{words[-4000:]}")
    return number


def _line(lines: IO[str], child: int) -> str:
    hung = Timer(HUNG, os.kill, (child, signal.SIGKILL))
    hung.start()
    try:
        return lines.readline()
    finally:
        hung.cancel()


def _found(case: Case, what: str, findings: Path | None, tally: Tally) -> None:
    """Keep the first `KEPT` of a kind: same place, same error."""
    tally.found += 1
    kept_of_kind = tally.findings.setdefault(" ".join(what.split()[:2]), [])
    if findings is not None and len(kept_of_kind) < KEPT:
        kept_of_kind.append(keep(case, what, findings))


def _ended(code: int) -> str:
    if code == -signal.SIGPROF:
        return f"more than {TIME:g} s of CPU"
    return signal.Signals(-code).name if code < 0 else f"exit code {code}"
