"""The worth of an estimate, the monitor and the feed-forward, where all follows from a formula (`pair`)."""

import re

import numpy as np
import pytest

from service import BadInput
from service.identification.axis.drive_train import TwoMassTrain
from service.identification.spectra.frequency_response import spectrum
from service.report.benefit.benefit import (
    Benefit,
    ModelBenefit,
    RigidAxis,
    alarm_probability,
    benefit,
    dry_friction,
    end_of,
    feed_forward,
    held_out,
    left_by,
    lever_arm,
    lines_power,
    path_between,
    poses_of,
    rms_with_std,
    smallest_effort,
    window_of,
    without_friction,
)
from service.report.benefit.section import benefit_section, sentence, worth
from service.report.html import ReportPage
from service.report.plotting import svg
from tests.unit.service.benefit import pair

SLIDES = [0.0, 0.3, 0.6, 0.2, 0.9, 0.5, 0.1, 0.8]
RIGID = TwoMassTrain(1.0, pair.VISCOUS, 0.0, 0.0, 0.0)
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
        left_by(RigidAxis(pair.true_inertia(slide), 0.0, 0.0), RIGID, window)
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
    bare = left_by(RigidAxis(7.0, 0.0, 0.0), RIGID, window)
    heavy = left_by(RigidAxis(7.0, 30.0, -20.0), RIGID, window)
    assert bare - heavy == pytest.approx(30 * np.cos(sweep.recording.position) - 20 * np.sin(sweep.recording.position))


def test_uncertainty_of_an_rms() -> None:
    """e = (3, 4), independent with std 1 and 2: r = sqrt(12.5), its std sqrt(9 + 64) / (2 r)."""
    value = rms_with_std(np.array([3.0, 4.0]), np.diag([1.0, 4.0]), "%")
    assert (value.value, value.std) == pytest.approx((np.sqrt(12.5), np.sqrt(73) / (2 * np.sqrt(12.5))))


def test_recordings_without_sines_are_refused() -> None:
    (sweep,) = pair.sweeps([0.0])
    noise = sweep.spec.model_copy(update={"sines": (), "period": None, "periods": None, "excitation": "noise"})
    for of in (benefit, feed_forward):
        with pytest.raises(BadInput, match=r"^here: has no sweep of one axis with offset and sines"):
            of(pair.robot(), [type(sweep)(noise, sweep.recording)], "here")


def test_a_path_is_smooth_and_as_fast_as_the_slowest_joint_allows() -> None:
    motion = path_between(np.array([0.0, 1.0]), np.array([0.8, 0.6]), [1.0, 0.25])
    assert motion.position[[0, -1]] == pytest.approx(np.array([[0.0, 1.0], [0.8, 0.6]]))
    assert np.abs(motion.velocity).max(axis=0) == pytest.approx([0.3, 0.15], rel=1e-3)  # 0.6 of 0.25, in 5 s
    for before, after in ((motion.position, motion.velocity), (motion.velocity, motion.acceleration)):
        steps = np.diff(before, axis=0) / 1e-3
        assert steps == pytest.approx((after[1:] + after[:-1]) / 2, abs=1e-5)


def test_both_models_differ_by_their_rigid_bodies_alone_and_friction_is_that_of_the_sweeps() -> None:
    """A slide of 2 kg where CAD has 1 kg, on an arm that turns with w, dw: dJ dw + 2 (1 + x) w dx about the axis."""
    fed = feed_forward(pair.robot(), pair.sweeps(SLIDES))
    x, dx = fed.motion.position[:, 1], fed.motion.velocity[:, 1]
    w, dw = fed.motion.velocity[:, 0], fed.motion.acceleration[:, 0]
    assert np.ptp(fed.motion.position, axis=0) == pytest.approx([0.4, 0.8])
    differ = fed.identified[:, 0] - fed.cad[:, 0]
    assert differ == pytest.approx((1 + x) ** 2 * dw + 2 * (1 + x) * w * dx, abs=2e-3)
    rigid = (5 + 2 * (1 + x) ** 2) * dw + 4 * (1 + x) * w * dx
    assert fed.identified[:, 0] - rigid == pytest.approx(pair.VISCOUS * w + pair.DRY * np.sign(w), abs=5e-2)


