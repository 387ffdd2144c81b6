"""Robots: description and URDF. A robot never changes; a corrected one is another robot with the same name.

What a start or resume will move, for the person who decides: robot, cell, machine, approach, range of each axis.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from typing import Annotated, Literal, cast

import numpy as np
from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Discriminator, Field, JsonValue, StringConstraints, Tag, computed_field
from starlette.concurrency import run_in_threadpool

from drivers.errors import DriveError
from service import BadInput, Conflict, NotFound, SweepidError
from service.identification.estimates.initial_analysis import analyses_from
from service.identification.estimates.robot_type import robot_type
from service.machine.execution.sweep_executor import travels
from service.model import RobotDescription, robot_from_outside
from service.model.configuration import read_cell
from service.model.outline import Outline, Outlines
from service.model.results.estimate import Analyses
from service.model.results.part import JsonOf
from service.planning.analysis import build_analysis_plan
from service.planning.campaigns.stored_plan import PlanSubject, planned_times
from service.planning.campaigns.stored_results import check_beside, latest_analysis, siblings
from service.planning.compiled_plan import (
    CompiledPlan,
    Plan,
    Range,
    approach,
    compile_record,
    is_due,
    other_machine,
    plan_of,
    positions_of,
    present_motion_sha256,
    ranges,
    with_approach,
)
from service.planning.diagnosis import build_diagnosis_plan
from service.planning.documents import AnalysisRequest, DiagnosisRequest, PlannedLeg, TrajectoryRequest
from service.planning.machine_setup import narrowed, on_machine
from service.planning.plan import PlanDocument, PlanRequest, build_plan
from service.planning.poses import grid, has_room
from service.planning.safety.envelope_check import Envelope
from service.planning.trajectories import build_trajectory_plan
from service.store.access import PersonName, Role
from service.store.documents import PlanRecord, RobotDocument
from service.store.lease_and_latch import ApprovalDocument
from service.store.tables import now
from service.web.api.access import audit_trail_of
from service.web.api.campaigns import expected_time
from service.web.api.dependencies import (
    After,
    ApplicationOf,
    ApprovalsOf,
    CallerOf,
    Id,
    IdempotentRoute,
    IntentionOf,
    Limit,
    Page,
    SettingsOf,
    StoreOf,
    page,
)
from service.web.api.problem import TAG
from service.web.api.route_roles import allow
from service.web.application import Application

robot_routes = APIRouter(prefix="/robots", tags=["robots"], route_class=IdempotentRoute)
plan_routes = APIRouter(prefix="/plans", tags=["plans"], route_class=IdempotentRoute)
approval_routes = APIRouter(prefix="/plans/{plan_id}/approvals", tags=["plans"], route_class=IdempotentRoute)
Name = Annotated[str | None, Query(max_length=200)]


def _typed(confirm_robot: Name = None, confirm_cell: Name = None) -> Mapping[str, str | None]:
    return {"robot": confirm_robot, "cell": confirm_cell}


Typed = Annotated[Mapping[str, str | None], Depends(_typed)]
"""Names that a person typed, by "robot" and "cell" (query `confirm_robot`, `confirm_cell`). They are needed, and stored
with the plan, only if its robot or cell is not the machine's; the 409 `needs-confirmation` says what to type.
"""


class NewRobot(BaseModel):
    """`description`: as the "robot" object of a bundle (its `urdf` is a file name). `urdf_text`: the URDF itself."""

    model_config = ConfigDict(extra="forbid")
    description: RobotDescription
    urdf_text: str = Field(min_length=1)


class RobotEntry(BaseModel):
    """A robot in the list."""

    id: int
    name: str
    joints: tuple[str, ...]
    created_at: datetime


@robot_routes.post("", status_code=201)
@allow(Role.ENGINEER)
def add_robot(robot: NewRobot, store: StoreOf) -> RobotDocument:
    """Store a robot. The same description and URDF give the same robot."""
    return store.add_robot(robot_from_outside(robot.description, robot.urdf_text))


@robot_routes.get("")
@allow(Role.VIEWER)
def list_robots(store: StoreOf, after: After = 0, limit: Limit = 50) -> Page[RobotEntry]:
    robots = store.robots(after, limit)
    entries = tuple(
        RobotEntry(
            id=robot.id,
            name=robot.name,
            joints=tuple(axis.joint for axis in robot.description.axes),
            created_at=robot.created_at,
        )
        for robot in robots
    )
    return page(entries, limit)


@robot_routes.get("/{robot_id}")
@allow(Role.VIEWER)
def get_robot(robot_id: Id, store: StoreOf) -> RobotDocument:
    return store.robot(robot_id)


def _kind(body: object) -> str:
    given = cast("dict[str, object]", body).get("kind") if isinstance(body, dict) else getattr(body, "kind", None)
    return f"{TAG}{given}" if given in ("analysis", "trajectory", "diagnosis") else f"{TAG}sweeps"


Wanted = Annotated[
    Annotated[AnalysisRequest, Tag(f"{TAG}analysis")]
    | Annotated[TrajectoryRequest, Tag(f"{TAG}trajectory")]
    | Annotated[DiagnosisRequest, Tag(f"{TAG}diagnosis")]
    | Annotated[PlanRequest, Tag(f"{TAG}sweeps")],
    Discriminator(_kind),
]


class PlanView(PlanRecord):
    """A stored plan; its request selects the kind of `document`. `expected_time`: s, with the check moves."""

    document: Annotated[dict[str, JsonValue], JsonOf(Plan)]

    @computed_field
    @property
    def expected_time(self) -> float:
        """Remaining time of a campaign of this plan before its start, s."""
        return expected_time(planned_times(self))


@plan_routes.post("", status_code=201, response_model=PlanView)
@allow(Role.ENGINEER)
def add_plan(
    wanted: Wanted,
    request: Request,
    response: Response,
    application: ApplicationOf,
    by: CallerOf,
    typed: Typed,
    elsewhere: bool = False,
) -> PlanRecord:
    """Choose poses and excitation, and store the plan. This takes seconds to minutes; nothing moves.

    `kind` "analysis": an initial analysis. A plan of sweeps can use the campaign of an initial analysis (`analysis`).
    `kind` "trajectory": exciting trajectories of several axes at the same time. `kind` "diagnosis": all kinds of sweeps
    in a few poses, for a diagnosis.

    The robot must match the drives of this service: gear ratios, rated efforts, limits. `elsewhere`: the plan is for
    another machine (part programs of a CNC); a campaign of it cannot be started here.

    409 `needs-confirmation` if robot or cell is not the machine's: `confirm` says which names a person has to type.
    """
    setup, origin = application.own.setup, application.store.robot(wanted.robot_id)
    robot = origin.build()
    other = "" if elsewhere else other_machine(robot, wanted.robot_id, application.settings, setup.axes, _moved(wanted))
    if other:
        raise BadInput("robot_id", f"belongs to another machine: {other}")
    wanted = wanted.model_copy(update={"cell": setup.own_cell(wanted.cell)})
    cell = read_cell(application.settings.cells_dir / f"{wanted.cell}.yaml")
    made_for = None
    if not elsewhere:
        confirmed = setup.confirmed(origin, wanted.cell, typed, by)
        made_for = confirmed.model_copy(update={"narrowed": narrowed(robot, setup.axes)})
        robot = on_machine(robot, setup.axes)
    if isinstance(wanted, AnalysisRequest):
        document = build_analysis_plan(robot, _with_excitation(wanted, application), cell)
    elif isinstance(wanted, TrajectoryRequest):
        if wanted.sweeps is not None:
            check_beside(application.store, wanted.sweeps, wanted.robot_id)
        document = build_trajectory_plan(robot, wanted, cell)
    elif isinstance(wanted, DiagnosisRequest):
        document = build_diagnosis_plan(robot, wanted, cell)
    else:
        analysed: Analyses = {} if wanted.analysis is None else latest_analysis(application.store, wanted.analysis)
        earlier = siblings(application.store, wanted.prior_from)
        of_type = robot_type(robot, earlier) if earlier else None
        document = build_plan(robot, wanted, cell, analyses_from(analysed), of_type)
    document = document.model_copy(update={"made_for": made_for})
    plan = application.store.add_plan(wanted.robot_id, document.model_dump(mode="json"))
    response.headers["Location"] = str(request.url_for("get_plan", plan_id=plan.id))
    return plan


def _moved(wanted: PlanRequest | AnalysisRequest | TrajectoryRequest | DiagnosisRequest) -> tuple[str, ...]:
    return wanted.axes if isinstance(wanted, TrajectoryRequest) else (*wanted.axes, *wanted.varied)


def _with_excitation(wanted: AnalysisRequest, application: Application) -> AnalysisRequest:
    """The request with an excitation that the machine supports; noise if the machine is not known."""
    if wanted.excitation is not None:
        return wanted
    able = not application.machine.connected or application.machine.capabilities.torque_injection
    return wanted.model_copy(update={"excitation": "noise" if able else "stepped_sine"})


@plan_routes.get("", response_model=Page[PlanView])
@allow(Role.VIEWER)
def list_plans(store: StoreOf, after: After = 0, limit: Limit = 50) -> Page[PlanRecord]:
    return page(store.plans(after, limit), limit)


@plan_routes.get("/{plan_id}", response_model=PlanView)
@allow(Role.VIEWER)
def get_plan(plan_id: Id, store: StoreOf) -> PlanRecord:
    return store.plan(plan_id)


class NewApproval(BaseModel):
    """`sha256`: of the reviewed plan, as GET gives it. `approved_by`: the name; with login, the name of the caller."""

    model_config = ConfigDict(extra="forbid")
    sha256: Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")]
    approved_by: PersonName | None = None


class ApprovalView(ApprovalDocument):
    """`void`: why the approval is not valid now; empty if it is valid."""

    void: str


class PlanApprovals(BaseModel):
    """`needed`: a start requires an approval. `sha256`: of all data that determine the motion of the plan now.

    `missing`: why the caller may not start a campaign of the plan; empty if allowed. `items`: newest first.
    """

    needed: bool
    subject: PlanSubject
    sha256: str
    missing: str
    items: tuple[ApprovalView, ...]


@approval_routes.get("")
@allow(Role.VIEWER)
def list_approvals(plan_id: Id, application: ApplicationOf, approvals: ApprovalsOf, by: CallerOf) -> PlanApprovals:
    sha256 = _sha256(application, plan_id)
    return PlanApprovals(
        needed=approvals.needed,
        subject=application.subjects(plan_id),
        sha256=sha256,
        missing=approvals.missing(plan_id, sha256, by),
        items=tuple(_view(each, sha256) for each in approvals.of_plan(plan_id)),
    )


@approval_routes.post("", status_code=201)
@allow(Role.ENGINEER)
def approve_plan(
    plan_id: Id, new: NewApproval, request: Request, application: ApplicationOf, intention: IntentionOf
) -> ApprovalView:
    """Approve the motion of the plan, for the time that the setting `approval_valid` gives. Nothing moves.

    409 if robot, cell, drives, settings or program have changed since the review.
    """
    by = intention.by or new.approved_by or ""
    audit_trail_of(request.scope).facts = {
        "plan": plan_id,
        "subject": application.subjects(plan_id).sentence,
        "sha256": new.sha256,
        "by": by,
    }
    sha256 = _sha256(application, plan_id)
    wanted = partial(application.machine.epochs.check, intention)
    return _view(application.own.approvals.add(plan_id, new.sha256, sha256, by, wanted), sha256)


def _sha256(application: Application, plan_id: int) -> str:
    return present_motion_sha256(application.store, application.settings, application.own.setup, plan_id)


def _view(approval: ApprovalDocument, sha256: str) -> ApprovalView:
    return ApprovalView(**approval.model_dump(), void=approval.trouble(sha256, now()))


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
