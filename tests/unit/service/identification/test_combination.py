"""Sweeps and trajectories in one problem: exact without noise, honest with it, reasons for what is not seen."""

from dataclasses import replace

import numpy as np
import pytest

from service import BadInput
from service.identification.design.exciting_trajectory import (
    TrajectoryLimits,
    TrajectoryShape,
    design_trajectory,
    steady_motion,
)
from service.identification.estimates.combination import (
    AxisInertias,
    JointEstimate,
    combination_document,
    combine,
)
from service.identification.model import JointMotion, axis_rows, dynamic_base, dynamics_rows, nominal_parameters
from service.identification.motion.trajectory_record import AxisTrack, TrajectoryRecord
from service.model import Robot, SweepSpec
from tests.random_chain import random_arm

pytestmark = pytest.mark.slow

SHAPE = TrajectoryShape(period=4.0, harmonics=4)
SAMPLES = 8000  # the same instants at which the combination forms friction, so that signs agree
BINS, NOISE = 41, 1e-3  # up to 10 Hz; N m of a harmonic's real and imaginary part


def robot() -> Robot:
    return random_arm(11, 3, motor_inertia=2e-4, rated_effort=300.0, viscous_friction=20.0)


def truth(r: Robot) -> np.ndarray:
    """Not what the model says: every parameter off, dry friction and offsets besides."""
    rng = np.random.default_rng(5)
    nominal = nominal_parameters(r)
    return nominal * rng.uniform(0.9, 1.1, len(nominal)) + np.concatenate([np.zeros(36), rng.uniform(2, 5, 6)])


def record(r: Robot, seed: int, standing: tuple[int, ...] = (), noise: float = 0.0) -> TrajectoryRecord:
    """A run along an exact motion, as measured; the joints `standing` do not move."""
    ones = np.ones(3)
    limits = TrajectoryLimits(-1.5 * ones, 1.5 * ones, ones, 3 * ones, np.inf * ones)
    base = dynamic_base(r)
    run = design_trajectory(r, base.columns, limits, SHAPE, lambda path: True, seed=seed, restarts=4, steps=0)
    moved = steady_motion(run, np.linspace(0, SHAPE.period, SAMPLES, endpoint=False))
    still = np.isin(np.arange(3), standing)
    moved = JointMotion(
        np.where(still, run.center, moved.position),
        np.where(still, 0.0, moved.velocity),
        np.where(still, 0.0, moved.acceleration),
    )
    effort = dynamics_rows(r.chain, r.gravity, moved) @ truth(r)
    rng = np.random.default_rng(seed)

    def harmonics(signal: np.ndarray) -> np.ndarray:
        return np.fft.rfft(signal)[:BINS] / SAMPLES

    tracks = []
    for k, axis in enumerate(r.axes):
        if k in standing:
            continue
        disturbed = harmonics(effort[:, k]) + noise * (rng.standard_normal(BINS) + 1j * rng.standard_normal(BINS))
        spec = SweepSpec(
            id=axis.joint, axis=axis.joint, pose=tuple(run.center.tolist()), offset_velocity=0.0, sample_rate=250.0
        )
        tracks.append(AxisTrack(spec, disturbed, harmonics(moved.position[:, k]), None, noise or None))
    return TrajectoryRecord(tuple(run.center.tolist()), SHAPE.period, 2, tuple(tracks))


def sweeps(r: Robot, poses: int = 20, percent: float = 0.1) -> list[AxisInertias]:
    """Measured inertias of all axes in some poses."""
    rng = np.random.default_rng(2)
    result = []
    for k, axis in enumerate(r.axes):
        where = rng.uniform(-1.5, 1.5, (poses, 3))
        values = axis_rows(r.chain, k, where) @ truth(r)[:33]
        std = percent / 100 * values
        values = values + std * rng.standard_normal(poses)
        result.append(AxisInertias(axis.joint, where, values, np.diag(std**2), None, 1.0))
    return result


def z(result: JointEstimate) -> np.ndarray:
    return (result.solution.values - result.base.combination @ truth(result.robot)) / result.solution.std


