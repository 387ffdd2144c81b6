"""What a start will move: the approach from the present positions to the first pose, and the range of each axis.

Pure. Ranges are in rad (m), by joint; a person sees them before the start, and `check_seen` compares them at the start.
"""

from collections.abc import Iterable, Mapping, Sequence

from drivers.errors import CommunicationLost
from drivers.ports import AxisState, AxisStatus
from service.model.errors import Conflict
from service.planning.analysis.documents import PlannedNoise
from service.planning.compiled_plan import CompiledPlan
from service.planning.documents import PlannedSweep
from service.planning.safety.travel import Leg

Range = tuple[float, float]


def positions_of(status: Mapping[str, AxisStatus]) -> dict[str, float]:
    """Positions of the axes, rad (m). CommunicationLost if a drive does not answer: its position is not known."""
    for joint, axis in status.items():
        if axis.state is AxisState.UNKNOWN:
            raise CommunicationLost(f"{joint}: its drive does not answer")
    return {joint: axis.position for joint, axis in status.items()}


def approach(compiled: CompiledPlan, pose: Sequence[float], positions: Mapping[str, float]) -> tuple[Leg, ...]:
    """The legs to the first pose, as the start will choose them. EnvelopeViolation if there is no free path."""
    here = [positions.get(joint, planned) for joint, planned in zip(compiled.joints, pose, strict=True)]
    return compiled.envelope.order_of_legs(here, pose)


def ranges(sweeps: Iterable[PlannedSweep | PlannedNoise]) -> dict[str, Range]:
    """Lowest and highest position of each moved axis: legs between poses, and windows at which a sweep is stopped."""
    found: dict[str, Range] = {}
    for sweep in sweeps:
        for position in sweep.position_window:
            _reach(found, sweep.spec.axis, position)
        for leg in sweep.legs:
            _reach(found, leg.joint, leg.target)
    return found


def with_approach(
    planned: Mapping[str, Range], joints: Sequence[str], positions: Mapping[str, float], legs: Sequence[Leg]
) -> dict[str, Range]:
    """The ranges with the present positions of all axes and the targets of the approach."""
    found = dict(planned)
    for joint, position in positions.items():
        _reach(found, joint, position)
    for index, target in legs:
        _reach(found, joints[index], target)
    return found


def check_seen(
    seen: Mapping[str, Range], compiled: CompiledPlan, pose: Sequence[float], positions: Mapping[str, float]
) -> None:
    """Whether the axes stand in the ranges that a person saw, and the approach stays in them. Conflict, otherwise.

    The tolerance is that of a pose.
    """
    units = compiled.envelope.units()
    for joint, position in positions.items():
        if joint in seen:
            _inside(joint, "stands at", position, seen[joint], compiled.pose_tolerance, units[joint])
    for index, target in approach(compiled, pose, positions):
        joint = compiled.joints[index]
        if joint not in seen:
            raise Conflict(
                f"{joint} would move from {positions[joint]:.4f} to {target:.4f} {units[joint]}, which was not shown "
                "before the start: look at the motion again, then start"
            )
        _inside(joint, "would move to", target, seen[joint], compiled.pose_tolerance, units[joint])


def _reach(found: dict[str, Range], joint: str, position: float) -> None:
    low, high = found.get(joint, (position, position))
    found[joint] = (min(low, position), max(high, position))


def _inside(joint: str, does: str, position: float, seen: Range, tolerance: float, unit: str) -> None:
    if not seen[0] - tolerance <= position <= seen[1] + tolerance:
        raise Conflict(
            f"{joint} {does} {position:.4f} {unit}, outside of {seen[0]:.4f} to {seen[1]:.4f} {unit} that was shown "
            "before the start: look at the motion again, then start"
        )