def test_one_false_alarm_in_a_shift() -> None:
    assert alarm_probability(1000.0, 8.0) == pytest.approx(1 / 28_800_000)


@pytest.mark.parametrize(
    ("mean", "std", "recorded", "probability", "wanted"),
    [  # beyond three standard deviations of the normal table: 0.002699796 on both sides, 0.001349898 on one
        ([0.0], [2.0], 0.0, 0.002699796, 6.0),  # noise alone: two-sided
        ([20.0], [2.0], 0.0, 0.001349898, 26.0),  # a pose that is off counts from its mean; the other side is 23 away
        ([20.0, 0.0], [2.0, 2.0], 0.0, 0.001349898 / 2, 26.0),  # the pose that is right adds nothing there
        ([0.0], [2.0], 9.5, 0.002699796, 9.5),  # never below what was recorded without a collision
        ([3.0, -5.0], [0.0, 0.0], 0.0, 1e-8, 5.0),  # a model that leaves nothing but a constant
    ],
)
def test_the_smallest_effort_of_a_collision(
    mean: list[float], std: list[float], recorded: float, probability: float, wanted: float
) -> None:
    assert smallest_effort(np.array(mean), np.array(std), recorded, probability) == pytest.approx(wanted, rel=1e-6)


def with_models(found: Benefit, cad: ModelBenefit, identified: ModelBenefit) -> Benefit:
    axis = found.axes["j1"].model_copy(update={"cad": cad, "identified": identified})
    return found.model_copy(update={"axes": {"j1": axis}})


def page_of(found: Benefit) -> str:
    page = ReportPage("worth")
    benefit_section(page, found)
    return page.html()


def test_the_sentence_names_both_models(found: Benefit) -> None:
    models = found.axes["j1"].identified, found.axes["j1"].cad
    numbers = [float(number) for number in re.findall(r"\d+(?:\.\d+)?(?:e-\d+)?", sentence(found))]
    told = [*(model.left_percent for model in models), *(model.smallest_force for model in models)]
    assert numbers == pytest.approx(told, rel=0.05)
    assert "no better" not in sentence(found)
    nothing_won = with_models(found, models[1], models[1])
    assert sentence(nothing_won).endswith("On j1 the estimate is no better than CAD.")


def test_an_axis_through_the_end_of_the_robot_has_no_force(found: Benefit) -> None:
    models = found.axes["j1"].cad, found.axes["j1"].identified
    alone = with_models(found, *(model.model_copy(update={"smallest_force": None}) for model in models))
    assert "push" not in sentence(alone)
    assert "–" in page_of(alone)


def test_figure_and_table_of_the_report(found: Benefit) -> None:
    html = page_of(found)
    assert "What you gain" in html
    assert html.count("<figure>") == 1
    assert "j1, estimate" in html
    axis, bars = found.axes["j1"], worth(found)["data"]
    assert [bar["y"] for bar in bars][:2] == [[axis.cad.left_percent], [axis.identified.left_percent]]
    assert "smallest force seen in N" in svg(worth(found), "worth")


@pytest.mark.parametrize(
    ("motor_inertia", "slides", "why"),
    [(1e-4, [0.0, 0.3, 0.6], "has sweeps in 3 poses"), (None, SLIDES, "the robot file has no motor_inertia")],
)
def test_what_is_not_judged_is_told_without_a_figure(
    motor_inertia: float | None, slides: list[float], why: str
) -> None:
    html = page_of(benefit(pair.robot(motor_inertia), pair.sweeps(slides)))
    assert f"Not judged: j1 {why}" in html
    assert "<figure>" not in html
