"""Inertia and gravity of the real links, from MuJoCo (the plant uses no rigid-body code of this project).

The link inertials of the scenario are written into the URDF text, which MuJoCo compiles; J_k(pose) is the diagonal
of its joint-space inertia matrix. With the other joints held, gravity about revolute joint k is A cos q_k + B sin
q_k: two evaluations of MuJoCo's bias force, at q_k = 0 and pi/2, give A and B exactly. Along a prismatic joint it is
constant.
"""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from simulator.scenario import AddedBody, DriveTrain, LinkDeviation, Scenario, ScenarioError, load_scenario
from simulator.waveform import Array


@dataclass(frozen=True, slots=True)
class Gravity:
    """Effort that holds the axis: ``cosine cos q + sine sin q + constant``, N m (prismatic: `constant` alone, N)."""

    cosine: float = 0.0
    sine: float = 0.0
    constant: float = 0.0

    def at(self, position: float) -> float:
        return float(self.cosine * np.cos(position) + self.sine * np.sin(position) + self.constant)


class RigidBody:
    """The real robot as a chain of rigid links. Not thread-safe (one MuJoCo state)."""

    def __init__(self, scenario: Scenario) -> None:
        text = real_urdf(scenario)
        try:
            self._model = mujoco.MjModel.from_xml_string(text)
        except ValueError as error:
            raise ScenarioError(f"scenario {scenario.name}: MuJoCo refuses the robot: {error}") from None
        self._model.opt.gravity[:] = scenario.robot.gravity
        self._data = mujoco.MjData(self._model)
        self._matrix = np.zeros((self._model.nv, self._model.nv))
        names = tuple(self._model.joint(k).name for k in range(self._model.njnt))
        if names != scenario.joints:
            raise ScenarioError(f"scenario {scenario.name}: URDF joints {names} differ from axes {scenario.joints}")
        self._slides = self._model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
        unknown = ~self._slides & (self._model.jnt_type != mujoco.mjtJoint.mjJNT_HINGE)
        if unknown.any():
            raise ScenarioError(
                f"scenario {scenario.name}: joint {names[int(unknown.argmax())]} is neither revolute nor prismatic; "
                "no other joint can be simulated"
            )

    def inertia(self, pose: ArrayLike) -> Array:
        """Load inertia about every joint in one pose (n,): (n,) kg m^2 (prismatic: kg), without motors."""
        return np.diag(self.at(pose)[0]).copy()

    def gravity(self, joint: int, pose: ArrayLike) -> Gravity:
        """Gravity about joint number `joint` as a function of its own position, with the others held at `pose` (n,)."""
        turned = np.array(pose, dtype=float)
        if self._slides[joint]:
            return Gravity(constant=float(self.at(turned)[1][joint]))
        turned[joint] = 0.0
        cosine = self.at(turned)[1][joint]
        turned[joint] = np.pi / 2
        return Gravity(cosine=float(cosine), sine=float(self.at(turned)[1][joint]))

    def at(self, pose: ArrayLike, velocity: ArrayLike = 0.0) -> tuple[Array, Array]:
        """Inertia (n, n) kg m^2, until the next call, and bias effort (n,) N m: Coriolis, centrifugal, gravity."""
        model, data, bias = self._model, self._data, np.empty(self._model.nv)
        data.qpos[:], data.qvel[:] = pose, velocity
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_crb(model, data)
        mujoco.mj_fullM(model, data, self._matrix)
        mujoco.mj_comVel(model, data)
        mujoco.mj_rne(model, data, 0, bias)
        return self._matrix, bias


def real_urdf(scenario: Scenario) -> str:
    """The URDF of the robot with the inertials of the real links, without collision and visual shapes."""
    try:
        root = ET.fromstring(scenario.robot.urdf)
    except ET.ParseError as error:
        raise ScenarioError(
            f"scenario {scenario.name}: the URDF of {scenario.robot.name} is not XML: {error}"
        ) from None
    links = {element.get("name", ""): element for element in root.findall("link")}
    unknown = sorted(set(scenario.links) - set(links))
    if unknown:
        raise ScenarioError(f"scenario {scenario.name}: links {unknown} are not in the URDF: {sorted(links)}")
    for name, link in links.items():
        for shape in link.findall("collision") + link.findall("visual"):
            link.remove(shape)
        if name in scenario.links:
            _deviate(link, scenario.links[name])
    return ET.tostring(root, encoding="unicode")


def _deviate(link: ET.Element, deviation: LinkDeviation) -> None:
    mass, centre, inertia = _read_inertial(link)
    mass, centre, inertia = mass * deviation.mass, centre + deviation.shift, inertia * deviation.inertia
    for body in deviation.added:
        mass, centre, inertia = _join((mass, centre, inertia), _bar(body))
    old = link.find("inertial")
    if old is not None:
        link.remove(old)
    element = ET.SubElement(link, "inertial")
    ET.SubElement(element, "origin", xyz=" ".join(repr(float(x)) for x in centre), rpy="0 0 0")
    ET.SubElement(element, "mass", value=repr(float(mass)))
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ET.SubElement(element, "inertia", {key: repr(float(inertia[place])) for key, place in entries.items()})


