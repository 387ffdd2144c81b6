"""What is shown on held-out sweeps: effects that help stay, richer physics is found by the twin, the vain go back."""

from functools import cache
from typing import Any

import numpy as np

from service.diagnosis.design import full_design
from service.diagnosis.equations import Equations, Term, equations, grouped
from service.diagnosis.gap import Gap, gap
from service.diagnosis.show import Shown, doubt, show
from service.diagnosis.signals import tracks
from service.recording import Recording, Sweep
from simulator import DriveTrain, Measurement, Scenario, run_sweeps
from tests.numeric.campaign import max100, scenario_named
from tests.unit.service.diagnosis.test_twin import run_of

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
    motion = tracks(max100(), JOINT, sweeps)
    return equations(motion, grouped(motion)), sweeps


def found(given: Equations, shown: Shown) -> Gap:
    return gap(given, shown.before, shown.after, shown.held_out)


def test_the_twin_follows_physics_that_columns_only_touch() -> None:
    """The column is the tangent of exp(-loss T) and warms by the way; the twin warms by what it dissipates."""
    given, sweeps = warming()
    term = Term("friction_temperature_drift", (60.0,))
    columns = found(given, show(given, sweeps, [], [term], twin=False))
    shown = show(given, sweeps, [], [term], twin=True)
    twin = found(given, shown)
    assert (shown.source, shown.rolled_back) == ("twin", ())
    assert twin.after_rms < 0.7 * columns.after_rms < 0.1 * twin.before_rms
    assert twin.after_rms < 1.2 * (twin.noise_floor_rms or 0.0)
    (effect,) = shown.fitted
    assert abs(effect.parameters["coulomb"].value - 90.0) < 1.0
    assert abs(effect.parameters["time_constant"].value - 60.0) < 10.0
    assert effect.covariance.shape == (4, 4)
    np.testing.assert_allclose(np.sqrt(np.diag(effect.covariance)), [p.std for p in effect.parameters.values()])
    assert [pose.sweeps for pose in twin.by_pose] == [6, 10]  # the first pose, which comes back, is the second here


def test_an_effect_that_is_not_there_is_rolled_back() -> None:
    given, sweeps = measured(machine(motor_friction={"viscous": 180.0, "coulomb": 60.0}))
    shown = show(given, sweeps, [], [Term("coulomb_friction"), Term("cogging_torque")], twin=True)
    assert shown.rolled_back == ("cogging_torque",)
    assert [effect.effect for effect in shown.fitted] == ["coulomb_friction"]
    assert found(given, shown).after_rms < 1.1 * (found(given, shown).noise_floor_rms or 0.0)
    assert abs(shown.fit.viscous - 180.0) < 3.0
    assert np.all(shown.fit.inertia_std > 0)


def test_what_is_vain_is_rolled_back_by_the_columns_as_well() -> None:
    given, sweeps = measured(machine(motor_friction={"viscous": 180.0, "coulomb": 60.0}))
    shown = show(given, sweeps, [], [Term("coulomb_friction"), Term("cogging_torque")], twin=False)
    assert shown.rolled_back == ("cogging_torque",)
    assert [effect.effect for effect in shown.fitted] == ["coulomb_friction"]


def test_what_repeats_leaves_doubt_and_noise_does_not() -> None:
    given, _ = warming()
    shape = given.tracks.usable.shape
    noise = np.random.default_rng(4).standard_normal(shape)
    assert doubt(given, noise) < 0.2  # the ratio of two mean squares is 1 within a hundredth or so
    assert abs(doubt(given, 1.0 + noise) - np.sqrt(0.5)) < 0.05  # as much power as the noise
    assert doubt(given, 100.0 + noise) > 0.999
