"""The result of the comparison of CAD and estimate on held-out sweeps; `sweepid estimate benefit --json` writes it."""

from collections.abc import Mapping

from service.model.results.effect import Number, Value
from service.model.results.part import Document, Part


class ModelBenefit(Part):
    """One model on the held-out sweeps of an axis; N m (N), for prismatic axes in brackets.

    `effort_rms` and `effort_peak` of measured minus predicted effort, sample by sample; `lines_rms` of its part at the
    excited lines, `left_percent` that part over the measured one. `inertia_percent`: RMS over the held-out sweeps of
    model minus measured inertia, relative. `inertia_error`: the same in kg m^2 (kg), which is N m for each rad/s^2.
    `smallest_effort`: the smallest external effort that the monitor can detect; `smallest_force` at the robot's end
    that causes it, N, null if that end is on the axis.
    """

    effort_rms: Number
    effort_peak: Number
    lines_rms: Number
    left_percent: Number
    inertia_percent: Value
    inertia_error: Number
    smallest_effort: Number
    smallest_force: Number | None


class AxisBenefit(Part):
    """Both models on one axis. `effort_rms`, `lines_rms`: of the measured effort itself, in the held-out sweeps.

    `lever_arm`: median over the held-out poses of the distance of the robot's end from the axis, m; null: prismatic.
    """

    unit: str
    training: tuple[str, ...]
    held_out: tuple[str, ...]
    poses: int
    held_out_poses: int
    effort_rms: Number
    lines_rms: Number
    lever_arm: Number | None
    cad: ModelBenefit
    identified: ModelBenefit

    @property
    def lines_ratio(self) -> float:
        """Factor by which the residual at the excited lines is smaller with the estimate."""
        return self.cad.lines_rms / self.identified.lines_rms

    @property
    def smallest_ratio(self) -> float:
        """Factor by which the smallest detectable effort is smaller with the estimate."""
        return self.cad.smallest_effort / self.identified.smallest_effort


class Followed(Part):
    """Error of an axis on a path, motor side, referred to the joint: rad (m)."""

    rms: Number
    peak: Number


class Tracking(Part):
    """The same path with torque feed-forward of each model, by joint. `top_speed`, `top_acceleration` of any joint."""

    duration: Number  # s
    top_speed: Number  # rad/s (m/s)
    top_acceleration: Number  # rad/s^2 (m/s^2)
    gain: Number  # 1/s, of the position controllers
    cad: Mapping[str, Followed]
    identified: Mapping[str, Followed]


class Benefit(Document):
    """By joint. `every`: every so-many-th pose of an axis is held out; `quiet_hours`: time per false alarm.

    `not_judged`: reasons why an axis has no result. `tracking`: result of a simulation, if there was one.
    """

    robot: str
    every: int
    quiet_hours: Number
    axes: Mapping[str, AxisBenefit]
    not_judged: Mapping[str, str]
    tracking: Tracking | None = None
