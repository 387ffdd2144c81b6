"""Robots: description and URDF. A robot never changes; a corrected one is another robot with the same name."""

from collections.abc import Mapping
from datetime import datetime
from functools import partial
from typing import Annotated, cast

from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import BaseModel, ConfigDict, Discriminator, Field, JsonValue, StringConstraints, Tag, computed_field

from service.identification.estimates.initial_analysis import analyses_from
from service.identification.estimates.robot_type import robot_type
from service.model.configuration import read_cell
from service.model.errors import BadInput
from service.model.results.estimate import Analyses
from service.model.results.part import JsonOf
from service.model.robot import RobotDescription, robot_from_outside
from service.planning.analysis import build_analysis_plan
from service.planning.campaigns.stored_plan import PlanSubject, planned_times
from service.planning.campaigns.stored_results import check_beside, latest_analysis, siblings
from service.planning.compiled_plan import Plan, other_machine, present_motion_sha256
from service.planning.diagnosis import build_diagnosis_plan
from service.planning.documents import AnalysisRequest, DiagnosisRequest, TrajectoryRequest
from service.planning.machine_setup import narrowed, on_machine
from service.planning.plan import PlanRequest, build_plan
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
