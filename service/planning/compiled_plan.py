"""The compiled plan of a campaign for this machine: commands, and the envelope that limits them."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version

from drivers.errors import CommunicationLost
from drivers.ports import AxisState, AxisStatus
from service import Conflict
from service.model import Robot
from service.model.configuration import Cell, read_cell
from service.planning.documents import (
    AnalysisPlan,
    DiagnosisPlan,
    ExperimentPlan,
    PlanDocument,
    PlannedNoise,
    PlannedSweep,
    TrajectoryPlan,
    at_once,
)
from service.planning.machine_setup import DriveAxis, MachineSetup, differences, on_machine, sha256_of
from service.planning.safety.envelope_check import Command, Envelope
from service.planning.safety.travel import Leg
from service.process.settings import Settings
from service.store.documents import CampaignDocument, NewSweep, PlanRecord, RobotDocument, SweepDocument, SweepState
from service.store.store import Store

Plan = PlanDocument | AnalysisPlan | TrajectoryPlan | DiagnosisPlan | ExperimentPlan


@dataclass(frozen=True)
class CompiledPlan:
    """The commands of a campaign by sweep number."""

    joints: tuple[str, ...]  # of the robot, from base to tip: the order in poses
    commands: Mapping[int, Command]
    envelope: Envelope
    move_velocity: float  # rad/s (m/s), between poses
    pose_tolerance: float  # rad (m), actual against planned pose
    trajectories: tuple[tuple[int, ...], ...] = ()  # numbers of the sweeps that run at the same time
    confidence: float | None = None  # percent, at which the campaign may end (`enough`); None: all sweeps are needed
    base_parameters: int = 0  # number that the plan measures
    sha256: str = ""  # of all data that determine motion (`motion_sha256`); "": unknown, cannot be approved

    def due(self, sweeps: Sequence[SweepDocument], repeat: bool = False) -> list[SweepDocument]:
        """The next planned sweep with the others of its trajectory; empty if none is left.

        A trajectory with one measured sweep is skipped: it can only be repeated as a whole. `repeat`: failed and
        interrupted sweeps count as planned.
        """
        planned = {sweep.number for sweep in sweeps if is_due(sweep.state, repeat)}
        for sweep in sweeps:
            numbers = next((numbers for numbers in self.trajectories if sweep.number in numbers), (sweep.number,))
            if planned.issuperset(numbers):
                return [each for each in sweeps if each.number in numbers]
        return []


def is_due(state: SweepState, repeat: bool) -> bool:
    """Whether a start runs a sweep in this state; with `repeat`, failed and interrupted ones too."""
    return state is SweepState.PLANNED or (repeat and state in (SweepState.FAILED, SweepState.INTERRUPTED))


def plan_of(record: PlanRecord) -> Plan:
    """A stored plan of any kind."""
    kinds: Mapping[str, type[Plan]] = {
        "analysis": AnalysisPlan,
        "trajectory": TrajectoryPlan,
        "diagnosis": DiagnosisPlan,
        "experiment": ExperimentPlan,
    }
    request = record.document.get("request")
    kind = request.get("kind") if isinstance(request, dict) else None
    return kinds.get(str(kind), PlanDocument).model_validate(record.document)


def planned_sweeps(plan: PlanRecord) -> tuple[NewSweep, ...]:
    """The sweeps of a stored plan, in order."""
    document = plan_of(plan)
    return tuple(NewSweep(spec=sweep.spec, mode=sweep.mode) for sweep in document.sweeps)


def other_machine(
    robot: Robot, robot_id: int, settings: Settings, axes: Sequence[DriveAxis], moved: Collection[str]
) -> str:
    """The reason why the machine with these drive axes cannot move `moved` joints of this robot; "" if it can."""
    place = f"robot {robot.name} (number {robot_id})"
    return differences(robot, place, axes, f"drive profile {settings.drive}", moved)


def motion_sha256(plan: PlanRecord, robot: RobotDocument, cell: Cell, settings: Settings, machine: str) -> str:
    """SHA-256 of plan, robot, cell, tolerance, program, name of the machine and `machine` (see `machine_sha256`),
    hexadecimal: all that determines the motion of a plan. An approval is valid only for this hash.
    """
    content = {
        "plan": plan.document,
        "robot": robot.sha256,
        "cell": cell.model_dump(mode="json"),
        "pose_tolerance": settings.pose_tolerance,
        "machine": machine,
        "machine_name": settings.machine_name,
        "program": version("sweepid"),
    }
    return sha256_of(content)


def present_motion_sha256(store: Store, settings: Settings, machine: MachineSetup, plan_id: int) -> str:
    """Hash of all data that determine the motion of a plan now (see `motion_sha256`); blocks."""
    plan = store.plan(plan_id)
    cell = read_cell(settings.cells_dir / f"{plan_of(plan).request.cell}.yaml")
    return motion_sha256(plan, store.robot(plan.robot_id), cell, settings, machine.sha256)


def _moved(plan: Plan) -> set[str]:
    """Joints that the sweeps of the plan or the legs to them move."""
    return {name for sweep in plan.sweeps for name in (sweep.spec.axis, *(leg.joint for leg in sweep.legs))}


def compile_plan(store: Store, settings: Settings, machine: MachineSetup, campaign: CampaignDocument) -> CompiledPlan:
    """The compiled plan of a campaign; errors as `compile_record`. Conflict for a campaign without plan."""
    if campaign.plan_id is None:
        raise Conflict(f"campaign {campaign.id} was imported and cannot be run")
    return compile_record(store, settings, machine, store.plan(campaign.plan_id), f"campaign {campaign.id}")


def compile_record(
    store: Store, settings: Settings, machine: MachineSetup, record: PlanRecord, what: str
) -> CompiledPlan:
    """The compiled plan for this machine; BadInput for a bad cell file. `what`: the name in an error.

    Conflict if its robot does not match the drives, or if robot or cell is not the machine's and nobody confirmed it.
    """
    origin = store.robot(record.robot_id)
    plan, robot = plan_of(record), origin.build()
    other = other_machine(robot, record.robot_id, settings, machine.axes, _moved(plan))
    if other:
        raise Conflict(f"{what} is for another machine: {other}")
    try:
        machine.check(origin, plan.request.cell, plan.made_for)
    except Conflict as differs:
        raise Conflict(f"{what}: {differs}") from None
    cell = read_cell(settings.cells_dir / f"{plan.request.cell}.yaml")
    return CompiledPlan(
        joints=robot.joints,
        commands={number: sweep.command() for number, sweep in enumerate(plan.sweeps, 1)},
        envelope=Envelope(
            on_machine(robot, machine.axes),
            cell,
            plan.limits if isinstance(plan, DiagnosisPlan | ExperimentPlan) else None,
            plan.request.known_mass if isinstance(plan, ExperimentPlan) else None,
        ),
        move_velocity=plan.request.move_velocity,
        pose_tolerance=settings.pose_tolerance,
        trajectories=() if isinstance(plan, AnalysisPlan) else at_once(plan.sweeps),
        confidence=plan.request.confidence if isinstance(plan, PlanDocument) else None,
        base_parameters=len(plan.base_parameters) if isinstance(plan, PlanDocument) and not plan.groups else 0,
        sha256=motion_sha256(record, origin, cell, settings, machine.sha256),
    )


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
