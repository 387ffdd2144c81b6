"""A finding of the data check."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from service.model import Robot, Sweep
from service.model.results.diagnosis import CheckedAxis, DataCheck, Finding

Severity = Literal["wrong", "warning"]

Code = Literal[
    "clipped",  # the values of a channel are limited
    "clock",  # time, sample rate and window do not fit together
    "coarse_steps",  # steps of a channel too large
    "channel_delay",  # between position and velocity, or between motion and effort
    "effort_scale",  # effort is off by a factor that no unit explains
    "effort_sign",  # effort has the sign of braking during acceleration
    "effort_unit",  # N mm, percent of rated effort, motor side
    "frozen",  # a channel is constant while the axis moves
    "gear_ratio",  # motor encoder and load encoder differ
    "gravity",  # of the robot file
    "lost_counts",  # in the robot file
    "missing_nominal",  # null in the robot file where it is needed
    "motion_scale",  # the motion is not the commanded one
    "motion_sign",  # sign of encoder and set-point differ
    "motor_inertia",  # in the robot file, compared with the measurement
    "not_repeatable",  # repeats differ by more than the noise
    "outside_limits",  # poses or positions outside the limits of the URDF
    "position_sign",
    "position_unit",
    "prior",  # in the robot file
    "rated_effort",  # in the robot file, compared with the measurement
    "ripple_order",  # a ripple that is not in the robot file
    "spikes",  # single outlier samples
    "time_jump",  # missing samples: all channels jump to a later time
    "velocity_scale",  # velocity is not the derivative of position
    "velocity_sign",
    "velocity_unit",
    "wrong_axis",  # the recording is of another axis
    "wrong_pose",  # the recording does not start where bundle.json says
]


@dataclass(frozen=True, slots=True)
class DataFinding:
    """One finding. `value` and `limit` have the unit given in the sentence; None if there is no number.

    `axis`: joint, None for the whole robot. `sweeps`: ids, empty for findings about the robot file. With "wrong",
    the diagnosis names no physics of the axis; with "warning" it does.
    """

    code: Code
    severity: Severity
    axis: str | None
    sweeps: tuple[str, ...]
    value: float | None
    limit: float | None
    sentence: str
    action: str


def untrustworthy(findings: Iterable[DataFinding], joint: str) -> tuple[DataFinding, ...]:
    """The findings for which no physics of an axis may be named."""
    return tuple(one for one in findings if one.severity == "wrong" and one.axis in (None, joint))


def named(sweeps: Sequence[str]) -> str:
    """Sweep names for a sentence: the first three and the number of the others."""
    more = f" and {len(sweeps) - 3} more" if len(sweeps) > 3 else ""
    return f"{'sweep' if len(sweeps) == 1 else 'sweeps'} {', '.join(sweeps[:3])}{more}"


def findings_document(robot: Robot, sweeps: Sequence[Sweep], findings: Sequence[DataFinding]) -> DataCheck:
    """`findings`, and for each axis that was swept whether its data can be trusted."""
    joints = {sweep.spec.axis for sweep in sweeps}
    return DataCheck(
        findings=tuple(Finding.model_validate(one, from_attributes=True) for one in findings),
        axes={
            joint: CheckedAxis(
                sweeps=sum(sweep.spec.axis == joint for sweep in sweeps),
                trustworthy=not untrustworthy(findings, joint),
                codes=tuple(sorted({one.code for one in findings if one.axis in (None, joint)})),
            )
            for joint in robot.joints
            if joint in joints
        },
    )
