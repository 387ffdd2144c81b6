"""A torque that is told late is late with all that acts, not with inertia, gravity and friction alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from service.diagnosis.diagnose import diagnose_axis
from service.diagnosis.fit.equations import Term
from service.diagnosis.verdict import Verdict
from service.identification.design.diagnosis_sweeps import full_design
from service.recording import Sweep
from tests.unit.service.diagnosis.following import following, known_to

pytestmark = pytest.mark.slow

DELAY = 4e-3  # s
RIPPLES = (
    6.0,
    -4.0,
    3.0,
    2.0,
)  # of the rated effort in per mille: sines and cosines of each order and its two neighbours
BLOCKS_RUN = ("forward_slow", "backward_slow", "wide")
NOISE = 5e-4  # of the rated effort


def _told_late(sweep: Sweep, noise: np.ndarray) -> Sweep:
    record = sweep.recording
    torque = CubicSpline(record.time, record.effort)
    told = torque(np.maximum(record.time - DELAY, record.time[0])) + noise
    return replace(sweep, recording=replace(record, effort=told))


def test_ripples_of_a_torque_that_is_told_late() -> None:
    robot, joint, random = known_to(0.1), "joint_2", np.random.default_rng(5)
    rated = robot.axis(joint).rated_effort
    poses = np.array([[0.0, angle, 0.3, 0.0, 0.0, 0.0] for angle in (-0.6, 0.5)])
    designed = full_design(robot, joint, poses, sample_rate=250.0, blocks=BLOCKS_RUN, revisit=False)
    sizes = 1e-3 * rated * np.resize(RIPPLES, 6 * len(robot.axis(joint).cogging_orders))
    hidden = {Term("cogging_torque"): sizes.tolist()}
    sweeps = [
        _told_late(sweep, NOISE * rated * random.standard_normal(len(sweep.recording.time)))
        for sweep in following(robot, joint, designed, hidden, noise=0.0)
    ]
    found = diagnose_axis(robot, joint, sweeps, twin=False)
    assert found.verdict is Verdict.NAMED
    named = {effect.name: effect.parameters for effect in found.effects}
    assert set(named) == {"cogging_torque", "measurement_delay"}
    delay = named["measurement_delay"]["delay"]
    assert abs(delay.value - DELAY) < 3 * delay.std < 0.1 * DELAY
    found_sizes = [parameter.value for parameter in named["cogging_torque"].values()]
    assert found_sizes == pytest.approx(sizes, rel=0.02, abs=1e-4 * rated)