def _read_inertial(link: ET.Element) -> tuple[float, Array, Array]:
    """Mass, centre of mass and inertia about it, in the link's frame."""
    name = link.get("name")
    element = link.find("inertial")
    if element is None:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    origin, mass, tensor = element.find("origin"), element.find("mass"), element.find("inertia")
    if mass is None or tensor is None:
        raise ScenarioError(f"URDF link {name}: <inertial> needs <mass> and <inertia>")
    centre = np.zeros(3)
    if origin is not None:
        centre = np.array([float(x) for x in origin.get("xyz", "0 0 0").split()])
        if any(float(x) for x in origin.get("rpy", "0 0 0").split()):
            raise ScenarioError(f"URDF link {name}: a turned <inertial> frame cannot be simulated")
    try:
        xx, xy, xz, yy, yz, zz = (float(tensor.attrib[key]) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
        return float(mass.attrib["value"]), centre, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    except (KeyError, ValueError) as error:
        raise ScenarioError(f"URDF link {name}: <inertial> lacks a number: {error}") from None


def _bar(body: AddedBody) -> tuple[float, Array, Array]:
    start, end = np.array(body.start), np.array(body.end)
    length = float(np.linalg.norm(end - start))
    if length == 0:
        raise ScenarioError(f"added body {body.name}: start and end are the same point")
    along = np.outer(end - start, end - start) / length**2
    across = np.eye(3) - along
    inertia = body.mass * (body.radius**2 / 2 * along + (3 * body.radius**2 + length**2) / 12 * across)
    return body.mass, (start + end) / 2, inertia


def _join(a: tuple[float, Array, Array], b: tuple[float, Array, Array]) -> tuple[float, Array, Array]:
    mass = a[0] + b[0]
    centre = (a[0] * a[1] + b[0] * b[1]) / mass
    return mass, centre, _about(a, centre) + _about(b, centre)


def _about(body: tuple[float, Array, Array], point: Array) -> Array:
    """Huygens-Steiner: inertia of (mass, centre, inertia about it) about another point."""
    arm = body[1] - point
    return body[2] + body[0] * (arm @ arm * np.eye(3) - np.outer(arm, arm))


@dataclass(frozen=True, slots=True)
class MovingAxis:
    """A row of the plant. Load inertia in kg m^2 about the joint, without the motor."""

    train: DriveTrain
    gear_ratio: float  # motor revolutions per joint revolution
    load_inertia: float
    gravity: Gravity
    warmth: float = 0.0  # temperature rise of the gear at the start, K

    @property
    def motor_inertia(self) -> float:
        """Motor inertia on the joint side, kg m^2."""
        return self.train.motor_inertia * self.gear_ratio**2


def moving_axis(scenario: Scenario, body: RigidBody, joint: str, pose: Sequence[float]) -> MovingAxis:
    """A joint with the robot in `pose` (n,) rad. Raises ScenarioError if it is locked or the pose does not fit."""
    if len(pose) != len(scenario.joints):
        raise ScenarioError(f"{joint}: pose has {len(pose)} positions, the robot {len(scenario.joints)} joints")
    driven, number = scenario.driven(joint), scenario.joints.index(joint)
    return MovingAxis(
        train=driven.train,
        gear_ratio=scenario.nominal(joint).gear_ratio,
        load_inertia=float(body.inertia(pose)[number]),
        gravity=body.gravity(number, pose),
    )


def true_inertia(scenario: Scenario, joint: str, poses: ArrayLike) -> Array:
    """Total inertia about a joint, including the motor inertia on the joint side, in poses (m, n): (m,) kg m^2."""
    poses = np.asarray(poses, dtype=float)
    if poses.ndim != 2 or poses.shape[1] != len(scenario.joints):
        raise ScenarioError(f"poses of shape {poses.shape} do not fit (m, {len(scenario.joints)})")
    if not np.isfinite(poses).all():
        raise ScenarioError("poses hold a number that is not finite")
    body, number = RigidBody(scenario), scenario.joints.index(joint)
    motor = scenario.driven(joint).train.motor_inertia * scenario.nominal(joint).gear_ratio ** 2
    return np.array([body.inertia(pose)[number] for pose in poses]) + motor


def truth(scenario_path: Path, poses: Sequence[Sequence[float]]) -> dict[str, list[float]]:
    """Total inertia of every joint with a drive, in every pose: {joint: [kg m^2, ...]}."""
    scenario = load_scenario(scenario_path)
    return {joint: true_inertia(scenario, joint, poses).tolist() for joint in scenario.axes}
