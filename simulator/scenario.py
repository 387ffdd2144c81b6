"""A scenario: what a virtual machine really is, as data (`config/scenarios/*.yaml`).

It names a robot (the CAD model, `config/robots/*.yaml`) and says how the real one differs: other link inertials, drive
trains with springs and friction, ripple, and what the measurement adds. SI on the joint side; `motor_inertia` and
`gear_ratio` are those of the robot file (motor side, motor revolutions per joint revolution).
"""

from pathlib import Path
from typing import Annotated, cast

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

CYCLE = 0.001
"""Cycle of the drive's set-points and samples, s."""

STEP = CYCLE / 4
"""Step of the plant, s."""


def _whole_steps(delay: float) -> float:
    if abs(round(delay / STEP) * STEP - delay) > 1e-9:
        raise ValueError(f"{delay} s is not a multiple of the plant step {STEP} s")
    return delay


Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Delay = Annotated[float, Field(ge=0, le=1), AfterValidator(_whole_steps)]
Smoothing = Annotated[float, Field(ge=0, le=1)]
Vector = tuple[float, float, float]


class ScenarioError(ValueError):
    """A scenario or robot file cannot be used; the text names file, field and reason."""


class _Data(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Friction(_Data):
    """``viscous * v + coulomb * sign(v)``; N m s/rad, N m. The Coulomb part sticks at v = 0."""

    viscous: NotNegative = 0.0
    coulomb: NotNegative = 0.0


class LuGre(_Data):
    """Bristle friction (Canudas de Wit et al. 1995) with g(v) = coulomb + (breakaway - coulomb) exp(-(v/vs)^2)."""

    stiffness: Positive  # sigma0, N m/rad
    damping: NotNegative  # sigma1, N m s/rad
    coulomb: Positive  # N m
    breakaway: Positive  # N m
    stribeck_velocity: Positive  # rad/s


class Spring(_Data):
    """Between motor and load: ``stiffness e + hardening e^3 + damping e'``; N m/rad, N m/rad^3, N m s/rad."""

    stiffness: Positive
    hardening: NotNegative = 0.0
    damping: NotNegative = 0.0


class Ripple(_Data):
    """Cogging: ``amplitude sin(order * motor angle + phase)`` N m against the motor; periods per motor revolution."""

    order: Positive
    amplitude: NotNegative
    phase: float = 0.0


class DriveTrain(_Data):
    """What stands between the torque-forming current and the load of one joint. No spring = one rigid mass."""

    motor_inertia: Positive  # kg m^2 on the motor side
    motor_friction: Friction = Friction()
    load_friction: Friction = Friction()
    spring: Spring | None = None
    cogging: tuple[Ripple, ...] = ()
    lugre: LuGre | None = None  # on the motor side, instead of motor_friction.coulomb

    @model_validator(mode="after")
    def _one_dry_friction(self) -> "DriveTrain":
        if self.lugre and self.motor_friction.coulomb:
            raise ValueError("motor_friction.coulomb must be 0 where lugre is given")
        return self


class SpeedControl(_Data):
    """PI speed controller as commissioned in the drive: N m s/rad, s; `effort_limit` in N m."""

    gain: Positive
    reset_time: Positive
    effort_limit: Positive

    def softened(self, softening: float) -> "SpeedControl":
        """Gain times `softening`, reset time divided by it; 0 < softening <= 1."""
        return self.model_copy(update={"gain": self.gain * softening, "reset_time": self.reset_time / softening})


class DrivenAxis(_Data):
    """A joint that can move."""

    train: DriveTrain
    control: SpeedControl
    load_encoder: bool = True


class AddedBody(_Data):
    """A solid round bar that CAD lacks (hose, duct, payload), from `start` to `end` in the link's frame; m, kg."""

    name: str
    mass: Positive
    start: Vector
    end: Vector
    radius: Positive


class LinkDeviation(_Data):
    """A real link against CAD: factors on mass and on inertia about the centre of mass, shift of that centre (m)."""

    mass: Positive = 1.0
    inertia: Positive = 1.0
    shift: Vector = (0.0, 0.0, 0.0)
    added: tuple[AddedBody, ...] = ()


class Measurement(_Data):
    """What the drive adds to the truth, as RMS of each 1 ms sample; effort relative to the rated effort."""

    effort_noise: NotNegative = 0.0
    effort_resolution: NotNegative = 0.0  # quantisation step, relative
    effort_delay: Delay = 0.0  # s, of effort against position
    effort_smoothing: Smoothing = 0.0  # s, time constant of the first-order low-pass of the torque-forming current
    velocity_delay: Delay = 0.0  # s, of motor speed against position
    velocity_smoothing: Smoothing = 0.0  # s, of motor speed
    velocity_noise: NotNegative = 0.0  # rad/s
    position_noise: NotNegative = 0.0  # rad, motor encoder
    load_position_noise: NotNegative = 0.0  # rad, direct encoder
    load_velocity_noise: NotNegative = 0.0  # rad/s


class NominalAxis(BaseModel):
    """What the robot file says of an axis, as far as the plant and its drive need it."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)
    joint: str
    gear_ratio: float
    motor_inertia: Positive
    rated_effort: Positive


class NominalRobot(BaseModel):
    """The robot file with its URDF read in."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)
    name: str
    urdf: str  # the XML text
    gravity: Vector
    axes: tuple[NominalAxis, ...] = Field(min_length=1)


class Scenario(_Data):
    """A virtual machine. Joints that are not in `axes` are locked by their brakes."""

    name: str
    robot: NominalRobot
    links: dict[str, LinkDeviation] = {}
    axes: dict[str, DrivenAxis] = Field(min_length=1)
    measurement: Measurement = Measurement()

    @model_validator(mode="after")
    def _known_and_alike(self) -> "Scenario":
        unknown = sorted(set(self.axes) - set(self.joints))
        if unknown:
            raise ValueError(f"axes {unknown} are not joints of {self.robot.name}: {list(self.joints)}")
        if len({axis.train.spring is None for axis in self.axes.values()}) > 1:
            raise ValueError("either every axis has a spring or none has")
        return self

    @property
    def joints(self) -> tuple[str, ...]:
        """All joints of the robot, base to tip, locked ones included."""
        return tuple(axis.joint for axis in self.robot.axes)

    def nominal(self, joint: str) -> NominalAxis:
        """The robot file's entry of a joint; ScenarioError where there is none."""
        for axis in self.robot.axes:
            if axis.joint == joint:
                return axis
        raise ScenarioError(f"scenario {self.name}: no joint {joint!r}; there are {', '.join(self.joints)}")

    def driven(self, joint: str) -> DrivenAxis:
        """The drive of a joint; ScenarioError where the joint is unknown or locked."""
        if joint not in self.axes:
            raise ScenarioError(f"scenario {self.name}: joint {joint!r} cannot move; {', '.join(self.axes)} can")
        return self.axes[joint]


def load_scenario(path: Path) -> Scenario:
    """Read a scenario with the robot file and URDF it names (paths relative to the naming file)."""
    data = _mapping(path)
    robot_path = path.parent / str(data.get("robot", ""))
    robot = _mapping(robot_path)
    robot["urdf"] = _text(robot_path.parent / str(robot.get("urdf", "")))
    data["robot"] = robot
    try:
        return Scenario.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ScenarioError(f"{path}: {place}: {first['msg']}") from None


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: cannot be read: {error}") from None


def _mapping(path: Path) -> dict[str, object]:
    try:
        data = yaml.safe_load(_text(path))
    except yaml.YAMLError as error:
        raise ScenarioError(f"{path}: not YAML: {error}") from None
    if not isinstance(data, dict):
        raise ScenarioError(f"{path}: not a mapping")
    return cast(dict[str, object], data)
