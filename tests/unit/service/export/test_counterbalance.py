"""The counterbalance of an axis: its torque against MuJoCo's tendons, its place in recordings, its files."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

from service import BadInput
from service.formats.export.files import as_mjcf, as_side_file, as_yaml
from service.formats.export.model import IdentifiedModel, identified_model
from service.model import Array, Recording, Robot, RobotDescription, Sweep, SweepSpec, build_robot
from service.model.counterbalance import positions
from simulator.effects import Counterbalances
from simulator.scenario import Strut
from tests.unit.service.export.conftest import estimate_of

JOINT, INDEX = "joint_2", 1
SPRING = {"anchor": [0.4, 0.1, 1.0], "attachment": [0.05, 0.02, 0.25], "force": 9000.0, "length": 0.5, "rate": 3e4}
GAS = {**SPRING, "rate": 0.0, "column": 0.9, "exponent": 1.2}


def balanced(robot: Robot, own: dict[str, Any], joint: str = JOINT) -> Robot:
    description = robot.description.model_dump(mode="json")
    next(axis for axis in description["axes"] if axis["joint"] == joint)["counterbalance"] = own
    return build_robot(RobotDescription.model_validate(description), robot.urdf_text)


def exported(robot: Robot, effects: tuple[dict[str, Any], ...] = ()) -> IdentifiedModel:
    own = estimate_of(robot, robot.chain.inertial, np.zeros(len(robot.axes)))
    return identified_model(robot, own | {"effects": effects})


def of_tendon(model: IdentifiedModel, angle: Array) -> Array:
    """Torque that holds the axis against the tendon alone, N m."""
    plant = mujoco.MjModel.from_xml_string(as_mjcf(model))
    data, held = mujoco.MjData(plant), np.empty_like(angle)
    for k, position in enumerate(angle):
        data.qpos[INDEX] = position
        mujoco.mj_forward(plant, data)
        held[k] = -data.qfrc_spring[INDEX]
    return held


def accepted(share: float, rate: float) -> dict[str, Any]:
    values = {"share": (share, ""), "rate": (rate, "N/m")}
    parameters = {name: {"value": value, "std": 0.01, "unit": unit} for name, (value, unit) in values.items()}
    return {"axis": JOINT, "effect": "counterbalance", "parameters": parameters, "used": False, "how": ""}


@pytest.mark.parametrize("exchanged", [False, True])
def test_a_spring_is_the_tendon_of_mujoco(max100: Robot, exchanged: bool) -> None:
    """The lever from a closed formula, MuJoCo's from its kinematics; either point may be the farther one."""
    own = SPRING | ({"anchor": [0.37, 0.1, 0.7], "attachment": [0.1, -0.1, 0.8]} if exchanged else {})
    robot = balanced(max100, own)
    angle = positions(robot.chain.joints[INDEX])[::20]
    effort = robot.counterbalance_effort(INDEX, angle)
    assert np.ptp(effort) > 2000.0
    np.testing.assert_allclose(of_tendon(exported(robot), angle), effort, atol=1e-6 * np.abs(effort).max())


@pytest.mark.parametrize("own", [GAS, {**SPRING, "force": 2e4}, {**GAS, "force": -9000.0, "column": -0.9}])
def test_gas_is_a_tendon_within_what_the_warning_says(max100: Robot, own: dict[str, Any]) -> None:
    """And so is a spring whose free length would be below 0, and a strut that pushes."""
    robot = balanced(max100, own)
    angle = positions(robot.chain.joints[INDEX])
    effort, model = robot.counterbalance_effort(INDEX, angle), exported(robot)
    off = np.abs(of_tendon(model, angle) - effort).max()
    assert off == pytest.approx(model.tendon(JOINT)[2], rel=1e-3, abs=1e-6 * np.abs(effort).max())
    assert off < 0.03 * np.abs(effort).max()
    assert any(f"counterbalance of {JOINT}: URDF cannot hold it" in line for line in model.warnings)


def test_an_accepted_effect_corrects_it_in_every_file(max100: Robot) -> None:
    robot = balanced(max100, SPRING)
    model = exported(robot, (accepted(-0.2, 3000.0),))
    own = {"force": 0.8 * 9000.0, "rate": 0.8 * 3e4 + 3000.0}
    told = yaml.safe_load(as_yaml(model))["joints"][JOINT]["counterbalance"]
    assert (told["force"], told["rate"], told["anchor"]) == (own["force"], own["rate"], SPRING["anchor"])
    side = RobotDescription.model_validate(yaml.safe_load(as_side_file(model)))
    assert side.axes[INDEX].counterbalance == model.counterbalances[JOINT]
    right = balanced(max100, SPRING | own).counterbalance_effort(INDEX, np.array([-0.5, 0.3, 1.2]))
    np.testing.assert_allclose(of_tendon(model, np.array([-0.5, 0.3, 1.2])), right, rtol=1e-9)


def test_one_that_the_robot_file_lacks_is_told(max100: Robot) -> None:
    model = exported(max100, (accepted(1.0, 0.0),))
    assert not model.counterbalances
    assert any(f"counterbalance of {JOINT}: the robot file has none" in line for line in model.warnings)
    assert "tendon" not in as_mjcf(model)


def test_the_simulator_has_the_same_by_its_own_formula(max100: Robot) -> None:
    robot = balanced(max100, GAS)
    own = robot.axes[INDEX].counterbalance
    assert own is not None
    entry = Strut.model_validate(own.entry(own.lever(robot.chain.joints[INDEX])))
    load = np.linspace(-1.0, 1.4, 50)[:, None] * [0.0, 1.0]
    torque = Counterbalances([(), (entry, entry)]).torque(load)
    assert not torque[:, 0].any()
    np.testing.assert_allclose(torque[:, 1], 2 * robot.counterbalance_effort(INDEX, load[:, 1]), rtol=1e-9, atol=1e-6)


def test_recordings_lose_its_effort_and_nothing_else(max100: Robot) -> None:
    time = np.arange(100) / 100
    spec = SweepSpec(id="1", axis=JOINT, pose=(0.0,) * 6, offset_velocity=0.1, sample_rate=100.0)
    sweep = Sweep(spec, Recording(time, 50 + time, 0.1 + 0 * time, 0.1 * time))
    assert max100.without_counterbalance(sweep) is sweep
    robot = balanced(max100, SPRING)
    bare = robot.without_counterbalance(sweep)
    np.testing.assert_allclose(
        sweep.recording.effort - bare.recording.effort, robot.counterbalance_effort(INDEX, 0.1 * time)
    )
    assert replace(bare.recording, effort=time) == replace(sweep.recording, effort=time)


@pytest.mark.parametrize(
    ("own", "joint", "reason"),
    [
        ({**SPRING, "attachment": [0.0, 0.3, 0.0]}, JOINT, "one of its points is on the axis"),
        ({**GAS, "column": 0.15}, JOINT, "is used up"),
        ({**SPRING, "anchor": [0.35, 0.0, 0.65], "attachment": [0.0, 0.0, 0.25]}, JOINT, "at the same place"),
        ({**GAS, "column": 0.0}, JOINT, "column must not be 0"),
        ({**SPRING, "force": 0.0, "rate": 0.0}, JOINT, "carry nothing"),
    ],
)
def test_what_cannot_be_is_refused(max100: Robot, own: dict[str, Any], joint: str, reason: str) -> None:
    with pytest.raises((BadInput, ValueError), match=reason):
        balanced(max100, own, joint)
