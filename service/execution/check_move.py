"""The check move: a little way and back, before an axis does anything larger in a run of a campaign.

Whoever rewired a cabinet finds out here, at half a degree and half a degree a second, and not on the way to the first
pose. Watched while it goes, not only at its end: the axis goes the right way and no further than it was told, and every
other joint stands (brakes hold, nothing is coupled). What an axis' own encoder cannot tell is for a person to see, whom
the operator's page tells which axis goes which way: two drives that changed places motor, encoder and all, or a gear
ratio of the wrong sign, which turns command and position alike.
"""

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass

from drivers.errors import CommunicationLost
from drivers.ports import AxisState, AxisStatus
from service.errors import SweepidError
from service.execution.motion import Go

WAY = {"rad": math.radians(0.5), "m": 2e-3}  # by the joint's unit
DURATION = 1.0  # s one way: slow enough to be caught by a status every tenth of a second or so
ASTRAY = 0.1  # of the way: the wrong way, or another joint; encoder noise and play of a brake stay below
MISSED = 0.25  # of the way, at its end and beyond it: drives call a target reached within a window of their own

_POLL = 0.1  # s, in which it goes a twentieth of a degree; the drives' answers are needed by the move itself, too


class CheckMoveFailed(SweepidError):
    """An axis did not do what it was told, or another one moved with it. The machine was stopped."""


@dataclass(frozen=True, slots=True)
class CheckMove:
    """One way of it: `joint` by `way` rad (m), signed, from where all joints stood. Pure."""

    joint: str
    way: float
    start: Mapping[str, float]
    units: Mapping[str, str]  # by joint

    @property
    def target(self) -> float:
        return self.start[self.joint] + self.way

    def check_under_way(self, status: Mapping[str, AxisStatus]) -> None:
        """CheckMoveFailed where the axis goes the wrong way or too far, or another joint does not stand.

        CommunicationLost where a drive does not answer: nobody watches then.
        """
        for joint, axis in status.items():
            if axis.state is AxisState.UNKNOWN:
                raise CommunicationLost(f"{joint}: did not answer in the check move of {self.joint}")
            moved, unit = axis.position - self.start[joint], self.units[joint]
            limit = ASTRAY * WAY[unit]
            if joint != self.joint and not abs(moved) <= limit:
                raise CheckMoveFailed(
                    f"{joint}: moved by {moved:+.3g} {unit} in the check move of {self.joint}, limit {limit:.2g} {unit}"
                )
        forward = self._moved(status) * math.copysign(1.0, self.way)
        if not forward >= -ASTRAY * abs(self.way):
            raise self._failed(status, f"the wrong way; limit {-ASTRAY * self.way:+.2g}")
        if not forward <= (1 + MISSED) * abs(self.way):
            raise self._failed(status, f"limit {(1 + MISSED) * self.way:+.3g}")

    def check_end(self, status: Mapping[str, AxisStatus]) -> None:
        """CheckMoveFailed unless the axis is there, too."""
        self.check_under_way(status)
        if not abs(self._moved(status) - self.way) <= MISSED * abs(self.way):
            raise self._failed(status, f"not there; limit of the difference {MISSED * abs(self.way):.2g}")

    def _moved(self, status: Mapping[str, AxisStatus]) -> float:
        return status[self.joint].position - self.start[self.joint]

    def _failed(self, status: Mapping[str, AxisStatus], why: str) -> CheckMoveFailed:
        joint, unit, moved = self.joint, self.units[self.joint], self._moved(status)
        return CheckMoveFailed(
            f"{joint}: went {moved:+.3g} {unit} in its check move of {self.way:+.3g} {unit}: {why} {unit}"
        )


async def make(go: Go, move: CheckMove, status: Callable[[], Awaitable[Mapping[str, AxisStatus]]]) -> None:
    """Let the axis `go` that way, watching every joint by `status`; CheckMoveFailed or what the drive raises.

    After an error the move is over and its axis brought down, as `DrivePort.move_to` does when it is cancelled.
    """
    moving = asyncio.create_task(go(move.target), name=f"check {move.joint}")
    try:
        while not (await asyncio.wait([moving], timeout=_POLL))[0]:
            move.check_under_way(await status())
    except BaseException:
        moving.cancel()
        await asyncio.wait([moving])
        if not moving.cancelled():
            moving.exception()  # of the same trouble; what was seen here tells more
        raise
    moving.result()
    move.check_end(await status())
