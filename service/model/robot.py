"""The robot: a serial chain read from URDF, with the data that URDF lacks (BUNDLE format, "robot").

Frames. Moving joint k (0-based, URDF order) carries link k, whose frame is the joint's frame; fixed joints are merged
into it. With R_k, p_k the pose of frame k in the base and z_k its axis in base coordinates,

    R_k = R_{k-1} Rt_k rot(axis_k, q_k),   p_k = p_{k-1} + R_{k-1} pt_k            (revolute)

The ten inertial parameters of a link are taken at its frame's origin, in the order of Pinocchio and of
Atkeson, An and Hollerbach (1986): [m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz].
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, StringConstraints, field_validator

from service import BadInput
from service.model.arrays import Array
from service.model.counterbalance import Counterbalance
from service.model.physical_bounds import Most, check_urdf
from service.model.recording import Name, Sweep
from service.model.urdf import Chain, read_chain

INERTIAL_NAMES = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
_LEAST_RATIO, _LARGEST_RATIO = 1e-6, Most.ratio
Gravity = Annotated[float, Field(ge=-Most.gravity, le=Most.gravity)]
Marking = Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=100)]


def _unsaid(value: object) -> bool:
    return value is None


class Axis(BaseModel):
    """The drive train of one joint; SI on the joint side unless stated otherwise."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    joint: Name
    gear_ratio: float  # motor revolutions per joint revolution; prismatic: rad per m; signed
    motor_inertia: float | None = Field(default=None, ge=0, le=Most.inertia)  # kg m^2 on the motor side
    rated_effort: float = Field(ge=1e-9, le=Most.effort)  # N m (N)
    viscous_friction: float | None = Field(default=None, ge=0, le=Most.viscous)  # N m s/rad (N s/m)
    # of the drive's speed control, N m s/rad (N s/m); omitted if it is not known, as older versions do
    speed_gain: float | None = Field(default=None, ge=0, le=Most.viscous, exclude_if=_unsaid)
    cogging_orders: tuple[float, ...] = ()  # periods per motor revolution
    transmission_orders: tuple[float, ...] = ()
    counterbalance: Counterbalance | None = Field(default=None, exclude_if=_unsaid)

    @field_validator("gear_ratio")
    @classmethod
    def _turns_the_motor(cls, ratio: float) -> float:
        if ratio == 0:
            raise ValueError("must not be 0: the motor would stand still")
        if not _LEAST_RATIO <= abs(ratio) <= _LARGEST_RATIO:
            raise ValueError(f"must be between {_LEAST_RATIO:g} and {_LARGEST_RATIO:g}, either sign")
        return ratio

    @field_validator("cogging_orders", "transmission_orders")
    @classmethod
    def _positive(cls, orders: tuple[float, ...]) -> tuple[float, ...]:
        if any(not 0 < order <= _LARGEST_RATIO for order in orders):
            raise ValueError(f"orders must be greater than 0 and at most {_LARGEST_RATIO:g}")
        return orders

    @property
    def reflected_motor_inertia(self) -> float | None:
        """u^2 Jm of the paper's equation (4): kg m^2 (kg) on the joint side, None if unknown."""
        return None if self.motor_inertia is None else self.gear_ratio**2 * self.motor_inertia


