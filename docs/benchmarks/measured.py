"""What a benchmark gives, and how two sides are measured beside each other: A B A B, so that noise hits both."""

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

Mine = TypeVar("Mine")
Theirs = TypeVar("Theirs")


@dataclass(frozen=True, kw_only=True)
class Measured:
    """One line of the page. `peer` None: there is none, and `ratio` is None as well."""

    name: str
    unit: str  # of both
    ours: float
    peer: float | None = None
    beside: str = ""  # what the peer is
    less: bool = True  # is better
    repeats: int = 1
    spread: float = 0.0  # of ours: largest less least over the median
    target: str = ""
    met: bool | None = None
    note: str = ""

    @property
    def ratio(self) -> float | None:
        """How many times better ours is than the peer."""
        if self.peer is None:
            return None
        better, worse = (self.ours, self.peer) if self.less else (self.peer, self.ours)
        return worse / better if better else float("inf")


@dataclass(frozen=True)
class Timed(Generic[Mine, Theirs]):
    """s of each repeat of either side, and what the last ones gave."""

    ours: tuple[float, ...]
    peer: tuple[float, ...]
    mine: Mine
    theirs: Theirs

    def as_measured(
        self, name: str, beside: str, *, amount: float = 0.0, unit: str = "s", best: bool = False, note: str = ""
    ) -> Measured:
        """Seconds; with an `amount` that each repeat does, that by the second. `best` of all repeats, or the median."""
        centre = min if best else statistics.median
        ours, peer = centre(self.ours), centre(self.peer)
        return Measured(
            name=name,
            unit=unit,
            ours=amount / ours if amount else ours,
            peer=amount / peer if amount else peer,
            beside=beside,
            less=not amount,
            repeats=len(self.ours),
            spread=(max(self.ours) - min(self.ours)) / statistics.median(self.ours),
            note=note,
        )


def timed(work: Callable[[], Mine]) -> tuple[float, Mine]:
    """s of the processor, and what came of it."""
    began = time.process_time()
    result = work()
    return time.process_time() - began, result


def beside(
    ours: Callable[[], Mine], peer: Callable[[], Theirs], repeats: int, peer_repeats: int | None = None
) -> Timed[Mine, Theirs]:
    """Both, in turn; a slow peer may have fewer turns."""
    theirs = repeats if peer_repeats is None else peer_repeats
    mine: list[tuple[float, Mine]] = []
    others: list[tuple[float, Theirs]] = []
    for turn in range(max(repeats, theirs)):
        if turn < repeats:
            mine.append(timed(ours))
        if turn < theirs:
            others.append(timed(peer))
    return Timed(tuple(s for s, _ in mine), tuple(s for s, _ in others), mine[-1][1], others[-1][1])
