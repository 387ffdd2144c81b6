"""What a start or resume will move, for the person who decides: robot, cell, machine, approach, range of each axis."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime

from fastapi import APIRouter
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from drivers.errors import DriveError
from service.machine.execution.sweep_executor import travels
from service.model.errors import Conflict, SweepidError
from service.planning.campaigns.stored_plan import PlanSubject
from service.planning.compiled_plan import (
    CompiledPlan,
    Range,
    approach,
    compile_record,
    is_due,
    plan_of,
    positions_of,
    ranges,
    with_approach,
)
from service.planning.documents import PlannedLeg
from service.store.documents import PlanRecord
from service.web.api.dependencies import ApplicationOf, Id
from service.web.application import Application

router = APIRouter(tags=["campaigns"])


@dataclass(frozen=True)
class _Stand:
    """Where the axes stand; `trouble`: why that is not known."""

    positions: dict[str, float]
    trouble: str
    at: datetime | None


class Ahead(BaseModel):
    """`range`: lowest and highest position of each axis, rad (m); with the approach, if it is known. A start or resume
    with this `range` as `seen` is refused if an axis has left it meanwhile.

    `positions`: of the axes at the time `at`, rad (m). `approach`: the legs from there to the first pose, in order,
    `approach_time` s at the speed of moves between poses. `trouble`: why the approach is not known; empty if it is.
    `refused`: why the plan cannot be started on this machine; empty if it can.
    """

    subject: PlanSubject
    refused: str
    trouble: str
    at: datetime | None
    positions: dict[str, float]
    approach: tuple[PlannedLeg, ...]
    approach_time: float
    range: dict[str, Range]


@router.get("/campaigns/{campaign_id}/ahead")
async def get_campaign_ahead(campaign_id: Id, application: ApplicationOf, repeat: bool = False) -> Ahead:
    """Of the planned sweeps; with `repeat` also of the failed and interrupted ones. Computed now; nothing moves.

    409 for an imported campaign, for one without such sweeps, and while a campaign runs.
    """
    stand = await _stand(application)
    return await run_in_threadpool(_of_campaign, application, campaign_id, repeat, stand)


@router.get("/plans/{plan_id}/ahead")
async def get_plan_ahead(plan_id: Id, application: ApplicationOf) -> Ahead:
    """Of all sweeps of a plan. Computed now; nothing moves. 409 while a campaign runs."""
    stand = await _stand(application)
    return await run_in_threadpool(_of_plan, application, plan_id, stand)


async def _stand(application: Application) -> _Stand:
    """Conflict while a campaign runs: the axes move, and the computation would delay its set-points."""
    if application.cell is None:
        return _Stand({}, "this service has no machine", None)
    if application.runner.running is not None:
        raise Conflict(f"campaign {application.runner.running} is running: the approach is known when it has ended")
    if not application.machine.connected:
        return _Stand({}, f"the drives are not connected: {application.machine.trouble}", None)
    try:
        positions = positions_of(await application.machine.recent_status())
    except (DriveError, SweepidError) as error:
        return _Stand({}, str(error), None)
    return _Stand(positions, "", datetime.now(UTC))


def _of_campaign(application: Application, campaign_id: int, repeat: bool, stand: _Stand) -> Ahead:
    campaign = application.store.campaign(campaign_id)
    if campaign.plan_id is None:
        raise Conflict(f"campaign {campaign_id} was imported and cannot be run")
    sweeps = application.store.sweeps(campaign_id)
    due = [sweep for sweep in sweeps if is_due(sweep.state, repeat)]
    if not due:
        raise Conflict(f"campaign {campaign_id} has no sweep left to measure")
    if not campaign.here:
        stand = _Stand({}, f"campaign {campaign_id} belongs to machine {campaign.machine!r}: ask its service", None)
    record = application.store.plan(campaign.plan_id)
    compiled, refused = _compiled(application, record)
    first = (compiled.due(sweeps, repeat) if compiled else ()) or due
    return _ahead(application, record, compiled, refused, {sweep.number for sweep in due}, first[0].spec.pose, stand)


def _of_plan(application: Application, plan_id: int, stand: _Stand) -> Ahead:
    record = application.store.plan(plan_id)
    compiled, refused = _compiled(application, record)
    sweeps = plan_of(record).sweeps
    numbers = range(1, len(sweeps) + 1)
    return _ahead(application, record, compiled, refused, numbers, sweeps[0].spec.pose, stand)


def _compiled(application: Application, record: PlanRecord) -> tuple[CompiledPlan | None, str]:
    try:
        setup = application.own.setup
        return compile_record(application.store, application.settings, setup, record, f"plan {record.id}"), ""
    except SweepidError as error:
        return None, str(error)


def _ahead(
    application: Application,
    record: PlanRecord,
    compiled: CompiledPlan | None,
    refused: str,
    numbers: Collection[int],
    pose: Sequence[float],
    stand: _Stand,
) -> Ahead:
    """`numbers`: of the sweeps to run; `pose`: of the first one."""
    planned = ranges(sweep for number, sweep in enumerate(plan_of(record).sweeps, 1) if number in numbers)
    trouble, legs = stand.trouble or refused, ()
    if compiled is not None and not trouble:
        try:
            legs = approach(compiled, pose, stand.positions)
        except SweepidError as error:
            trouble = str(error)
    joints = () if compiled is None else compiled.joints
    here = tuple(stand.positions.get(joint, planned) for joint, planned in zip(joints, pose, strict=False))
    way = travels(joints, here, legs, 1.0 if compiled is None else compiled.move_velocity)
    return Ahead(
        subject=application.subjects(record.id),
        refused=refused,
        trouble=trouble,
        at=stand.at,
        positions=stand.positions,
        approach=tuple(PlannedLeg(joint=leg.joint, target=leg.target) for leg in way),
        approach_time=sum(leg.seconds for leg in way),
        range=with_approach(planned, joints, stand.positions, legs),
    )
