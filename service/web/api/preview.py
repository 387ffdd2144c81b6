"""What a start or resume will move, for the person who decides: robot, cell, machine, approach, range of each axis."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Literal

import numpy as np
from fastapi import APIRouter, Query
from pydantic import BaseModel, ConfigDict
from starlette.concurrency import run_in_threadpool

from drivers.errors import DriveError
from service.machine.execution.sweep_executor import travels
from service.model.configuration import read_cell
from service.model.errors import Conflict, NotFound, SweepidError
from service.model.outline import Outline, Outlines
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
from service.planning.plan import PlanDocument
from service.planning.poses import grid, has_room
from service.planning.safety.envelope import Envelope
from service.store.access import Role
from service.store.documents import PlanRecord
from service.web.api.dependencies import ApplicationOf, Id, SettingsOf, StoreOf
from service.web.api.route_roles import allow
from service.web.application import Application

ahead_routes = APIRouter(tags=["campaigns"])
picture_routes = APIRouter(tags=["plans"])


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


@ahead_routes.get("/campaigns/{campaign_id}/ahead")
@allow(Role.VIEWER)
async def get_campaign_ahead(campaign_id: Id, application: ApplicationOf, repeat: bool = False) -> Ahead:
    """Of the planned sweeps; with `repeat` also of the failed and interrupted ones. Computed now; nothing moves.

    409 for an imported campaign, for one without such sweeps, and while a campaign runs.
    """
    stand = await _stand(application)
    return await run_in_threadpool(_of_campaign, application, campaign_id, repeat, stand)


@ahead_routes.get("/plans/{plan_id}/ahead")
@allow(Role.VIEWER)
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


Corners = tuple[tuple[float, float], ...]


class OutlineView(BaseModel):
    """Outline of a link or of a box of the cell. Corners in m: (x, z) from the side, (x, y) from above."""

    model_config = ConfigDict(from_attributes=True)
    name: str
    side: Corners
    above: Corners


class Picture(BaseModel):
    """The arm in its cell after `step` of the `steps` legs that lead to the pose of a sweep.

    `pose`: rad (m), in the order of `joints`. `moves`: the joint that moves in this leg; empty at step 0.
    `floor`: height of the floor, m; null if the cell has none.
    """

    sweep: int
    step: int
    steps: int
    joints: tuple[str, ...]
    pose: tuple[float, ...]
    moves: str
    robot: tuple[OutlineView, ...]
    cell: tuple[OutlineView, ...]
    floor: float | None


class GridPose(BaseModel):
    """`at`: positions of the varied joints, rad (m). `state`: "chosen", the plan has sweeps in this pose; "free", it
    could be measured; "no_room", an axis has no room for its sweep; "collides", robot or cell would collide."""

    at: tuple[float, ...]
    state: Literal["chosen", "free", "no_room", "collides"]


class PoseGrid(BaseModel):
    """The poses from which a plan was chosen. `total`: poses of the grid; `poses` may contain every n-th one only."""

    varied: tuple[str, ...]
    total: int
    poses: tuple[GridPose, ...]


class Cells(BaseModel):
    """Names of the cells for which a plan can be made."""

    names: tuple[str, ...]


@picture_routes.get("/cells")
@allow(Role.VIEWER)
def list_cells(settings: SettingsOf) -> Cells:
    return Cells(names=tuple(sorted(file.stem for file in settings.cells_dir.glob("*.yaml"))))


@picture_routes.get("/plans/{plan_id}/picture")
@allow(Role.VIEWER)
def get_picture(
    plan_id: Id,
    store: StoreOf,
    settings: SettingsOf,
    sweep: Annotated[int, Query(ge=1, le=100_000, description="number of the sweep, from 1")] = 1,
    step: Annotated[int | None, Query(ge=0, le=10_000, description="legs done; default: all, the sweep's pose")] = None,
) -> Picture:
    """The picture is computed for each request. Nothing moves."""
    record = store.plan(plan_id)
    plan, robot = plan_of(record), store.robot(record.robot_id).build()
    if sweep > len(plan.sweeps):
        raise NotFound(f"sweep {sweep} does not exist; plan {plan_id} has {len(plan.sweeps)} sweeps")
    wanted = plan.sweeps[sweep - 1]
    steps = len(wanted.legs)
    done = steps if step is None else step
    if done > steps:
        raise NotFound(f"leg {done} does not exist; sweep {sweep} of plan {plan_id} is reached in {steps} legs")
    cell = read_cell(settings.cells_dir / f"{plan.request.cell}.yaml")
    pose = list(cell.home_pose(robot.joints) if sweep == 1 else plan.sweeps[sweep - 2].spec.pose)
    for leg in wanted.legs[:done]:
        pose[robot.index(leg.joint)] = leg.target
    if done == steps:
        pose = list(wanted.spec.pose)
    outlines = Outlines(robot, cell)
    return Picture(
        sweep=sweep,
        step=done,
        steps=steps,
        joints=robot.joints,
        pose=tuple(pose),
        moves=wanted.legs[done - 1].joint if done else "",
        robot=_views(outlines.of_robot(pose)),
        cell=_views(outlines.of_cell()),
        floor=cell.floor,
    )


@picture_routes.get("/plans/{plan_id}/grid")
@allow(Role.VIEWER)
def get_grid(plan_id: Id, store: StoreOf, settings: SettingsOf) -> PoseGrid:
    """409 for a plan that was not chosen from a grid (experiments, trajectories)."""
    most = 4000  # poses in one answer; of a larger grid every second, third ... pose is given
    record = store.plan(plan_id)
    plan, robot = plan_of(record), store.robot(record.robot_id).build()
    if not isinstance(plan, PlanDocument):
        raise Conflict(f"plan {plan_id} was not chosen from a grid of poses")
    cell = read_cell(settings.cells_dir / f"{plan.request.cell}.yaml")
    envelope = Envelope(robot, cell)
    poses = grid(robot, plan.request, envelope, np.array(cell.home_pose(robot.joints)))
    measured = np.array([one.spec.pose for one in plan.sweeps])
    chosen = (np.abs(poses[:, None, :] - measured[None, :, :]).max(axis=2) < 1e-6).any(axis=1)
    shown = chosen | (np.arange(len(poses)) % -(-len(poses) // most) == 0)
    poses, chosen = poses[shown], chosen[shown]
    free = envelope.checker.collision_free(poses)
    room = np.zeros(len(poses), dtype=bool)
    room[free] = has_room(envelope, poses[free], [robot.index(joint) for joint in plan.request.axes])
    varied = [robot.index(joint) for joint in plan.request.varied]
    rows = zip(poses[:, varied].tolist(), chosen.tolist(), free.tolist(), room.tolist(), strict=True)
    return PoseGrid(
        varied=plan.request.varied,
        total=len(shown),
        poses=tuple(GridPose(at=tuple(at), state=_state(*kinds)) for at, *kinds in rows),
    )


def _state(chosen: bool, free: bool, room: bool) -> Literal["chosen", "free", "no_room", "collides"]:
    if chosen:
        return "chosen"
    return "collides" if not free else "free" if room else "no_room"


def _views(outlines: tuple[Outline, ...]) -> tuple[OutlineView, ...]:
    return tuple(OutlineView.model_validate(one) for one in outlines)
