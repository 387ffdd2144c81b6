"""What is shown on held-out sweeps: effects that help stay, the vain go back, and the twin is told beside."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from service.diagnosis.fit.equations import Equations, Term
from service.diagnosis.fit.gap import gap
from service.diagnosis.model.held_out_check import beside_twin, check_held_out
from service.identification.design.diagnosis_sweeps import full_design
from service.model import Recording, Sweep
from simulator import DriveTrain, Measurement, Scenario, run_sweeps
from tests.numeric.campaign import max100, scenario_named
from tests.unit.service.diagnosis.following import equations_of
from tests.unit.service.diagnosis.test_twin import run_of

pytestmark = pytest.mark.slow

JOINT = "joint_1"
POSES = np.array([[0.3, -0.8, 0.5, 0.0, 0.0, 0.0], [0.2, 0.6, 0.2, 0.0, 0.0, 0.0]])
BLOCKS = ("forward_slow", "backward_slow", "forward_fast")
QUIET = Measurement(effort_noise=0.0005, velocity_noise=5e-6, position_noise=2e-8)


def machine(**hidden: Any) -> Scenario:
    """The rigid machine with plain viscous friction, and what is hidden in the train of the axis."""
    scenario = scenario_named("max100-rigid")
    driven = scenario.axes[JOINT]
    train = DriveTrain.model_validate(
        {"motor_inertia": driven.train.motor_inertia, "motor_friction": {"viscous": 180.0}} | hidden
    )
    axes = scenario.axes | {JOINT: driven.model_copy(update={"train": train})}
    return scenario.model_copy(update={"axes": axes, "measurement": QUIET})


@cache
def warming() -> tuple[Equations, list[Sweep]]:
    """An axis whose dry friction falls by more than a third while it is measured."""
    friction = {"viscous": 180.0, "coulomb": 90.0}
    warming = {"heat_capacity": 7.0, "time_constant": 60.0, "coulomb_loss": 0.03, "viscous_loss": 0.01}
    return measured(machine(motor_friction=friction, warming=warming))


def measured(scenario: Scenario) -> tuple[Equations, list[Sweep]]:
    designs = full_design(max100(), JOINT, POSES, blocks=BLOCKS)
    recorded = run_sweeps(scenario, [run_of(design) for design in designs], seed=3)
    names = ("time", "effort", "velocity", "position")
    sweeps = [
        Sweep(design.spec, Recording(**{name: columns[name] for name in names}))
        for design, columns in zip(designs, recorded, strict=True)
    ]
    return equations_of(max100(), JOINT, sweeps), sweeps


def test_columns_and_twin_follow_a_gear_that_warms() -> None:
    """The column is the tangent of exp(-loss T) and warms by the way; the twin warms by what it dissipates."""
    given, sweeps = warming()
    term = Term("friction_temperature_drift", (60.0, 1.0))
    shown = check_held_out(given, [], [term])
    whole = gap(given, shown.before, shown.after, ())
    assert shown.rolled_back == ()
    assert whole.after_rms < 0.2 * whole.before_rms
    twin_rms, _ = beside_twin(given, sweeps, shown.point)
    assert twin_rms is not None
    assert twin_rms < 0.2 * whole.before_rms
    (effect,) = shown.fitted
    assert effect.covariance.shape == (5, 5)
    np.testing.assert_allclose(np.sqrt(np.diag(effect.covariance)), [p.std for p in effect.parameters.values()])
    assert [pose.sweeps for pose in whole.by_pose] == [6, 10]  # the first pose, which comes back, is the second here


def test_an_effect_that_is_not_there_is_rolled_back() -> None:
    given, sweeps = measured(machine(motor_friction={"viscous": 180.0, "coulomb": 60.0}))
    shown = check_held_out(given, [], [Term("coulomb_friction"), Term("cogging_torque")])
    assert shown.rolled_back == ("cogging_torque",)
    assert [effect.effect for effect in shown.fitted] == ["coulomb_friction"]
    whole = gap(given, shown.before, shown.after, ())
    floor = whole.noise_floor_rms or 0.0
    assert whole.after_rms < 1.1 * floor
    assert abs(shown.fit.viscous - 180.0) < 3.0
    assert np.all(shown.fit.inertia_std > 0)
    assert (beside_twin(given, sweeps, shown.point)[0] or np.inf) < 1.1 * floor


def test_the_gap_is_that_of_the_pose_that_took_no_part() -> None:
    """RMS of the rows of unseen sweeps alone, and how many they are."""
    given, _ = warming()
    left = np.where(given.tracks.pose_index[:, None] == 0, 3.0, 1.0) * np.ones_like(given.right)
    unseen = [k for k, pose_index in enumerate(given.tracks.pose_index) if pose_index == 0]
    one, every = gap(given, left, left, unseen), gap(given, left, left, ())
    assert (one.before_rms, one.held_out_sweeps) == (pytest.approx(3.0), len(unseen))
    assert 1.0 < every.before_rms < 3.0
    assert (every.held_out_sweeps, every.cross_validated) == (0, True)
