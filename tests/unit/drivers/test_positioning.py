"""The end of a move: the axis stands, also where its controller overshoots; its time is judged by its progress."""

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field

import pytest

from drivers.cia402.device import Feedback
from drivers.cia402.motions import move
from drivers.cia402.states import Statusword
from drivers.errors import DriveError
from tests.unit.drivers.small_servo import Servo, connected, machine

TAIL = (0.2, 5e-4, -1.5e-3, -1.2e-3, -4e-4)  # rad/s at consecutive readings; 1e-3 is standstill


class Overshooting(Servo):
    """Reports its target as reached from the start of the move; the speed passes through zero and comes back."""

    _tail: Iterator[float] = iter(())
    last = 0.0

    def set_target(self, position: float, velocity: float) -> None:
        self._tail = iter(TAIL)

    def statusword(self) -> int:
        return super().statusword() | Statusword.TARGET_REACHED

    def motion(self) -> Feedback:
        self.last = next(self._tail, 0.0)
        return Feedback(0.0, self.last, 0.0)


@pytest.mark.parametrize("moves", [1, 3])
async def test_a_move_ends_when_the_overshoot_is_over(moves: int) -> None:
    servo = Overshooting("joint_1")
    async with connected(servo) as (port, _):
        await port.enable("joint_1")
        for _ in range(moves):
            await port.move_to("joint_1", 0.0, 0.5)  # the next move is refused as long as the axis moves
            assert servo.last == 0.0


@dataclass
class Drive(Servo):
    """Reports these positions, rad, one after the other, and then the last; half a second of the host's clock each."""

    positions: Iterator[float] = field(default_factory=lambda: iter(()))
    position: float = 0.0
    time: float = 0.0
    gap: float = 0.0  # s for which the host is suspended when the axis gets there

    def statusword(self) -> int:
        return super().statusword() | (Statusword.TARGET_REACHED if self.position == 0.1 else 0)

    def motion(self) -> Feedback:
        self.time += 0.5
        before, self.position = self.position, next(self.positions, self.position)
        if before != self.position == 0.1:
            self.time += self.gap
        return Feedback(self.position, 0.01 if self.position not in (before, 0.1) else 0.0, 0.0)


async def moved(drive: Drive, positions: list[float]) -> float:
    """To 0.1 rad at 0.05 rad/s, that is within 2 s and what the ramps need; returns the time that it took."""
    port, link = machine(drive)
    await port.connect()
    await port.enable("joint_1")
    drive.positions, drive.time = iter([0.0, *positions]), 0.0
    try:
        await move(link.thread, link.axes["joint_1"], 0.1, 0.05, threading.Event(), (), lambda: drive.time)
    finally:
        await port.close()
    return drive.time


@pytest.mark.parametrize(
    ("gap", "positions", "longer"),
    [(0.0, [k / 200 for k in range(21)], 2.0 + 5.0), (3600.0, [0.05, 0.09, 0.1], 3600.0)],
    ids=["slow", "host suspended near the end"],
)
async def test_a_drive_that_comes_nearer_arrives(gap: float, positions: list[float], longer: float) -> None:
    assert await moved(Drive("joint_1", gap=gap), positions) > longer


@pytest.mark.parametrize(
    ("positions", "place"),
    [
        ([0.01, 0.03, 0.05], r"-0\.05"),
        ([0.01, 0.05, *([0.03, 0.05] * 10)], r"-0\.0\d"),  # it leaves again
        ([0.1 - 0.04 * 0.98**k for k in range(20)], r"-0\.03\d"),  # a fifth of what is left in 5 s is no progress
    ],
    ids=["stands", "leaves again", "creeps"],
)
async def test_a_drive_that_comes_no_nearer_is_told_with_its_place(positions: list[float], place: str) -> None:
    drive = Drive("joint_1")
    with pytest.raises(DriveError, match=rf"{place} rad from its target 0\.1 rad, no nearer for 5\.0 s"):
        await moved(drive, positions)
    assert drive.time < 3 * 5.0
