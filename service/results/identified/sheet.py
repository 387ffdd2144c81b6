"""What to type into a control: `sweepid export-sheet --json`."""

from typing import Literal

from pydantic import ConfigDict

from service.results.part import Document, Part


class _Finite(Part):
    model_config = ConfigDict(allow_inf_nan=False)


class AxisSheet(_Finite):
    """One axis; kg m^2, of a prismatic one kg; `motor` always kg m^2.

    `cad` and `identified`: medians over the measured poses, `lowest` and `highest` of the identified. `std` total.
    `left_out`: why no value may be used, or "".
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


Ranges = dict[str, dict[str, tuple[float, float]]]


class Sheet(Document):
    """`poses`: by axis and joint, lowest and highest position, rad (m), that the value was measured in; null: unknown.

    `fingerprint`: of robot, axes and base parameters, equal for the same result.
    """

    format: Literal["sweepid-sheet"] = "sweepid-sheet"
    robot: str
    source: str
    axes: tuple[AxisSheet, ...]
    poses: Ranges | None
    base_parameters: tuple[SheetParameter, ...]
    fingerprint: str
