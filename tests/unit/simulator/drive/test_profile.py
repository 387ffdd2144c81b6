import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.drive.profile import brake, travel

speed = st.floats(0.1, 50)


def test_a_trapezoid_by_hand() -> None:
    # 1 rev/s^2 up to 2 rev/s (2 s, 2 rev), 6 rev at 2 rev/s (3 s), 2 rev/s^2 down (1 s, 1 rev): 9 rev in 6 s
    motion = travel(9.0, 0.0, 2.0, 1.0, 2.0)
    assert motion.duration == pytest.approx(6.0)
    assert motion.velocity(np.array([0.0, 1.0, 2.0, 4.0, 5.5, 6.0, 7.0])) == pytest.approx([0, 1, 2, 2, 1, 0, 0])
    assert motion.position(np.array([0.0, 1.0, 2.0, 5.0, 6.0, 9.0])) == pytest.approx([0, 0.5, 2, 8, 9, 9])


def test_a_triangle_and_no_way_at_all() -> None:
    assert travel(-2.0, 0.0, 50.0, 2.0, 2.0).velocities == pytest.approx((0, -2, -2, 0))
    assert travel(0.0, 0.0, 1.0, 1.0, 1.0).duration == 0.0
    assert travel(5e-324, 0.0, 1.0, 0.5, 0.5).duration == 0.0  # the square of its speed underflows
    assert brake(0.0, 1.0).duration == 0.0
    assert brake(-3.0, 2.0).distance == pytest.approx(-2.25)


@given(st.floats(-100, 100), st.floats(-60, 60), speed, speed, speed)
def test_arrives_within_its_limits(distance: float, start: float, limit: float, up: float, down: float) -> None:
    motion = travel(distance, start, limit, up, down)
    assert motion.distance == pytest.approx(distance, abs=1e-6)
    assert motion.velocities[0] == pytest.approx(start) or motion.duration == 0.0
    assert motion.velocities[-1] == 0.0
    assert max(map(abs, motion.velocities)) <= max(limit, abs(start)) * (1 + 1e-9)
    steps = np.abs(np.diff(motion.velocities))
    assert np.all(steps <= np.array(motion.durations) * max(up, down) * (1 + 1e-6) + 1e-9)