def test_without_noise_everything_comes_back() -> None:
    r = robot()
    result = combine(r, [], [record(r, 1), record(r, 2)])
    expected = result.base.combination @ truth(r)
    scale = np.array([p.std_nominal for p in result.parameters])
    np.testing.assert_array_less(np.abs(result.solution.values - expected) / scale, 2e-3)
    assert all(p.identified and p.source == "trajectories" for p in result.parameters)
    other = record(r, 7).motion(r, 400, load=False)
    np.testing.assert_allclose(
        result.effort(other), dynamics_rows(r.chain, r.gravity, other) @ truth(r), atol=1e-3 * 300
    )
    pose = np.array([[0.3, -0.2, 0.9]])
    assert result.inertia("joint_2", pose)[0] == pytest.approx(
        (axis_rows(r.chain, 1, pose) @ truth(r)[:33])[0], rel=1e-3
    )


def test_with_noise_the_standard_deviations_are_honest_and_the_noise_has_settled_or_is_told() -> None:
    r = robot()
    found = [combine(r, sweeps(r), [record(r, 10 + k, noise=NOISE), record(r, 20 + k, noise=NOISE)]) for k in (1, 2)]
    assert 0.6 < np.sqrt(np.mean(np.square([z(one) for one in found]))) < 1.5
    assert max(found[0].noise_change.values()) < 0.05
    one = combine(r, sweeps(r), [record(r, 11, noise=NOISE)])
    for joint, noise in one.noise.items():
        assert noise == pytest.approx(NOISE, rel=0.35), joint
    assert {each.warning for each in combination_document(one).noise.values()} == {""}
    changing = combination_document(replace(one, noise_change=dict.fromkeys(r.joints, 0.2)))
    assert {each.warning for each in changing.noise.values()} == {
        "its noise still changes by 20 % in the last round; limit 5 %"
    }


def test_each_source_shows_its_own_and_both_are_better_than_one() -> None:
    r = robot()
    result = combine(r, sweeps(r), [record(r, 1, noise=0.3), record(r, 2, noise=0.3)])
    by_name = {parameter.name: parameter for parameter in result.parameters}
    assert by_name["Fc(joint_2)"].source == "trajectories"
    assert by_name["Fc(joint_2)"].std_sweeps is None
    for parameter in result.parameters:
        alone = min(std or np.inf for std in (parameter.std_sweeps, parameter.std_trajectories))
        assert (parameter.std or np.inf) <= alone * (1 + 1e-6)
    assert {parameter.source for parameter in result.parameters} >= {"trajectories", "sweeps"}


def test_what_no_motion_shows_is_named_with_the_reason() -> None:
    r = robot()
    result = combine(r, [], [record(r, 1, standing=(2,), noise=NOISE)])
    friction = next(p for p in result.parameters if p.name == "Fv(joint_3)")
    assert (friction.source, friction.std) == ("none", None)
    assert "no sweep and no trajectory" in friction.reason
    weak = combine(r, [], [record(r, 1, noise=300.0)])
    assert any("too weakly excited" in p.reason for p in weak.parameters)
    assert not any(p.identified for p in weak.parameters if p.name.startswith("Jm"))


def test_model_error_counts_as_noise() -> None:
    r = robot()
    good = record(r, 1, noise=NOISE)
    bent = replace(
        good, tracks=tuple(replace(t, effort=t.effort * (1 + 0.02 * (-1.0) ** np.arange(BINS))) for t in good.tracks)
    )
    result = combine(r, [], [bent])
    assert max(result.noise[joint] / (result.scatter[joint] or np.nan) for joint in r.joints) > 3


def test_without_trajectories_there_is_nothing_to_combine() -> None:
    with pytest.raises(BadInput, match="no trajectory"):
        combine(robot(), [], [])


def test_what_is_no_number_is_refused_with_axis_and_sweep() -> None:
    r = robot()
    good = record(r, 1, noise=NOISE)
    spoilt = replace(good.tracks[1], effort=good.tracks[1].effort * np.nan)
    with pytest.raises(BadInput, match=r"^sweep joint_2 of joint_2: \d+ of \d+ values of its harmonics are not finite"):
        combine(r, [], [replace(good, tracks=(good.tracks[0], spoilt, good.tracks[2]))])
    inertias = sweeps(r)
    inertias[2] = replace(inertias[2], values=inertias[2].values * np.inf)
    with pytest.raises(
        BadInput, match=r"^joint_3: 20 of 420 values of the inertias and the covariance of its sweeps are not finite"
    ):
        combine(r, inertias, [good])
