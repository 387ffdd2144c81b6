"""Harmonics of a trajectory: exact motion, noise from the scatter between periods, what belongs together."""

from dataclasses import replace

import numpy as np
import pytest

from service import BadInput
from service.identification.axis.drive_train import TwoMassTrain
from service.identification.motion.trajectory_record import (
    TrajectoryRecord,
    axis_track,
    in_time,
    runs_at_once,
    trajectories,
    trajectory,
    with_loads,
)
from service.model import Recording, Robot, Sine, Sweep, SweepSpec
from tests.random_chain import random_arm

RATE, PERIOD, PERIODS, START = 200.0, 2.0, 3, 1.0
TIME = np.arange(0, START + PERIOD * PERIODS + 0.5, 1 / RATE)
OMEGA = 2 * np.pi / PERIOD


def robot() -> Robot:
    return random_arm(3, 2, rated_effort=500.0)


def sweep(axis: str, noise: float = 0.0, **changes: object) -> Sweep:
    spec = {
        "id": axis,
        "axis": axis,
        "pose": (0.3, -0.2),
        "offset_velocity": 0.0,
        "excitation": "trajectory",
        "sines": (Sine(frequency=0.5, amplitude=0.1),),
        "period": PERIOD,
        "periods": PERIODS,
        "measure_from": START,
        "sample_rate": RATE,
        "block": "t",
    } | changes
    since = TIME - START
    effort = 20 + 5 * np.cos(3 * OMEGA * since) + noise * np.random.default_rng(1).standard_normal(len(since))
    position = 0.4 + 0.1 * np.sin(OMEGA * since) - 0.02 * np.cos(4 * OMEGA * since)
    return Sweep(SweepSpec.model_validate(spec), Recording(TIME, effort, np.zeros_like(TIME), position))


def record(noise: float = 0.0) -> TrajectoryRecord:
    return trajectory(robot(), [axis_track(sweep("joint_2", noise))])


def test_motion_is_exact_and_the_others_stand() -> None:
    motion = record().motion(robot(), 400, load=False)
    since = np.arange(400) * PERIOD / 400
    wave = 0.1 * np.sin(OMEGA * since), -0.02 * np.cos(4 * OMEGA * since)
    np.testing.assert_allclose(motion.position[:, 1], 0.4 + wave[0] + wave[1], atol=1e-12)
    np.testing.assert_allclose(motion.acceleration[:, 1], -(OMEGA**2) * (wave[0] + 16 * wave[1]), atol=1e-9)
    assert (motion.position[:, 0] == 0.3).all()
    assert (motion.velocity[:, 0] == 0).all()


def test_the_path_of_an_offset_is_beside_the_harmonics() -> None:
    whole = sweep("joint_2", offset_velocity=0.01, period=PERIOD * PERIODS, periods=1)
    since = TIME - START
    turned = replace(
        whole.recording, position=whole.recording.position + 0.01 * since, effort=whole.recording.effort + 3 * since
    )
    track = axis_track(Sweep(whole.spec, turned))
    assert track.slope == pytest.approx(0.01, abs=1e-9)
    motion = trajectory(robot(), [track]).motion(robot(), 1200, load=False)
    np.testing.assert_allclose(motion.position[:, 1], turned.position[200:1400], atol=1e-9)
    assert motion.velocity[:, 1].mean() == pytest.approx(0.01, abs=1e-9)
    assert abs(track.effort[1]) < 0.01 * abs(track.effort[9])
    with pytest.raises(BadInput, match=r"sweep joint_2: has an offset of 0.01 and 3 periods; limit 1"):
        axis_track(sweep("joint_2", offset_velocity=0.01))


def test_effort_and_noise() -> None:
    clean, noisy = record(), record(noise=2.0)
    np.testing.assert_allclose(in_time(clean.tracks[0].effort, 400).max(), 25.0, atol=1e-9)
    assert clean.tracks[0].noise == pytest.approx(0.0, abs=1e-12)
    # real and imaginary part of a bin of N samples: s / sqrt(2 N)
    assert noisy.tracks[0].noise == pytest.approx(2.0 / np.sqrt(2 * RATE * PERIOD * PERIODS), rel=0.3)
    assert axis_track(sweep("joint_2", periods=1)).noise is None


def test_a_load_without_encoder_hangs_on_its_spring() -> None:
    train = TwoMassTrain(motor_inertia=2.0, motor_friction=0, load_friction=0, compliance=1e-3, damping_time=0)
    own = with_loads(record(), {"joint_2": train})
    loads, motors = (own.motion(robot(), 400, load=of_load) for of_load in (True, False))
    effort = in_time(own.tracks[0].effort, 400)
    np.testing.assert_allclose(
        motors.position[:, 1] - loads.position[:, 1], 1e-3 * (effort - 2.0 * motors.acceleration[:, 1]), atol=1e-9
    )


def test_sweeps_that_ran_at_once_are_found() -> None:
    own, other = axis_track(sweep("joint_1")), axis_track(sweep("joint_2"))
    later, another = axis_track(sweep("joint_1", started_at=9.0)), axis_track(sweep("joint_1", block="other"))
    found = trajectories(robot(), [own, later, another, other])
    assert [[track.joint for track in each.tracks] for each in found] == [
        ["joint_1", "joint_2"],
        ["joint_1"],
        ["joint_1"],
    ]
    assert runs_at_once(own.spec)
    assert not runs_at_once(sweep("joint_2", excitation="multisine").spec)


def test_sweeps_that_do_not_belong_together_are_refused() -> None:
    for other, text in (
        (sweep("joint_1", pose=(0.0, 0.0)), "pose"),
        (sweep("joint_1", periods=2), "periods"),
        (sweep("joint_2"), "twice"),
        (sweep("joint_9"), "joint_9"),
    ):
        with pytest.raises(BadInput, match=text):
            trajectory(robot(), [axis_track(sweep("joint_2")), axis_track(other)])
    with pytest.raises(BadInput, match="leaves the record"):
        axis_track(sweep("joint_1", periods=9))
