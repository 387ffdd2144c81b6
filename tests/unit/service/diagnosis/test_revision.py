"""A model revision: the scenario made of it loads, and the machine it describes needs the twin's torque."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from service.cli.recordings.scenario_file import write_scenario
from service.diagnosis import model_document
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.patch import Patch
from service.diagnosis.model.link_deviations import gravity, gravity_of_fit
from service.diagnosis.model.scenario import axis_entry
from service.diagnosis.model.twin import Run, torques, ways
from service.diagnosis.rows.rigid import load_rows, nominal_load, nominal_parameters
from service.results.diagnosis import DiagnosedModel
from simulator import Motion, load_scenario, replay
from simulator.moving_axis import moving_axis
from simulator.rigid_body import RigidBody
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.test_twin import CASES, JOINT, measured, model, whole

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
    """As `axis_document` has it, as far as a model needs it."""
    _, _, motion = measured(joint)
    effects = [
        {"effect": name, "scenario": CATALOGUE[name].scenario(whole(name, PARAMETERS[name]), motion, model(joint))}
        for name in names
    ]
    told = [*zip(motion.poses.tolist(), *load_of(joint, *names).tolist(), strict=True)]
    fit = {
        "inertia": [{"pose": pose, "value": inertia, "std": 1.0} for pose, inertia, _, _ in told],
        "gravity": [{"pose": pose, "torque": torque, "slope": slope} for pose, _, torque, slope in told],
        "viscous_friction": {"value": 190.0, "std": 1.0},
        "torques": torques,
    }
    return {"verdict": verdict, "known": effects[:1], "effects": effects[1:], "fit": fit}


def test_the_loaded_scenario_needs_the_torque_of_the_twin(tmp_path: Path) -> None:
    names = ("gravity_error", "stribeck_friction", "cogging_torque", "effort_offset")
    robot, sweeps, motion = measured()
    document = model_document(robot, {"axes": {JOINT: axis_of(JOINT, *names)}})
    assert [effect["effect"] for effect in document["axes"][JOINT]["effects"]] == list(names)
    told = DiagnosedModel(robot=robot.name, effects={}, scenario=document["scenario"])
    write_scenario(tmp_path / "twin.yaml", robot, told)
    scenario = load_scenario(tmp_path / "twin.yaml")
    body = RigidBody(scenario)
    chosen = [0, 4]  # a sweep of each direction
    axes = [moving_axis(scenario, body, JOINT, sweeps[k].spec.pose) for k in chosen]
    motions = [
        Motion(s.recording.time, s.recording.position, s.recording.velocity) for s in (sweeps[k] for k in chosen)
    ]
    theirs = replay(axes, motions, scenario.measurement)
    patches: list[Patch] = [effect["scenario"] for effect in document["axes"][JOINT]["effects"]]
    inertia = HEAVIER * model().inertia
    entry = axis_entry(robot, JOINT, float(inertia.mean()), 190.0, patches)
    pull = gravity_of_fit(motion.poses, robot.index(JOINT), *load_of(JOINT, *names)[1:])[motion.pose_index]
    runs = [Run(k, entry, float(inertia[k]), (float(pull[k, 0]), float(pull[k, 1]))) for k in chosen]
    ours = torques(robot, JOINT, ways(sweeps), runs)
    for k, axis, one, other in zip(chosen, axes, theirs, ours, strict=True):
        # rigid links give a pose's inertia nearly; all else is the same
        more = inertia[k] - axis.load_inertia - axis.motor_inertia
        assert abs(more) < 0.01 * inertia[k]
        np.testing.assert_allclose(one + more * np.gradient(sweeps[k].recording.velocity, 1e-3), other, atol=0.3)


def test_links_give_gravity_on_all_axes_at_once() -> None:
    """Two axes that each say what hangs on them is otherwise than CAD has it: one set of links for both."""
    robot, joints = max100(), ("joint_2", "joint_3")
    document = model_document(robot, {"axes": {joint: axis_of(joint, "gravity_error") for joint in joints}})
    for joint in joints:
        poses, index = measured(joint)[2].poses, robot.index(joint)
        bare, wanted = (
            gravity(robot, {}, index, poses),
            gravity_of_fit(poses, index, *load_of(joint, "gravity_error")[1:]),
        )
        given = gravity(robot, document["scenario"]["links"], index, poses)
        assert np.abs(wanted - bare).max() > 5.0
        np.testing.assert_allclose(given, wanted, atol=0.03 * np.abs(wanted - bare).max())


def test_axes_share_a_scenario() -> None:
    """A spring on one means a spring on each; what is ambiguous is in no model; a parent's axes stay."""
    robot = max100()
    elastic, other = axis_of("joint_2", "joint_elasticity"), axis_of("joint_3", "effort_offset")
    open_case = axis_of("joint_1", "effort_offset", "coulomb_friction", verdict="ambiguous")
    parent = model_document(robot, {"axes": {"joint_2": elastic}})
    document = model_document(robot, {"axes": {"joint_1": open_case, "joint_3": other}}, parent=parent)
    assert set(document["axes"]) == {"joint_2", "joint_3"}
    axes = document["scenario"]["axes"]
    assert axes["joint_2"]["train"]["spring"]["stiffness"] < axes["joint_3"]["train"]["spring"]["stiffness"]
    every = model_document(robot, {"axes": {"joint_1": open_case}}, joints=["joint_1"])
    assert [effect["effect"] for effect in every["axes"]["joint_1"]["effects"]] == ["effort_offset"]
    yaml.safe_dump(document)


def test_a_test_mass_leaves_true_torques() -> None:
    """Torques that were put right are not divided by the gain again."""
    robot = max100()
    documents = {
        torques: model_document(
            robot, {"axes": {JOINT: axis_of(JOINT, "torque_constant_error", "coulomb_friction", torques=torques)}}
        )
        for torques in ("recorded", "true")
    }
    recorded, true = (documents[key]["scenario"]["axes"][JOINT]["train"] for key in ("recorded", "true"))
    assert recorded["effort_gain"] == true["effort_gain"] == 1.04
    assert true["motor_friction"]["coulomb"] == 50.0
    assert abs(recorded["motor_friction"]["coulomb"] - 50.0 / 1.04) < 1e-9
