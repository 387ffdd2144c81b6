"""The compiled plan of a campaign for this machine: commands, and the envelope that limits them."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from service.model.configuration import read_cell
from service.model.errors import Conflict
from service.model.robot import Robot
from service.planning.analysis.documents import AnalysisPlan
from service.planning.diagnosis.documents import DiagnosisPlan, ExperimentPlan
from service.planning.machine_setup import MachineSetup
from service.planning.motion_hash import motion_sha256
from service.planning.plan import PlanDocument
from service.planning.safety.envelope import Envelope
from service.planning.safety.noise_motion import Command
from service.planning.safety.robot_and_machine import DriveAxis, differences, on_machine
from service.planning.trajectories.documents import TrajectoryPlan
from service.process.settings import Settings
from service.store.documents import CampaignDocument, NewSweep, PlanRecord, SweepDocument, SweepState
from service.store.store import Store

Plan = PlanDocument | AnalysisPlan | TrajectoryPlan | DiagnosisPlan | ExperimentPlan

KINDS: Mapping[str, type[Plan]] = {
    "analysis": AnalysisPlan,
    "trajectory": TrajectoryPlan,
    "diagnosis": DiagnosisPlan,
    "experiment": ExperimentPlan,
}


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
    sha256: str = ""  # of all data that determine motion (`motion_hash`); "": unknown, cannot be approved

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
    request = record.document.get("request")
    kind = request.get("kind") if isinstance(request, dict) else None
    return KINDS.get(str(kind), PlanDocument).model_validate(record.document)


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


def present_motion_sha256(store: Store, settings: Settings, machine: MachineSetup, plan_id: int) -> str:
    """Hash of all data that determine the motion of a plan now (see `motion_hash`); blocks."""
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
        trajectories=plan.at_once if isinstance(plan, TrajectoryPlan) else (),
        confidence=plan.request.confidence if isinstance(plan, PlanDocument) else None,
        base_parameters=len(plan.base_parameters) if isinstance(plan, PlanDocument) else 0,
        sha256=motion_sha256(record, origin, cell, settings, machine.sha256),
    )
