"""What stands in the exported files, how sweepid reads them again, and what is refused."""

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np
import pytest
import yaml

from service import BadInput
from service.formats.export import identified_model, model_files, write_model
from service.formats.export.files import quaternion
from service.identification.estimates.standard_parameters import AxisWorth, Worth
from service.identification.model.physical_consistency import is_physical
from service.model import INERTIAL_NAMES, Axis, Robot, RobotDescription, build_robot, read_chain, rotation_about
from service.model.configuration import read_robot
from service.model.urdf import read_inertial
from tests.unit.service.export.conftest import estimate_of

_mujoco = cast(Any, mujoco)  # a binary module without type stubs

RMSE = dict.fromkeys(("reference_measured", "identified_measured", "reference_identified"), 1.0)
MOTORS = np.array([60.0, 70.0, 20.0, 4.0, 0.0, 2.0])


@pytest.fixture
def document(max100: Robot) -> dict[str, Any]:
    return estimate_of(max100, 1.1 * max100.chain.inertial, MOTORS)


def test_sweepid_reads_the_robot_again(max100: Robot, document: dict[str, Any], tmp_path: Path) -> None:
    write_model(tmp_path / "out", identified_model(max100, document))
    again = read_robot(tmp_path / "out/robot.yaml")
    np.testing.assert_allclose(again.chain.inertial, 1.1 * max100.chain.inertial, rtol=1e-12, atol=1e-12)
    motors = [axis.reflected_motor_inertia for axis in again.axes]
    kept = max100.axes[4].reflected_motor_inertia  # found to be 0: not measured, not known
    assert motors == pytest.approx([60.0, 70.0, 20.0, 4.0, kept, 2.0], rel=1e-7)
    assert [axis.viscous_friction for axis in again.axes] == [150.5, 210.0, 90.0, 30.0, 26.0, 15.0]
    for joint, old in zip(again.chain.joints, max100.chain.joints, strict=True):
        assert (joint.name, joint.link, joint.lower, joint.upper) == (old.name, old.link, old.lower, old.upper)


def test_links_fixed_to_each_other_share_the_total(max100: Robot, document: dict[str, Any]) -> None:
    text = model_files(identified_model(max100, document))["model.urdf"]
    root = ET.fromstring(text)
    masses = {
        link.get("name"): float(mass.get("value", "0")) for link in root.findall("link") for mass in link.iter("mass")
    }
    assert masses["link_6"] + masses["tool"] == pytest.approx(1.1 * (2.6 + 6.6))
    assert masses["tool"] == pytest.approx(1.1 * 6.6, rel=0.05)  # about ten per cent more, as the whole
    assert masses["base"] == 1010  # nothing turns it: as it was
    np.testing.assert_allclose(read_chain(text).inertial, 1.1 * max100.chain.inertial, rtol=1e-12, atol=1e-12)
    assert "upper arm" in text  # comments and shapes of the original
    assert len(root.findall("link/collision")) == len(ET.fromstring(max100.urdf_text).findall("link/collision"))


def test_any_physical_total_is_shared_out(max100: Robot, document: dict[str, Any]) -> None:
    """Lighter than the nominal tool alone: no share may become negative."""
    small = 0.3 * max100.chain.inertial[5] * [1, 1, 1, 1, 2, 2, 2, 2, 2, 2]
    document["standard_parameters"]["links"]["link_6"] = dict(zip(INERTIAL_NAMES, small.tolist(), strict=True))
    text = model_files(identified_model(max100, document))["model.urdf"]
    np.testing.assert_allclose(read_chain(text).inertial[5], small, rtol=1e-9, atol=1e-12)
    links = {link.get("name"): link for link in ET.fromstring(text).findall("link")}
    assert is_physical(np.array([read_inertial(links[name], "urdf") for name in ("link_6", "tool")])).all()


