"""The end of a move: the axis stands, also where its controller overshoots."""

from collections.abc import Iterator

import pytest

from drivers.cia402 import states
from drivers.cia402.device import Motion
from tests.unit.drivers.small_servo import Servo, machine

TAIL = (0.2, 5e-4, -1.5e-3, -1.2e-3, -4e-4)  # rad/s at consecutive readings; 1e-3 is standstill


class Overshooting(Servo):
    """Reports its target as reached from the start of the move; the speed passes through zero and comes back."""

    _tail: Iterator[float] = iter(())
    last = 0.0

    def set_target(self, position: float, velocity: float) -> None:
        self._tail = iter(TAIL)

    def statusword(self) -> int:
        return super().statusword() | states.TARGET_REACHED

    def motion(self) -> Motion:
        self.last = next(self._tail, 0.0)
        return Motion(0.0, self.last, 0.0)


@pytest.mark.parametrize("moves", [1, 3])
async def test_a_move_ends_when_the_overshoot_is_over(moves: int) -> None:
    servo = Overshooting("joint_1")
    port, _ = machine(servo)
    await port.connect()
    await port.enable("joint_1")
    for _ in range(moves):
        await port.move_to("joint_1", 0.0, 0.5)  # the next move is refused as long as the axis moves
        assert servo.last == 0.0
    await port.close()
