"""Whether a robot still agrees with a sheet: `sweepid check sheet --json`."""

from typing import Literal

from service.model.results.part import Document, Part

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
