"""What a campaign's plan comes to at this machine: commands, and the envelope they are checked against."""

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.ports import SweepCommand
from service.campaigns.envelope import Envelope
from service.campaigns.plan import PlanDocument
from service.cell import read_cell
from service.errors import Conflict
from service.settings import Settings
from service.store.documents import CampaignDocument, NewSweep, PlanRecord
from service.store.store import Store


@dataclass(frozen=True)
class Course:
    """The commands of a campaign by sweep number."""

    joints: tuple[str, ...]  # of the robot, base to tip: the order of poses
    commands: Mapping[int, SweepCommand]
    envelope: Envelope
    move_velocity: float  # rad/s (m/s), between poses
    pose_tolerance: float  # rad (m), actual against planned pose


def planned_sweeps(plan: PlanRecord) -> tuple[NewSweep, ...]:
    """The sweeps of a stored plan, in order."""
    document = PlanDocument.model_validate(plan.document)
    return tuple(NewSweep(spec=sweep.spec, mode=sweep.mode) for sweep in document.sweeps)


def course_of(store: Store, settings: Settings, campaign: CampaignDocument) -> Course:
    """The course of a planned campaign; BadInput for a bad cell file, Conflict for a campaign without plan."""
    if campaign.plan_id is None:
        raise Conflict(f"campaign {campaign.id} was imported and cannot be run")
    plan = PlanDocument.model_validate(store.plan(campaign.plan_id).document)
    robot = store.robot(campaign.robot_id).build()
    cell = read_cell(settings.cells_dir / f"{plan.request.cell}.yaml")
    return Course(
        joints=robot.joints,
        commands={number: sweep.command() for number, sweep in enumerate(plan.sweeps, 1)},
        envelope=Envelope(robot, cell),
        move_velocity=plan.request.move_velocity,
        pose_tolerance=settings.pose_tolerance,
    )
