"""The values to enter into a control: `sweepid export sheet --json`."""

from typing import Literal

from pydantic import ConfigDict, Field

from service.model.results.estimate import Base
from service.model.results.part import Document, Part


class _Finite(Part):
    model_config = ConfigDict(allow_inf_nan=False)


class AxisSheet(_Finite):
    """One axis; kg m^2, of a prismatic one kg; `motor` always kg m^2.

    `cad` and `identified`: medians over the measured poses; `lowest` and `highest` of the identified. `std`: total.
    `left_out`: reason why no value may be used, or "".
    """

    joint: str
    kind: Literal["revolute", "prismatic"]
    gear_ratio: float
    cad: float
    identified: float
    std: float
    lowest: float
    highest: float
    motor: float
    motor_std: float
    motor_lowest: float
    motor_highest: float
    differs_in_std: float
    left_out: str


class SheetParameter(_Finite):
    """A base parameter; std null: not identified."""

    name: str
    value: float
    std: float | None


class SupplementaryLoad(_Finite):
    """A body on `link`, as KUKA's LOAD: kg, m, kg m^2 about its principal axes; `orientation`: their A, B, C, deg."""

    axis: Literal["A1", "A2", "A3"]
    link: str
    frame: str
    mass: float
    centre: tuple[float, float, float]
    orientation: tuple[float, float, float]
    moments: tuple[float, float, float]


class Supplementary(_Finite):
    """The difference between estimate and CAD as bodies on the first three links; `left_out`: reason if there is none.

    `before`, `after`: difference of the base parameters from the estimate without and with them, root mean square in
    standard deviations, including that of the torque constants.
    """

    loads: tuple[SupplementaryLoad, ...]
    left_out: str
    before: float
    after: float


class SheetBody(_Finite):
    """A link with its joint in MuJoCo's form; SI. Inertia about the centre: xx, yy, zz, xy, xz, yz."""

    link: str
    joint: str
    mass: float
    centre: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]
    armature: float
    damping: float | None


Ranges = dict[str, dict[str, tuple[float, float]]]


class Sheet(Document):
    """`poses`: by axis and joint, lowest and highest measured position, rad (m); null: unknown.

    `fingerprint`: of robot, axes and base parameters, equal for the same result. `base`: covariance of the base
    parameters, for a later check. `bodies`: one physical robot with these base parameters. `kinds`: of all joints.
    """

    format: Literal["sweepid-sheet"] = "sweepid-sheet"
    robot: str
    source: str
    axes: tuple[AxisSheet, ...]
    poses: Ranges | None
    base_parameters: tuple[SheetParameter, ...]
    fingerprint: str
    serial: str = ""
    base: Base | None = None
    supplementary: Supplementary | None = None
    bodies: tuple[SheetBody, ...] = ()
    kinds: dict[str, Literal["revolute", "prismatic"]] = Field(default_factory=dict)


SheetVerdict = Literal["the same", "perhaps changed", "changed"]


class AxisCheck(Part):
    """Mean inertia over the poses of the later measurement, kg m^2 (kg), from the sheet and from the later measurement.

    `std`: of the difference.
    """

    joint: str
    sheet: float
    now: float
    std: float
    differs_percent: float
    differs_in_std: float
    poses: int


class SheetCheck(Document):
    """`probability`: of at least this difference by chance, for all axes together.

    `not_compared`: axes of the sheet that were not measured later.
    """

    robot: str
    fingerprint: str
    source: str
    verdict: SheetVerdict
    probability: float
    axes: tuple[AxisCheck, ...]
    not_compared: tuple[str, ...]
