"""The path and what is fed forward along it, where both follow from a formula (`pair`)."""

import numpy as np
import pytest

from service.benefit import feed_forward
from service.benefit.feed_forward import path_between
from service.errors import BadInput
from tests.unit.service.benefit import pair

SLIDES = [0.0, 0.3, 0.6, 0.2, 0.9, 0.5, 0.1, 0.8]


def test_a_path_is_smooth_and_as_fast_as_the_slowest_joint_allows() -> None:
    motion = path_between(np.array([0.0, 1.0]), np.array([0.8, 0.6]), [1.0, 0.25])
    assert motion.position[[0, -1]] == pytest.approx(np.array([[0.0, 1.0], [0.8, 0.6]]))
    assert np.abs(motion.velocity).max(axis=0) == pytest.approx([0.3, 0.15], rel=1e-3)  # 0.6 of 0.25, in 5 s
    for before, after in ((motion.position, motion.velocity), (motion.velocity, motion.acceleration)):
        steps = np.diff(before, axis=0) / 1e-3
        assert steps == pytest.approx((after[1:] + after[:-1]) / 2, abs=1e-5)


def test_both_models_differ_by_their_rigid_bodies_alone() -> None:
    """A slide of 2 kg where CAD has 1 kg, on an arm that turns with w, dw: dJ dw + 2 (1 + x) w dx about the axis."""
    fed = feed_forward(pair.robot(), pair.sweeps(SLIDES))
    x, dx = fed.motion.position[:, 1], fed.motion.velocity[:, 1]
    w, dw = fed.motion.velocity[:, 0], fed.motion.acceleration[:, 0]
    assert np.ptp(fed.motion.position, axis=0) == pytest.approx([0.4, 0.8])
    differ = fed.identified[:, 0] - fed.cad[:, 0]
    assert differ == pytest.approx((1 + x) ** 2 * dw + 2 * (1 + x) * w * dx, abs=2e-3)


def test_friction_is_that_of_the_sweeps() -> None:
    fed = feed_forward(pair.robot(), pair.sweeps(SLIDES))
    x, dx = fed.motion.position[:, 1], fed.motion.velocity[:, 1]
    w, dw = fed.motion.velocity[:, 0], fed.motion.acceleration[:, 0]
    rigid = (5 + 2 * (1 + x) ** 2) * dw + 4 * (1 + x) * w * dx
    assert fed.identified[:, 0] - rigid == pytest.approx(pair.VISCOUS * w + pair.DRY * np.sign(w), abs=5e-2)


def test_without_sweeps_there_is_no_path() -> None:
    with pytest.raises(BadInput, match=r"^here: has no sweep"):
        feed_forward(pair.robot(), [], "here")
