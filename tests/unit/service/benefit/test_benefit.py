"""The worth of an estimate where every figure follows from a formula (`pair`)."""

import numpy as np
import pytest

from service.benefit import Benefit, benefit
from service.benefit.benefit import rms_with_std
from service.benefit.held_out import held_out, poses_of
from service.benefit.lever_arm import end_of, lever_arm
from service.benefit.prediction import RigidBody, dry_friction, left_by, lines_power, window_of, without_friction
from service.errors import BadInput
from service.identification import spectrum
from service.identification.spectra.axis_inertia import DriveTrain
from tests.unit.service.benefit import pair

SLIDES = [0.0, 0.3, 0.6, 0.2, 0.9, 0.5, 0.1, 0.8]
HELD_OUT = ("0004", "0008")
RIGID = DriveTrain(1.0, pair.VISCOUS, 0.0, 0.0, 0.0)
# of the acceleration: sum over lines of (omega V)^2 / 2, rad^2/s^4
ACCELERATION = float(np.sqrt(sum((2 * np.pi * s.frequency * s.amplitude) ** 2 / 2 for s in pair.SINES)))


@pytest.fixture(scope="module")
def found() -> Benefit:
    return benefit(pair.robot(), pair.sweeps(SLIDES))


def test_every_fourth_pose_is_held_out_with_all_its_sweeps() -> None:
    specs = [sweep.spec for sweep in pair.sweeps([0.0, 0.1, 0.2, 0.3, 0.3, 0.0, 0.4])]
    back = specs[3].model_copy(update={"id": "back", "pose": (0.05, 0.3)})  # begins at the other end of its way
    poses = poses_of([*specs, back], 0)
    assert [len(pose) for pose in poses] == [2, 1, 1, 3, 1]
    assert held_out(poses) == {"0004", "0005", "back"}


def test_training_and_held_out_sweeps_are_told(found: Benefit) -> None:
    axis = found.axes["j1"]
    assert (found.every, axis.poses, axis.held_out_poses) == (4, 8, 2)
    assert axis.held_out == HELD_OUT
    assert set(axis.training).isdisjoint(HELD_OUT)
    assert len(axis.training) == 6


def test_inertia_errors_are_those_of_the_formula(found: Benefit) -> None:
    axis = found.axes["j1"]
    slides = np.array([0.2, 0.8])
    error = -((1 + slides) ** 2)  # CAD lacks 1 kg
    relative = 100 * error / (5 + 2 * (1 + slides) ** 2)
    assert axis.cad.inertia_percent.value == pytest.approx(np.sqrt(np.mean(relative**2)), rel=1e-3)
    assert axis.cad.inertia_error == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-3)
    assert axis.cad.inertia_percent.std is not None
    assert 0 < axis.cad.inertia_percent.std < 0.05
    assert axis.identified.inertia_percent.value < 0.05


def test_effort_left_at_the_lines_is_inertia_error_times_acceleration(found: Benefit) -> None:
    axis = found.axes["j1"]
    slides = np.array([0.2, 0.8])
    left = np.sqrt(np.mean((1 + slides) ** 4)) * ACCELERATION
    power = [
        pair.true_inertia(s) ** 2 * ACCELERATION**2 + 16 * sum(x.amplitude**2 / 2 for x in pair.SINES) for s in slides
    ]
    assert axis.cad.lines_rms == pytest.approx(left, rel=1e-3)
    assert axis.lines_rms == pytest.approx(np.sqrt(np.mean(power)), rel=1e-3)
    assert axis.cad.left_percent == pytest.approx(100 * left / np.sqrt(np.mean(power)), rel=2e-3)
    assert axis.lines_ratio > 100


def test_with_the_estimate_noise_alone_is_left(found: Benefit) -> None:
    axis = found.axes["j1"]
    assert axis.identified.effort_rms == pytest.approx(pair.NOISE, rel=0.1)
    tail = 5.55  # standard deviations, two sides, for 1 / (8 h 500 Hz) = 6.9e-8: between 5.3 and 5.6
    assert 5.2 * pair.NOISE < axis.identified.smallest_effort < 1.1 * tail * pair.NOISE
    assert axis.smallest_ratio > 100


def test_force_at_the_end_is_effort_over_its_arm(found: Benefit) -> None:
    axis = found.axes["j1"]
    assert end_of(pair.robot()) == pytest.approx([0.5, 0.0, 0.7])
    arms = lever_arm(pair.robot(), 0, np.array([[0.0, 0.2], [0.4, 0.8]]))  # 1 + slide + 0.5, whatever j1
    assert arms == pytest.approx([1.7, 2.3])
    assert axis.lever_arm == pytest.approx(2.0)
    assert axis.cad.smallest_force == pytest.approx(axis.cad.smallest_effort / 2.0)


def test_the_right_model_leaves_dry_friction_which_training_tells() -> None:
    robot, (one, other) = pair.robot(), pair.sweeps([0.0, 0.5])
    windows = [window_of(sweep, spectrum(robot, sweep), 0) for sweep in (one, other)]
    left = [
        left_by(RigidBody(pair.true_inertia(slide), 0.0, 0.0), RIGID, window)
        for slide, window in zip((0.0, 0.5), windows, strict=True)
    ]
    assert [part.mean() for part in left] == pytest.approx([pair.DRY] * 2, abs=1e-4)
    friction = dry_friction(left[:1], windows[:1])
    assert friction == pytest.approx([pair.DRY / 2] * 2, abs=1e-4)  # one direction: the shortest vector
    assert without_friction(left[1], windows[1], friction).std() == pytest.approx(pair.NOISE, rel=0.1)
    assert lines_power(np.asarray(windows[0].velocity), windows[0]) == pytest.approx(4 * 0.01**2 / 2)


def test_gravity_is_taken_along_the_way() -> None:
    robot, (sweep,) = pair.robot(), pair.sweeps([0.0])
    window = window_of(sweep, spectrum(robot, sweep), 0)
    bare = left_by(RigidBody(7.0, 0.0, 0.0), RIGID, window)
    heavy = left_by(RigidBody(7.0, 30.0, -20.0), RIGID, window)
    assert bare - heavy == pytest.approx(30 * np.cos(sweep.recording.position) - 20 * np.sin(sweep.recording.position))


def test_uncertainty_of_an_rms() -> None:
    """e = (3, 4), independent with std 1 and 2: r = sqrt(12.5), its std sqrt(9 + 64) / (2 r)."""
    value = rms_with_std(np.array([3.0, 4.0]), np.diag([1.0, 4.0]), "%")
    assert (value.value, value.std) == pytest.approx((np.sqrt(12.5), np.sqrt(73) / (2 * np.sqrt(12.5))))


def test_too_few_poses_are_a_reason_and_no_figure() -> None:
    found = benefit(pair.robot(), pair.sweeps(SLIDES[:3]))
    assert not found.axes
    assert found.not_judged["j1"] == "has sweeps in 3 poses; every 4th is held out, so 4 are needed"


def test_without_a_motor_inertia_cad_says_nothing() -> None:
    found = benefit(pair.robot(motor_inertia=None), pair.sweeps(SLIDES))
    assert "no motor_inertia" in found.not_judged["j1"]


def test_recordings_without_sines_are_refused() -> None:
    (sweep,) = pair.sweeps([0.0])
    noise = sweep.spec.model_copy(update={"sines": (), "period": None, "periods": None, "excitation": "noise"})
    with pytest.raises(BadInput, match=r"^here: has no sweep of one axis with offset and sines"):
        benefit(pair.robot(), [type(sweep)(noise, sweep.recording)], "here")
