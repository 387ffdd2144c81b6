"""A scenario: the true parameters of a virtual machine, as data (`config/scenarios/*.yaml`).

It names a robot (the CAD model, `config/robots/*.yaml`) and states how the real one differs: other link inertials,
drive trains with springs and friction, ripple, and measurement errors. SI on the joint side; `motor_inertia` and
`gear_ratio` are those of the robot file (motor side, motor revolutions per joint revolution).
"""

from pathlib import Path
from typing import Annotated, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from drivers.bounded_yaml import parse_yaml, read_bounded


def read_text(path: Path) -> str:
    """The UTF-8 text of a file. Raises OSError, and ValueError if it is not UTF-8 or too large."""
    return read_bounded(path, 2**26).decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")


CYCLE = 0.001
"""Cycle of the drive's set-points and samples, s."""

STEP = CYCLE / 4
"""Step of the plant, s."""

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Delay = Annotated[float, Field(ge=0, le=1)]
Smoothing = Annotated[float, Field(ge=0, le=1)]
Vector = tuple[float, float, float]


class ScenarioError(ValueError):
    """A scenario or robot file cannot be used; the text names file, field and reason."""


class FileModel(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Stribeck(FileModel):
    """Additional dry friction at low speed: ``extra exp(-|v / velocity|^exponent)``; N m, rad/s."""

    extra: Positive
    velocity: Positive
    exponent: Positive = 2.0


class PowerLaw(FileModel):
    """``coefficient |v|^exponent`` against the motion; N m (s/rad)^exponent."""

    coefficient: Positive
    exponent: Positive


class RoughSpot(FileModel):
    """Additional dry friction about one load position: ``coulomb`` N m at the centre, a raised cosine of `width` on
    each side.
    """

    centre: float  # rad
    width: Positive  # rad
    coulomb: Positive


class Friction(FileModel):
    """``viscous v + (coulomb + further dry friction) sign(v)``; N m s/rad, N m. Dry friction sticks at v = 0."""

    viscous: NotNegative = 0.0
    coulomb: NotNegative = 0.0
    backward_viscous: NotNegative | None = None  # at v < 0, if it differs
    backward_coulomb: NotNegative | None = None
    stribeck: Stribeck | None = None
    power: PowerLaw | None = None
    load_dependence: NotNegative = 0.0  # N m per N m transmitted by the gear
    patch: RoughSpot | None = None

    @property
    def plain(self) -> bool:
        """Whether viscous and Coulomb friction are constant."""
        return self == Friction(viscous=self.viscous, coulomb=self.coulomb)


class Warming(FileModel):
    """The gear is heated by its friction, ``C T' = P - C T / time_constant``; friction is exp(-loss T) of the cold
    value.
    """

    heat_capacity: Positive  # C, J/K
    time_constant: Positive  # s
    coulomb_loss: NotNegative = 0.0  # 1/K, of all dry friction
    viscous_loss: NotNegative = 0.0  # 1/K


class LuGre(FileModel):
    """Bristle friction (Canudas de Wit et al. 1995) with g(v) = coulomb + (breakaway - coulomb) exp(-(v/vs)^2)."""

    stiffness: Positive  # sigma0, N m/rad
    damping: NotNegative  # sigma1, N m s/rad
    coulomb: Positive  # N m
    breakaway: Positive  # N m
    stribeck_velocity: Positive  # rad/s


class Spring(FileModel):
    """Between motor and load: ``stiffness e + hardening e^3 + damping e'``; N m/rad, N m/rad^3, N m s/rad.

    With `backlash`, rad from flank to flank, e is what is left beyond half of it, and the damping acts only there.
    """

    stiffness: Positive
    hardening: NotNegative = 0.0
    damping: NotNegative = 0.0
    backlash: NotNegative = 0.0


class Cogging(FileModel):
    """Cogging: ``amplitude sin(order * motor angle + phase)`` N m against the motor; periods per motor revolution."""

    order: Positive
    amplitude: NotNegative
    phase: float = 0.0


class GearError(Cogging):
    """The gear turns ahead by ``amplitude sin(order * motor angle + phase)``, rad; periods per motor turn."""


class Hose(FileModel):
    """From the base to the load: ``stiffness (q - rest) + damping v``; N m/rad, rad, N m s/rad."""

    stiffness: Positive
    rest: float
    damping: NotNegative = 0.0


class Strut(FileModel):
    """A spring or gas cylinder between two points, `crank` and `arm` m from the axis, `apart` m along it, and nearest
    to each other at `zero` rad. It pulls with ``force (1 - x / column)^-exponent + rate x`` N, x its length past
    `length`.
    """

    crank: Positive
    arm: Positive
    apart: float = 0.0
    zero: float
    force: float
    length: Positive
    rate: float = 0.0
    column: float | None = None  # of gas; negative: compressed as it shortens
    exponent: Positive = 1.0


class Appendage(FileModel):
    """A second body on the load, behind a spring of its own; kg m^2, N m/rad, N m s/rad. Gravity does not see it."""

    inertia: Positive
    stiffness: Positive
    damping: NotNegative = 0.0


class DriveTrain(FileModel):
    """The components between torque-forming current and load of one joint. Without a spring: one rigid mass."""

    motor_inertia: Positive  # kg m^2 on the motor side
    motor_friction: Friction = Friction()
    load_friction: Friction = Friction()
    warming: Warming | None = None  # of motor and load friction, but not of lugre
    spring: Spring | None = None
    gear_error: tuple[GearError, ...] = ()
    cogging: tuple[Cogging, ...] = ()
    lugre: LuGre | None = None  # on the motor side, instead of motor_friction.coulomb
    hose: Hose | None = None
    counterbalance: tuple[Strut, ...] = ()
    appendage: Appendage | None = None
    effort_gain: Positive = 1.0  # recorded effort = gain * true + offset: error of the torque constant,
    effort_offset: float = 0.0  # N m, and of the current's zero

    @model_validator(mode="after")
    def _fits_together(self) -> "DriveTrain":
        if self.lugre and (self.motor_friction.coulomb or self.motor_friction.backward_coulomb):
            raise ValueError("motor_friction.coulomb must be 0 where lugre is given")
        if self.gear_error and self.spring is None:
            raise ValueError("gear_error needs a spring, if a stiff one")
        return self


class SpeedControl(FileModel):
    """PI speed controller as commissioned in the drive: N m s/rad, s; `effort_limit` in N m."""

    gain: Positive
    reset_time: Positive
    effort_limit: Positive

    def softened(self, softening: float) -> "SpeedControl":
        """Gain times `softening`, reset time divided by it; 0 < softening <= 1."""
        return self.model_copy(update={"gain": self.gain * softening, "reset_time": self.reset_time / softening})


class DrivenAxis(FileModel):
    """A joint with a drive."""

    train: DriveTrain
    control: SpeedControl
    load_encoder: bool = True


class AddedBody(FileModel):
    """A solid round bar that CAD lacks (hose, duct, payload), from `start` to `end` in the link's frame; m, kg."""

    name: str
    mass: Positive
    start: Vector
    end: Vector
    radius: Positive


class LinkDeviation(FileModel):
    """A real link relative to CAD: factors on mass and on inertia about the centre of mass, shift of that centre
    (m).
    """

    mass: Positive = 1.0
    inertia: Positive = 1.0
    shift: Vector = (0.0, 0.0, 0.0)
    added: tuple[AddedBody, ...] = ()


class Measurement(FileModel):
    """Measurement errors, as RMS of each 1 ms sample; effort relative to the rated effort."""

    effort_noise: NotNegative = 0.0
    effort_resolution: NotNegative = 0.0  # quantisation step, relative
    effort_delay: Delay = 0.0  # s, of effort relative to position
    effort_smoothing: Smoothing = 0.0  # s, time constant of the first-order low-pass of the torque-forming current
    velocity_delay: Delay = 0.0  # s, of motor speed relative to position
    velocity_smoothing: Smoothing = 0.0  # s, of motor speed
    velocity_noise: NotNegative = 0.0  # rad/s
    position_noise: NotNegative = 0.0  # rad, motor encoder
    load_position_noise: NotNegative = 0.0  # rad, direct encoder
    load_velocity_noise: NotNegative = 0.0  # rad/s


class NominalAxis(FileModel, extra="ignore"):
    """Data of an axis in the robot file, as needed by the plant and its drive."""

    joint: str
    gear_ratio: float
    motor_inertia: Positive
    rated_effort: Positive
    cogging_orders: tuple[Positive, ...] = ()  # periods per motor revolution


class NominalRobot(FileModel, extra="ignore"):
    """The robot file including its URDF."""

    name: str
    urdf: str  # the XML text
    gravity: Vector
    axes: tuple[NominalAxis, ...] = Field(min_length=1)


class Scenario(FileModel):
    """A virtual machine. Joints that are not in `axes` are locked by their brakes."""

    name: str
    robot: NominalRobot
    links: dict[str, LinkDeviation] = {}
    axes: dict[str, DrivenAxis] = Field(min_length=1)
    coupled: bool = True  # axes that move together are coupled; False: each as if the others stood
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
        """Entry of a joint in the robot file. Raises ScenarioError if there is none."""
        for axis in self.robot.axes:
            if axis.joint == joint:
                return axis
        raise ScenarioError(f"scenario {self.name}: no joint {joint!r}; there are {', '.join(self.joints)}")

    def driven(self, joint: str) -> DrivenAxis:
        """The drive of a joint. Raises ScenarioError if the joint is unknown or locked."""
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
        if first["loc"][:1] == ("robot",):  # the error is in the robot file
            name = place.removeprefix("robot.")
            problem = f"{first['msg']}; a virtual machine needs every value of its robot file"
            raise ScenarioError(f"{robot_path}: {name}: {problem}") from None
        raise ScenarioError(f"{path}: {place}: {first['msg']}") from None


def _text(path: Path) -> str:
    try:
        return read_text(path)
    except FileNotFoundError as error:
        there = ", ".join(sorted(one.name for one in path.parent.glob(f"*{path.suffix}"))) or "nothing"
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}; {path.parent} has {there}") from None
    except (OSError, ValueError) as error:
        raise ScenarioError(f"{path}: cannot be read: {error}") from None


def _mapping(path: Path) -> dict[str, object]:
    text = _text(path)
    try:
        data = parse_yaml(text)
    except ValueError as error:
        raise ScenarioError(f"{path}: {error}") from None
    if not isinstance(data, dict):
        raise ScenarioError(f"{path}: not a mapping")
    return cast(dict[str, object], data)