def test_every_file_holds_what_it_can_of_the_accepted_model(max100: Robot, document: dict[str, Any]) -> None:
    """Effects of which several contain dry friction; those that no target can hold are in the YAML."""

    def effect(axis: str, name: str, **values: float) -> dict[str, Any]:
        parameters = {key: {"value": value, "std": 0.1, "unit": "x"} for key, value in values.items()}
        return {"axis": axis, "effect": name, "parameters": parameters, "used": bool(values), "how": ""}

    known = {"compliance": {"value": 1e-6, "std": 1e-7}, "damping_time": {"value": 2e-3, "std": 1e-3}}
    document["axes"]["joint_1"]["drive_train"] = known
    document["effects"] = [
        effect("joint_1", "coulomb_friction", coulomb=100.0),
        effect("joint_1", "stribeck_friction", coulomb=120.0, extra=9.0),
        effect("joint_1", "measurement_delay", delay=1e-3),
        effect("joint_1", "effort_offset", offset=-7.0),
        effect("joint_2", "coulomb_friction"),
        effect("joint_3", "hose_spring", stiffness=200.0, torque_at_zero=-50.0),
    ]
    files = model_files(identified_model(max100, document))
    urdf = {joint.get("name"): joint.find("dynamics") for joint in ET.fromstring(files["model.urdf"]).iter("joint")}
    first = urdf["joint_1"]
    assert first is not None
    assert (first.get("damping"), first.get("friction"), urdf["joint_2"]) == ("150.5", "120.0", None)
    loaded = _mujoco.MjModel.from_xml_string(files["model.xml"])
    np.testing.assert_allclose(loaded.dof_frictionloss, [120, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(loaded.dof_damping, [150.5, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(loaded.actuator_biasprm[:, 0], [7, 0, 0, 0, 0, 0])
    still = _mujoco.MjData(loaded)
    for still.qpos[2], passive in ((0.0, 50.0), (1.0, -150.0)):  # the drive holds k q + torque_at_zero
        _mujoco.mj_forward(loaded, still)
        np.testing.assert_allclose(still.qfrc_spring, [0, 0, passive, 0, 0, 0], atol=1e-9)
    joints = yaml.safe_load(files["model.yaml"])["joints"]
    assert joints["joint_1"]["offset"] == -7.0
    assert joints["joint_1"]["gear"] == pytest.approx({"stiffness": 1e6, "damping": 2e3})
    elastic = _mujoco.MjModel.from_xml_string(files["model_elastic.xml"])
    gear = elastic.joint("joint_1_gear")
    assert (elastic.nv, float(gear.stiffness[0]), float(gear.damping[0])) == (7, 1e6, pytest.approx(2e3))
    state, full = _mujoco.MjData(elastic), np.zeros((7, 7))
    _mujoco.mj_forward(elastic, state)
    _mujoco.mj_fullM(elastic, state, full)
    # the motor turns the load too, the gear the load alone
    assert full[0, 0] - full[1, 1] == pytest.approx(MOTORS[0])
    assert full[0, 1] == pytest.approx(full[1, 1])
    assert (joints["joint_1"]["dry_friction"], joints["joint_2"]["dry_friction"]) == (120.0, None)
    assert joints["joint_1"]["effects"]["measurement_delay"]["delay"] == {"value": 1e-3, "std": 0.1, "unit": "x"}


@pytest.mark.parametrize(
    ("error", "told"), [(9.9, ""), (10.4, ""), (11.0, "gravity torque of j2: expected error 11, CAD's 10")]
)
def test_a_gravity_torque_that_is_worse_than_cads_is_told(error: float, told: str) -> None:
    worth = AxisWorth("j2", Worth(1, 0, 0, 0), Worth(100.0, 20.0, error, 10.0))
    assert worth.warning.startswith(told)
    assert bool(worth.warning) == bool(told)


def test_yaml_holds_all_parameters_and_no_worth_for_other_base_parameters(
    max100: Robot, document: dict[str, Any]
) -> None:
    model = identified_model(max100, document)
    content = yaml.safe_load(model_files(model)["model.yaml"])
    assert (model.worth, model.warnings, content["workspace"]) == ((), (), {})
    link = content["links"]["link_2"]
    assert link["mass"] == pytest.approx(1.1 * 176)
    np.testing.assert_allclose(link["centre_of_mass"], [0, 0.02, 0.5386])
    np.testing.assert_allclose(np.diag(link["inertia_about_centre"]), [32.95314, 33.31581, 1.84052])
    assert content["joints"]["joint_1"]["motor_inertia"] == 60.0
    assert content["joints"]["joint_2"]["viscous_friction"] is None
    assert content["base_parameters"] == [{"name": "m(a)", "symbolic": "m(a)", "value": 1.0, "std": None}]
    assert content["symbols"]["l1"] == {"value": 0.5, "unit": "m", "meaning": "from a to b"}


def test_shapes_are_there_to_look_at(max100: Robot, document: dict[str, Any]) -> None:
    loaded = _mujoco.MjModel.from_xml_string(model_files(identified_model(max100, document))["model.xml"])
    root = ET.fromstring(max100.urdf_text)
    assert loaded.ngeom == len(root.findall("link/collision"))
    state = _mujoco.MjData(loaded)
    _mujoco.mj_forward(loaded, state)
    assert state.ncon == 0  # nothing collides by them
    places = {tuple(np.round(place, 4)) for place in state.geom_xpos}
    # by hand, all joints at 0: the floor, and the tip of the tool 0.345 beyond joint 6's 1.63, at 2.15 above the floor
    assert (0.0, 0.0, -0.06) in places
    assert (1.945, 0.0, 2.15) in places


def test_a_shape_of_a_fixed_link_is_placed_and_has_half_its_length() -> None:
    """A bracket turned by 90 degrees about z: its x is y of the table, and the cylinder 0.4 m long."""
    shape = '<collision><origin xyz="0.5 0 0"/><geometry><cylinder radius="0.1" length="0.4"/></geometry></collision>'
    text = f"""<robot name="r"><link name="base"/><link name="table"/><link name="bracket">{shape}</link>
    <joint name="c" type="continuous"><parent link="base"/><child link="table"/><axis xyz="0 0 1"/></joint>
    <joint name="f" type="fixed"><parent link="table"/><child link="bracket"/>
    <origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/></joint></robot>"""
    axes = (Axis(joint="c", gear_ratio=50.0, rated_effort=10.0),)
    robot = build_robot(RobotDescription(name="table", urdf="r.urdf", axes=axes), text)
    link = np.array([[4.0, 0, 0, 0, 1.0, 0, 1.0, 0, 0, 1.5]])
    made = identified_model(robot, estimate_of(robot, link, np.array([0.2])))
    loaded = _mujoco.MjModel.from_xml_string(model_files(made)["model.xml"])
    np.testing.assert_allclose(loaded.geom_pos, [[0.0, 0.5, 1.0]], atol=1e-12)
    np.testing.assert_allclose(loaded.geom_size[0, :2], [0.1, 0.2])
    assert not loaded.jnt_limited[0]  # a continuous joint


def test_quaternions_at_every_angle() -> None:
    rng = np.random.default_rng(0)
    for angle in (0.0, 1e-9, 0.3, np.pi / 2, np.pi - 1e-9, np.pi, -2.0):
        axis = rng.normal(size=3)
        rotation = rotation_about(axis / np.linalg.norm(axis), np.asarray(angle))
        back = np.zeros(9)
        _mujoco.mju_quat2Mat(back, quaternion(rotation))
        np.testing.assert_allclose(back.reshape(3, 3), rotation, atol=1e-12)


NAN = [{"name": "a", "value": float("nan"), "std": 1.0}]


@pytest.mark.parametrize(
    ("keys", "value", "reason"),
    [
        (["axes"], {}, "contains no identified parameters"),
        (["axes", "joint_9"], {"inertia": [], "rmse_percent": RMSE}, "joint_9: unknown joint"),
        (["standard_parameters", "links"], {}, "ten parameters of link link_1"),
        (["standard_parameters", "links", "link_4", "m"], 0.0, r"mass of link link_4 is 0.0 kg"),
        (["standard_parameters", "motor_inertias"], {}, "the motor inertia of joint joint_1"),
        (["physical", "deviation_in_std"], None, "contains no identified parameters"),
        (["base_parameters"], [{"name": "a"}], "base_parameters.0.value"),
        (["base_parameters"], NAN, "base_parameters.0.value: Input should be a finite number, got nan"),
    ],
)
def test_an_estimate_of_something_else_is_refused(
    max100: Robot, document: dict[str, Any], keys: list[str], value: object, reason: str
) -> None:
    part = document
    for key in keys[:-1]:
        part = part[key]
    part[keys[-1]] = value
    with pytest.raises(BadInput, match=reason):
        identified_model(max100, document)
