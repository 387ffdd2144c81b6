"""Catalogue and model revision against the simulator: columns, scenario and twin are the same torque."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from service.cli.commands.identify import write_scenario
from service.diagnosis import model_document
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Inexpressible, Model, Patch, TrainEntry
from service.diagnosis.model.scenario import AxisEntry, Links, axis_entry, gravity, gravity_of_fit
from service.diagnosis.model.twin import TwinRun, torques, ways
from service.diagnosis.rows.rigid import load_rows, nominal_load, nominal_parameters
from service.diagnosis.rows.signals import Tracks, laid_out, tracks
from service.identification.design.diagnosis_sweeps import DesignedSweep, full_design
from service.model import Recording, Robot, Sweep
from service.model.counterbalance import Counterbalance
from service.model.results.diagnosis import DiagnosedModel
from simulator import Measurement, Motion, SweepRun, load_scenario, replay, run_sweeps
from simulator.rigid_body import RigidBody, moving_axis
from tests.numeric import campaign
from tests.numeric.campaign import max100, scenario_named
from tests.stored.documents import axis_document, diagnosis

Array = NDArray[np.float64]

JOINT = "joint_2"
POSES = np.array([[0.3, -0.8, 0.5, 0.0, 0.0, 0.0], [0.2, 0.6, 0.2, 0.0, 0.0, 0.0]])
CASES: dict[str, tuple[dict[str, float], float]] = {  # parameters, and how far apart the torques may be
    "coulomb_friction": ({"coulomb": 50.0}, 0.01),
    "asymmetric_friction": ({"coulomb": 50.0, "coulomb_difference": 10.0, "viscous_difference": 30.0}, 0.01),
    "stribeck_friction": ({"coulomb": 50.0, "extra": 30.0, "velocity": 0.01, "exponent": 1.3}, 0.01),
    "nonlinear_viscous_friction": ({"coefficient": 0.4, "velocity": 1e-4, "exponent": 0.5}, 0.01),
    "load_dependent_friction": ({"coulomb": 30.0, "load_dependence": 0.03, "load_curvature": 0.0, "knee": 1.0}, 0.01),
    # warmed by the way it goes against by what it dissipates
    "friction_temperature_drift": (
        {"coulomb": 60.0, "coulomb_change": -8.0, "viscous_change": -10.0}
        | {"time_constant": 200.0, "heating_exponent": 1.0},
        0.05,
    ),
    "hose_spring": ({"stiffness": 80.0, "torque_at_zero": 20.0, "bend": 0.0, "hardening": 0.0}, 0.01),
    "joint_elasticity": (
        {"ratio": 1.0, "hardening": 0.0, "compliance": 1e-6, "damping_time": 1e-3, "load_friction_share": 0.5}
        | {"motor_inertia": 66.4411},  # as on its data sheet
        0.05,
    ),
    "measurement_delay": ({"delay": 1.5e-3, "expansion_point": 1.5e-3}, 0.02),
    "cogging_torque": ({"sine_24": 20.0, "cosine_24": 10.0, "sine_48": -5.0, "cosine_48": 8.0}, 0.02),
    "transmission_error": (
        {"sine_1": 1e-4, "cosine_1": 5e-5, "sine_2": -3e-5, "cosine_2": 1e-5}
        | {"torque_sine_1": 5.0, "torque_cosine_1": -8.0, "torque_sine_2": 3.0, "torque_cosine_2": 2.0},
        0.02,
    ),
    "presliding_hysteresis": ({"coulomb": 50.0, "damping": 300.0, "way": 3e-4}, 0.01),
    # impacts without rebound against soft flanks
    "backlash": ({"ratio": 1.0, "play": 1e-4, "load_friction_share": 0.5}, 0.5),
    "effort_offset": ({"offset": -20.0}, 0.01),
    "counterbalance": ({"share": -0.2, "rate": 2e3}, 0.01),
}
JOINTS = {"backlash": "joint_1", "counterbalance": "joint_3"}  # weight keeps a gear on one flank; has one in its file


@cache
def measured(joint: str = JOINT) -> tuple[Robot, tuple[Sweep, ...], Tracks]:
    """The full design once, run by a rigid machine without noise: its motion is what counts."""
    robot = max100()
    designs = full_design(robot, joint, POSES, repeats=1)
    if joint == JOINTS["counterbalance"]:
        own = Counterbalance(anchor=(0.4, 0.0, -0.3), attachment=(0.0, 0.0, 0.5), force=4e3, length=0.6, rate=1e4)
        axes = [a.model_copy(update={"counterbalance": own}) if a.joint == joint else a for a in robot.axes]
        robot = replace(robot, description=robot.description.model_copy(update={"axes": tuple(axes)}))
    machine = scenario_named("max100-rigid").model_copy(update={"measurement": Measurement()})
    columns = run_sweeps(machine, [run_of(design) for design in designs], seed=1)
    names = ("time", "effort", "velocity", "position")
    sweeps = tuple(
        Sweep(design.spec, Recording(**{name: signals[name] for name in names}))
        for design, signals in zip(designs, columns, strict=True)
    )
    return robot, sweeps, tracks(robot, joint, sweeps)


def run_of(design: DesignedSweep) -> SweepRun:
    return campaign.run_of(design.spec, design.ramp, design.settle, started_at=design.spec.started_at)


def model(joint: str = JOINT) -> Model:
    robot, _, motion = measured(joint)
    axis = robot.axis(joint)
    inertia, torque, slope = nominal_load(robot, joint, motion.poses)[:, motion.pose_index]
    motor = axis.reflected_motor_inertia or 0.0
    return Model(
        inertia, motor, axis.viscous_friction or 0.0, motion.gravity, torque, slope, np.zeros_like(motion.effort)
    )


def simulated(patches: Sequence[Patch], joint: str = JOINT) -> Array:
    """Filtered torque (n, rows) of the twin."""
    return measured(joint)[2].rows(torque(patches, joint))


def torque(patches: Sequence[Patch], joint: str = JOINT) -> Array:
    """The same before the filter (n, t)."""
    robot, sweeps, motion = measured(joint)
    fitted, index = model(joint), robot.index(joint)
    entry = axis_entry(robot, joint, float(fitted.inertia.mean()), fitted.viscous, patches)
    pull = gravity(robot, entry.links, index, motion.poses)[motion.pose_index]
    runs = [TwinRun(k, entry, float(fitted.inertia[k]), (float(x), float(y))) for k, (x, y) in enumerate(pull)]
    return laid_out(motion, torques(robot, joint, ways(sweeps), runs))


def column(name: str, parameters: dict[str, float], joint: str = JOINT, motion: Tracks | None = None) -> Array:
    """Filtered torque (n, rows) of the catalogue."""
    motion, rigid, effect = motion or measured(joint)[2], model(joint), CATALOGUE[name]
    shape = tuple(parameters[entry.name] for entry in effect.shape(motion, rigid))
    coefficients = [parameters.get(key, 0.0) for key, _ in effect.coefficients(motion)]
    columns = effect.columns(motion, rigid, shape)
    return motion.rows(np.sum([value * one for value, one in zip(coefficients, columns, strict=True)], axis=0))


def whole(name: str, parameters: dict[str, float], joint: str = JOINT) -> dict[str, float]:
    """With zero for every coefficient that is not told."""
    return {key: 0.0 for key, _ in CATALOGUE[name].coefficients(measured(joint)[2])} | parameters


def rms(values: Array, joint: str = JOINT) -> float:
    return float(np.sqrt(np.mean(values[measured(joint)[2].usable] ** 2)))


def test_every_effect_with_columns_has_a_case() -> None:
    assert set(CASES) == {name for name, effect in CATALOGUE.items() if not effect.by_load}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_a_column_is_what_the_simulator_does(name: str) -> None:
    parameters, part = CASES[name]
    joint = JOINTS.get(name, JOINT)
    expected, rigid = column(name, parameters, joint), simulated([], joint)
    patch = CATALOGUE[name].scenario(whole(name, parameters, joint), measured(joint)[2], model(joint))
    size, apart = rms(expected, joint), rms(simulated([patch], joint) - rigid - expected, joint)
    print(f"{name}: {size:.3g} N m, {apart / size:.4f} of it apart")
    assert size > 5.0
    assert apart < part * size


@pytest.mark.slow
def test_a_spring_that_hardens_by_the_torque_it_has_carried() -> None:
    """The simulator steps through resonances twice as stiff; the column takes the twist from the torque measured."""
    parameters = CASES["joint_elasticity"][0] | {"compliance": 4e-6, "hardening": 8.0}
    patch = CATALOGUE["joint_elasticity"].scenario(parameters, measured()[2], model())
    told = replace(measured()[2], effort=torque([patch]))
    expected = simulated([patch]) - simulated([])
    linear = column("joint_elasticity", parameters | {"hardening": 0.0}, motion=told)
    assert rms(column("joint_elasticity", parameters, motion=told) - expected) < 0.05 * rms(expected)
    assert rms(linear - expected) > 0.2 * rms(expected)


def test_a_torque_that_comes_early_is_a_speed_that_comes_late() -> None:
    early = {"delay": -1.5e-3, "expansion_point": -1.5e-3}
    expected = column("measurement_delay", early)
    patch = CATALOGUE["measurement_delay"].scenario(early, measured()[2], model())
    assert patch == {"measurement": {"velocity_delay": 1.5e-3}}
    assert rms(simulated([patch]) - simulated([]) - expected) < 0.05 * rms(expected)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("stribeck_friction", {"extra": -3.0}),
        ("load_dependent_friction", {"load_dependence": -0.1}),
        ("friction_temperature_drift", {"coulomb_change": 4.0}),
        ("hose_spring", {"stiffness": -4.0}),
        ("nonlinear_viscous_friction", {"velocity": 10.0}),
    ],
)
def test_what_no_scenario_can_hold_is_said(name: str, wrong: dict[str, float]) -> None:
    parameters = CASES[name][0] | wrong
    with pytest.raises(Inexpressible, match=r"no power of the speed|is not (above|below) 0"):
        CATALOGUE[name].scenario(parameters, measured()[2], model())


def test_what_lies_beyond_a_limit_is_put_on_it_and_said() -> None:
    patch = CATALOGUE["asymmetric_friction"].scenario(
        {"coulomb": 1.0, "coulomb_difference": 2.0, "viscous_difference": 0.0}, measured()[2], model()
    )
    entry = axis_entry(measured()[0], JOINT, 500.0, 200.0, [patch])
    assert entry.held == ("motor_friction.backward_coulomb = -1 is held at 0",)
    assert entry.train["motor_friction"] == {"viscous": 200.0, "coulomb": 3.0, "backward_coulomb": 0.0}


def test_a_wrong_torque_constant_scales_all_but_gravity() -> None:
    """The drive tells what it told, whatever share of it is true; here alone, gravity is told to the twin as true."""
    patches = [
        CATALOGUE[name].scenario(whole(name, CASES[name][0]), measured()[2], model())
        for name in ("coulomb_friction", "cogging_torque", "hose_spring", "presliding_hysteresis")
    ]
    gain = CATALOGUE["torque_constant_error"].scenario({"gain_error": 0.1}, measured()[2], model())
    motion = measured()[2]
    apart = simulated([*patches, gain]) - simulated(patches) - motion.rows(0.1 * motion.gravity)
    assert rms(apart) < 1e-3


def test_a_spring_that_the_simulator_cannot_follow_is_told() -> None:
    robot, sweeps, _ = measured()
    train = {"motor_inertia": 0.01, "spring": {"stiffness": 1e12, "damping": 0.0}}
    entry = AxisEntry(cast("TrainEntry", train), {}, {}, (), 1.0)
    with pytest.raises(Inexpressible, match="does not stay with its motor"):
        torques(robot, JOINT, ways(sweeps), [TwinRun(0, entry, 200.0, (0.0, 0.0))])


HEAVIER = 1.03  # inertia against CAD
PULLS = 4.0  # kg m, by which a first moment of the third link is off where there is an error of gravity
PARAMETERS = {name: parameters for name, (parameters, _) in CASES.items()}
PARAMETERS |= {"gravity_error": {"cosine": 40.0, "sine": 40.0}, "torque_constant_error": {"gain_error": 0.04}}


def load_of(joint: str, *names: str) -> NDArray[np.float64]:
    """(3, m) as a fit would have it."""
    robot, _, motion = measured(joint)
    parameters = nominal_parameters(robot)
    parameters[21] += PULLS if "gravity_error" in names else 0.0
    load = (load_rows(robot, robot.index(joint), motion.poses) @ parameters).reshape(3, -1)
    load[0] = HEAVIER * nominal_load(robot, joint, motion.poses)[0]
    return load


def axis_of(joint: str, *names: str, verdict: str = "named", torques: str = "recorded") -> dict[str, Any]:
    """A diagnosed axis with these effects, the first of which was known."""
    _, _, motion = measured(joint)
    patches = {name: CATALOGUE[name].scenario(whole(name, PARAMETERS[name]), motion, model(joint)) for name in names}
    effects: list[Any] = [{"effect": name, "parameters": {}, "scenario": patch} for name, patch in patches.items()]
    told = [*zip(motion.poses.tolist(), *load_of(joint, *names).tolist(), strict=True)]
    fit = {
        "inertia": [{"pose": pose, "value": inertia, "std": 1.0} for pose, inertia, _, _ in told],
        "gravity": [{"pose": pose, "torque": torque, "slope": slope} for pose, _, torque, slope in told],
        "viscous_friction": {"value": 190.0, "std": 1.0},
        "torques": torques,
    }
    return axis_document() | {"verdict": verdict, "known": effects[:1], "effects": effects[1:], "fit": fit}


def test_the_loaded_scenario_needs_the_torque_of_the_twin(tmp_path: Path) -> None:
    names = ("gravity_error", "stribeck_friction", "cogging_torque", "effort_offset")
    robot, sweeps, motion = measured()
    document = model_document(robot, diagnosis(**{JOINT: axis_of(JOINT, *names)}))
    assert [effect.effect for effect in document.axes[JOINT].effects] == list(names)
    told = DiagnosedModel(robot=robot.name, effects={}, scenario=document.scenario)
    write_scenario(tmp_path / "twin.yaml", robot, told)
    scenario = load_scenario(tmp_path / "twin.yaml")
    body = RigidBody(scenario)
    chosen = [0, 4]  # a sweep of each direction
    axes = [moving_axis(scenario, body, JOINT, sweeps[k].spec.pose) for k in chosen]
    motions = [Motion(r.time, r.position, r.velocity) for r in (sweeps[k].recording for k in chosen)]
    theirs = replay(axes, motions, scenario.measurement)
    patches = [cast("Patch", effect.scenario) for effect in document.axes[JOINT].effects]
    inertia = HEAVIER * model().inertia
    entry = axis_entry(robot, JOINT, float(inertia.mean()), 190.0, patches)
    pull = gravity_of_fit(motion.poses, robot.index(JOINT), *load_of(JOINT, *names)[1:])[motion.pose_index]
    runs = [TwinRun(k, entry, float(inertia[k]), (float(pull[k, 0]), float(pull[k, 1]))) for k in chosen]
    ours = torques(robot, JOINT, ways(sweeps), runs)
    for k, axis, one, other in zip(chosen, axes, theirs, ours, strict=True):
        # rigid links give a pose's inertia nearly; all else is the same
        more = inertia[k] - axis.load_inertia - axis.motor_inertia
        assert abs(more) < 0.01 * inertia[k]
        np.testing.assert_allclose(one + more * np.gradient(sweeps[k].recording.velocity, 1e-3), other, atol=0.3)


def test_links_give_gravity_on_all_axes_at_once() -> None:
    """Two axes that each say what hangs on them is otherwise than CAD has it: one set of links for both."""
    robot, joints = max100(), ("joint_2", "joint_3")
    document = model_document(robot, diagnosis(**{joint: axis_of(joint, "gravity_error") for joint in joints}))
    for joint in joints:
        poses, index = measured(joint)[2].poses, robot.index(joint)
        bare = gravity(robot, {}, index, poses)
        wanted = gravity_of_fit(poses, index, *load_of(joint, "gravity_error")[1:])
        given = gravity(robot, cast("Links", document.scenario["links"]), index, poses)
        assert np.abs(wanted - bare).max() > 5.0
        np.testing.assert_allclose(given, wanted, atol=0.03 * np.abs(wanted - bare).max())


def test_axes_share_a_scenario() -> None:
    """A spring on one means a spring on each; what is ambiguous is in no model; a parent's axes stay."""
    robot = max100()
    elastic, other = axis_of("joint_2", "joint_elasticity"), axis_of("joint_3", "effort_offset")
    open_case = axis_of("joint_1", "effort_offset", "coulomb_friction", verdict="ambiguous")
    parent = model_document(robot, diagnosis(joint_2=elastic))
    document = model_document(robot, diagnosis(joint_1=open_case, joint_3=other), parent=parent)
    assert set(document.axes) == {"joint_2", "joint_3"}
    axes: Any = document.scenario["axes"]
    assert axes["joint_2"]["train"]["spring"]["stiffness"] < axes["joint_3"]["train"]["spring"]["stiffness"]
    every = model_document(robot, diagnosis(joint_1=open_case), joints=["joint_1"])
    assert [effect.effect for effect in every.axes["joint_1"].effects] == ["effort_offset"]
    yaml.safe_dump(document.as_json())


def test_a_test_mass_leaves_true_torques() -> None:
    """Torques that were put right are not divided by the gain again."""
    names = ("torque_constant_error", "coulomb_friction")
    scenarios: list[Any] = [
        model_document(max100(), diagnosis(**{JOINT: axis_of(JOINT, *names, torques=torques)})).scenario
        for torques in ("recorded", "true")
    ]
    recorded, true = (scenario["axes"][JOINT]["train"] for scenario in scenarios)
    assert recorded["effort_gain"] == true["effort_gain"] == 1.04
    assert true["motor_friction"]["coulomb"] == 50.0
    assert abs(recorded["motor_friction"]["coulomb"] - 50.0 / 1.04) < 1e-9
