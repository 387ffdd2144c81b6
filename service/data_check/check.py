"""All checks of all axes; a check runs before those that its finding would falsify."""

from collections.abc import Sequence

from service.data_check.effort import effort, effort_delay, responses, seen
from service.data_check.finding import Code, DataFinding
from service.data_check.motion import commanded, load_encoder, motion, slopes, start
from service.data_check.record import AxisRecords
from service.data_check.repeatability import repeatability
from service.data_check.ripples import ripples
from service.data_check.robot_file import description, nominals, rated_effort
from service.data_check.samples import clipping, clock, frozen, lost_samples, quantisation, spikes
from service.identification.motion.free_motion import at_once
from service.model import Robot, Sweep

DISPLACED: tuple[Code, ...] = ("position_unit", "position_sign", "motion_sign")  # then positions differ from their pose


def check(robot: Robot, sweeps: Sequence[Sweep]) -> tuple[DataFinding, ...]:
    """Errors and warnings about recordings and robot file: first those of the robot, then by axis from base to tip.

    `sweeps` as read from a bundle: known joints, poses of the robot's length, finite columns of one length.
    """
    joints = {sweep.spec.axis for sweep in sweeps}
    axes = [finding for joint in robot.joints if joint in joints for finding in _axis(robot, joint, sweeps)]
    return (*description(robot), *axes)


def _axis(robot: Robot, joint: str, sweeps: Sequence[Sweep]) -> list[DataFinding]:
    own = tuple(sweep for sweep in sweeps if sweep.spec.axis == joint)
    axis = AxisRecords.of(robot, joint, own)
    lost = lost_samples(axis)
    whole = axis.without({name for one in lost for name in one.sweeps})
    # their efforts answer to the other axes' motion too: identification compares the whole inverse dynamics
    lonely = whole.without({spec.id for group in at_once([sweep.spec for sweep in sweeps]) for spec in group})
    followed = commanded(whole)
    of_motion = motion(whole, slopes(whole), followed)
    codes = {finding.code for finding in of_motion}
    found = responses(lonely, {one.record.id: one for one in followed})
    # without a set-point, a wrong motion would look like a wrong effort
    inertia = seen(lonely, found) if followed or not codes else None
    of_effort = effort(lonely, inertia, placed=not codes)
    sound = not of_effort and not codes
    return [
        *clock(axis, own),
        *nominals(axis),
        *frozen(axis),
        *clipping(axis),
        *(quantisation(axis) if sound else []),  # the limits of steps are in SI units
        *spikes(axis),
        *lost,
        *of_motion,
        *(start(axis) if not codes & set(DISPLACED) else []),
        *of_effort,
        *(effort_delay(axis, found) if sound else []),
        *load_encoder(axis),
        *(rated_effort(axis) if sound and inertia is not None and inertia.fits else []),
        *repeatability(whole),
        *(ripples(whole) if sound else []),
    ]
