"""What a check of the data says."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

Severity = Literal["wrong", "warning"]

Code = Literal[
    "clipped",  # a channel ends at a limit
    "clock",  # time, sample rate and window do not fit together
    "coarse_steps",  # steps of a channel too large
    "channel_delay",  # between position and velocity, or between motion and effort
    "effort_scale",  # effort is off by a factor that no unit explains
    "effort_sign",  # effort brakes where it should accelerate
    "effort_unit",  # N mm, percent of rated effort, motor side
    "frozen",  # a channel stands still while the axis moves
    "gear_ratio",  # motor and load encoder disagree
    "gravity",  # of the robot file
    "lost_counts",  # position jumps while the motion goes on
    "missing_nominal",  # null in the robot file where it is needed
    "motion_scale",  # motion is not what was commanded
    "motion_sign",  # encoder against set-point
    "motor_inertia",  # of the robot file, against what is measured
    "not_repeatable",  # repeats differ beyond noise
    "outside_limits",  # poses or positions against the URDF
    "position_sign",
    "position_unit",
    "prior",  # of the robot file
    "rated_effort",  # of the robot file, against what is measured
    "ripple_order",  # a ripple that the robot file does not know
    "spikes",  # single samples far off
    "time_jump",  # samples are missing: all channels go on as if later
    "velocity_scale",  # velocity is not the slope of position
    "velocity_sign",
    "velocity_unit",
    "wrong_axis",  # the recording is of another axis
    "wrong_pose",  # the recording does not start where bundle.json says
]


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing found. `value` and `limit` are of one unit, which the sentence names; None where there is no number.

    `axis`: joint, None for the whole robot. `sweeps`: ids, empty for findings about the robot file. "wrong" forbids
    naming physics of the axis; "warning" does not.
    """

    code: Code
    severity: Severity
    axis: str | None
    sweeps: tuple[str, ...]
    value: float | None
    limit: float | None
    sentence: str
    action: str


def untrustworthy(findings: Iterable[Finding], joint: str) -> tuple[Finding, ...]:
    """Those that forbid naming physics for an axis."""
    return tuple(one for one in findings if one.severity == "wrong" and one.axis in (None, joint))


def named(sweeps: Sequence[str]) -> str:
    """Sweeps in a sentence: the first three and how many more."""
    more = f" and {len(sweeps) - 3} more" if len(sweeps) > 3 else ""
    return f"{'sweep' if len(sweeps) == 1 else 'sweeps'} {', '.join(sweeps[:3])}{more}"