class Prior(BaseModel):
    """Uncertainty of the nominal model: one sigma, relative."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    inertia: float = Field(default=0.3, ge=1e-6, le=1e6)
    gravity: float = Field(default=0.3, ge=1e-6, le=1e6)
    viscous_friction: float = Field(default=0.5, ge=1e-6, le=1e6)
    motor_inertia: float = Field(default=0.1, ge=1e-6, le=1e6)
    effort_gain: float = Field(default=0.05, ge=0, le=1e6)


class RobotDescription(BaseModel):
    """The "robot" object of a bundle: names, gravity in the base frame (m/s^2), axes in URDF order, prior.

    `serial` and `revision`: identification of one of several robots with that name, from the manufacturer.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    name: Name
    urdf: Annotated[str, Field(max_length=1000)]
    gravity: tuple[Gravity, Gravity, Gravity] = (0.0, 0.0, -9.81)
    axes: tuple[Axis, ...] = Field(min_length=1)
    prior: Prior = Prior()
    # omitted if empty: so the hashes of robots from older versions do not change
    serial: Marking | None = Field(default=None, exclude_if=_unsaid)
    revision: Marking | None = Field(default=None, exclude_if=_unsaid)


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Knowledge of a robot from an estimate, besides the prior: combinations (r, 11 n) of inertial parameters, links
    first, then reflected motor inertias, with their covariance (r, r). `source`: which estimate.
    """

    combination: Array
    covariance: Array
    source: str


@dataclass(frozen=True)
class Robot:
    """A described robot with its chain. Immutable; `urdf_text` is kept unchanged for the export to a bundle.

    `knowledge`: from an estimate, whose values the URDF then contains; None: the URDF is CAD's.
    """

    description: RobotDescription
    urdf_text: str
    knowledge: Knowledge | None = field(default=None, compare=False, repr=False)

    @cached_property
    def chain(self) -> Chain:
        """The kinematic chain and the nominal inertial parameters."""
        return read_chain(self.urdf_text)

    @property
    def name(self) -> str:
        return self.description.name

    @property
    def axes(self) -> tuple[Axis, ...]:
        return self.description.axes

    @property
    def prior(self) -> Prior:
        return self.description.prior

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the moving joints, base to tip."""
        return tuple(axis.joint for axis in self.axes)

    @property
    def gravity(self) -> Array:
        """Gravity in the base frame, (3,), m/s^2."""
        return np.array(self.description.gravity)

    def index(self, joint: str) -> int:
        """Number of a joint in the pose; BadInput lists the existing joints."""
        try:
            return self.joints.index(joint)
        except ValueError:
            raise BadInput(joint, f"unknown joint; robot {self.name} has {', '.join(self.joints)}") from None

    def axis(self, joint: str) -> Axis:
        return self.axes[self.index(joint)]

    def counterbalance_effort(self, index: int, position: Array) -> Array:
        """What the drive of a joint provides against its counterbalance, N m, at its positions in rad; 0 without one.

        It is the known effort beside the weight of the links.
        """
        own = self.axes[index].counterbalance
        return np.zeros_like(position) if own is None else own.effort(own.lever(self.chain.joints[index]), position)

    def counterbalance_efforts(self, positions: Array) -> Array:
        """The same of all joints, (m, n), at positions (m, n)."""
        return np.stack([self.counterbalance_effort(k, at) for k, at in enumerate(positions.T)], -1)

    def without_counterbalance(self, sweep: Sweep) -> Sweep:
        """The sweep with the effort that its axis would need without counterbalance; the same object if it has none."""
        index, record = self.index(sweep.spec.axis), sweep.recording
        if self.axes[index].counterbalance is None:
            return sweep
        effort = record.effort - self.counterbalance_effort(index, record.position)
        return replace(sweep, recording=replace(record, effort=effort))


def build_robot(description: RobotDescription, urdf_text: str, place: str = "robot") -> Robot:
    """A robot whose axes are the chain's moving joints, in order; BadInput if they differ."""
    robot = Robot(description, urdf_text)
    moving = tuple(joint.name for joint in robot.chain.joints)
    if moving != robot.joints:
        raise BadInput(
            f"{place}.axes", f"joints {list(robot.joints)} differ from the URDF's moving joints {list(moving)}"
        )
    for number, (axis, joint) in enumerate(zip(robot.axes, robot.chain.joints, strict=True)):
        if axis.counterbalance is not None:
            axis.counterbalance.check(joint, f"{place}.axes.{number}.counterbalance")
    return robot


def robot_from_outside(description: RobotDescription, urdf_text: str, place: str = "robot") -> Robot:
    """As `build_robot`, for a robot that a person or a program gives: BadInput also if it is physically impossible.

    An estimate may put such values on a single link: there only the base parameters have a meaning.
    """
    robot = build_robot(description, urdf_text, place)
    check_urdf(urdf_text, robot.chain, f"{place} URDF")
    return robot


def link_frames(chain: Chain, poses: Array) -> tuple[Array, Array]:
    """Rotations (..., n, 3, 3) and origins (..., n, 3) of all link frames in the base, for poses (..., n)."""
    poses = np.asarray(poses, dtype=float)
    lead = poses.shape[:-1]
    rotations = np.empty((*lead, len(chain.joints), 3, 3))
    origins = np.empty((*lead, len(chain.joints), 3))
    rotation = np.broadcast_to(np.eye(3), (*lead, 3, 3))
    origin = np.zeros((*lead, 3))
    for k, joint in enumerate(chain.joints):
        q = poses[..., k]
        origin = origin + rotation @ joint.translation
        rotation = rotation @ joint.rotation
        if joint.kind == "prismatic":
            origin = origin + (rotation @ joint.axis) * q[..., None]
        else:
            rotation = rotation @ rotation_about(joint.axis, q)
        rotations[..., k, :, :] = rotation
        origins[..., k, :] = origin
    return rotations, origins


def rotation_about(axis: Array, angle: Array) -> Array:
    """Rodrigues: rotation matrices (..., 3, 3) about a unit `axis` (3,) by `angle` (...), rad."""
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.asarray(angle)[..., None, None]
    return np.eye(3) + np.sin(angle) * skew + (1 - np.cos(angle)) * (skew @ skew)
