"""The robots of a plant: the answer of `GET /fleet`. Changes and differences in percent of J."""

from datetime import datetime

from service.model.results.part import Part


class FleetPoint(Part):
    """J of an axis from one campaign: difference from the mean of the series, and its standard deviation.

    `std_percent` includes the variance between campaigns.
    """

    campaign: int
    at: datetime
    difference_percent: float
    std_percent: float


class FleetChange(Part):
    """The most significant change up to the newest campaign. `since`: the first one after a step; null: a slow drift.

    `statistic` is the change divided by its standard deviation; above `limit` it is an alarm.
    """

    since: int | None
    change_percent: float
    std_percent: float
    statistic: float
    limit: float
    alarm: bool


class FleetDifference(Part):
    """J over that of the robot file, compared with the mean of the other robots of the type.

    `probability`: by chance. `by_gain`: the uncertainty of the torque constant can explain it.
    """

    difference_percent: float
    probability: float
    outlier: bool
    by_gain: bool


class FleetAxis(Part):
    """An axis of a robot. `points`: the compared series, the oldest first.

    `left_out`: earlier campaigns, with another torque gain or other poses. `change`: null for fewer than three
    campaigns. `difference`: null for fewer than four robots.
    """

    points: tuple[FleetPoint, ...]
    left_out: int
    change: FleetChange | None
    difference: FleetDifference | None


class FleetRobot(Part):
    """A robot, identified by its serial number, or without one by the machine.

    `due_at`: when the next measurement is due; null: it was never measured, and `due` is true.
    """

    serial: str | None
    machine: str | None
    campaigns: int
    measured_at: datetime | None
    due_at: datetime | None
    due: bool
    changed: tuple[str, ...]
    outlier: tuple[str, ...]
    axes: dict[str, FleetAxis]

    @property
    def label(self) -> str:
        return self.serial if self.serial is not None else f"machine {self.machine}"


class FleetType(Part):
    """Robots of one type, that is with one name. `between_percent`: standard deviation between campaigns by axis.

    `probability`: of any false alarm among all robots and axes in a time of `campaigns` of each, as configured.
    """

    name: str
    probability: float
    campaigns: int
    remeasure_days: float
    axes: tuple[str, ...]
    between_percent: dict[str, float]
    robots: tuple[FleetRobot, ...]


class Fleet(Part):
    """The robots of a plant by type, at the time `made_at`."""

    made_at: datetime
    types: tuple[FleetType, ...]
