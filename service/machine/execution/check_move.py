"""The check move: before any larger motion of an axis in a run of a campaign, a small one and back.

It detects wiring errors at half a degree and half a degree per second. It is monitored during the move, not only at its
end: the axis moves in the commanded direction and not too far, and every other joint stands (brakes hold, no coupling).
Errors that the encoder of the axis cannot detect must be seen by a person, to whom the operator's page shows which axis
moves in which direction: two drives exchanged together with motor and encoder, or a gear ratio with the wrong sign,
which inverts command and position alike.
"""

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

from drivers.errors import CauseCode, CommunicationLost, Measured, distinct
from drivers.ports import AxisState, AxisStatus
from service import MotionFailed
from service.machine.execution.motion import Go

WAY = {"rad": math.radians(0.5), "m": 2e-3}  # by the joint's unit
DURATION = 1.0  # s in one direction: slow enough to be monitored by a status every 0.1 s


class CheckMoveFailed(MotionFailed, code=CauseCode.CHECK_MOVE_FAILED):
    """An axis did not move as commanded, or another axis moved. The machine was stopped."""


@dataclass(frozen=True, slots=True)
class CheckMove:
    """One direction of it: `joint` by `way` rad (m), signed, from the positions of all joints at its start. Pure."""

    # of the travel: wrong direction, or another joint; encoder noise and play of a brake stay below
    astray: ClassVar[float] = 0.1
    # of the travel, before and after the target: drives have a position window of their own
    missed: ClassVar[float] = 0.25

    joint: str
    way: float
    start: Mapping[str, float]
    units: Mapping[str, str]  # by joint

    @property
    def target(self) -> float:
        return self.start[self.joint] + self.way

    def check_under_way(self, status: Mapping[str, AxisStatus]) -> None:
        """CheckMoveFailed if the axis moves in the wrong direction or too far, or if another joint moves.

        CommunicationLost if a drive does not answer, because it cannot be monitored then.
        """
        for joint, axis in status.items():
            if axis.state is AxisState.UNKNOWN:
                raise CommunicationLost(joint, f"did not answer in the check move of {self.joint}")
            moved, unit = axis.position - self.start[joint], self.units[joint]
            limit = self.astray * WAY[unit]
            if joint != self.joint and not abs(moved) <= limit:
                way, most = distinct(abs(moved), limit, digits=2)
                raise CheckMoveFailed(
                    joint,
                    f"moved by {'-' if moved < 0 else '+'}{way} {unit} in the check move of {self.joint}, "
                    f"limit {most} {unit}",
                    measured=Measured(abs(moved), limit, unit),
                )
        forward = self._moved(status) * math.copysign(1.0, self.way)
        if not forward >= -self.astray * abs(self.way):
            raise self._failed(status, "wrong direction; limit", -self.astray * self.way)
        if not forward <= (1 + self.missed) * abs(self.way):
            raise self._failed(status, "limit", (1 + self.missed) * self.way)

    def check_end(self, status: Mapping[str, AxisStatus]) -> None:
        """CheckMoveFailed unless the axis is also at its target."""
        self.check_under_way(status)
        if not abs(self._moved(status) - self.way) <= self.missed * abs(self.way):  # too far is told above
            raise self._failed(status, "target not reached; limit", (1 - self.missed) * self.way)

    def _moved(self, status: Mapping[str, AxisStatus]) -> float:
        return status[self.joint].position - self.start[self.joint]

    def _failed(self, status: Mapping[str, AxisStatus], why: str, limit: float) -> CheckMoveFailed:
        joint, unit = self.joint, self.units[self.joint]
        shown = distinct(self._moved(status), limit, digits=3)
        moved, most = (each if each.startswith("-") else f"+{each}" for each in shown)
        return CheckMoveFailed(
            joint,
            f"moved by {moved} {unit} in its check move of {self.way:+.3g} {unit}: {why} {most} {unit}",
            measured=Measured(self._moved(status), limit, unit),
        )


async def make(go: Go, move: CheckMove, status: Callable[[], Awaitable[Mapping[str, AxisStatus]]]) -> None:
    """Move the axis with `go`, and monitor every joint by `status`. Raises CheckMoveFailed or the error of the drive.

    After an error the move has ended and its axis is stopped, as in a cancelled `DrivePort.move_to`.
    """
    moving = asyncio.create_task(go(move.target), name=f"check {move.joint}")
    try:
        while not (await asyncio.wait([moving], timeout=0.1))[0]:  # s, in which it moves 0.05 degrees
            move.check_under_way(await status())
    except BaseException:
        moving.cancel()
        await asyncio.wait([moving])
        if not moving.cancelled():
            moving.exception()  # same cause; the error raised here has more detail
        raise
    moving.result()
    move.check_end(await status())
