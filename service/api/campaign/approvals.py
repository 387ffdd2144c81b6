"""Approvals of plans: with the setting `approval` nothing of a plan moves that no engineer has approved."""

from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict, StringConstraints

from service.api.dependencies import ApplicationOf, Id
from service.api.idempotent import IdempotentRoute
from service.api.people.trail import trail_of
from service.people.keys import masked
from service.store.approvals import ApprovalDocument
from service.store.tables import now

router = APIRouter(prefix="/plans/{plan_id}/approvals", tags=["plans"], route_class=IdempotentRoute)


class NewApproval(BaseModel):
    """`sha256` of what the person looked at, as GET tells it. `approved_by`: who; with login it is who asks."""

    model_config = ConfigDict(extra="forbid")
    sha256: Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")]
    approved_by: Annotated[str, StringConstraints(strip_whitespace=True, min_length=1, max_length=100)] | None = None


class ApprovalView(ApprovalDocument):
    """`void`: why it does not hold now; empty if it does."""

    void: str


class PlanApprovals(BaseModel):
    """`needed`: whether a start wants one. `sha256`: of all that decides what the plan moves now.

    `missing`: why who asks may not start a campaign of the plan; empty if he may. `items`: the newest first.
    """

    needed: bool
    sha256: str
    missing: str
    items: tuple[ApprovalView, ...]


@router.get("")
def list_approvals(plan_id: Id, request: Request, application: ApplicationOf) -> PlanApprovals:
    sha256, by = application.motion_sha256(plan_id), who_asks(request, application)
    return PlanApprovals(
        needed=application.approvals.needed,
        sha256=sha256,
        missing=application.approvals.missing(plan_id, sha256, by),
        items=tuple(_view(each, sha256) for each in application.approvals.of_plan(plan_id)),
    )


@router.post("", status_code=201)
def approve_plan(plan_id: Id, new: NewApproval, request: Request, application: ApplicationOf) -> ApprovalView:
    """Approve what the plan moves, for as long as the setting `approval_valid` says. Nothing moves by this.

    409 where robot, cell, drives, settings or program are no longer what was looked at.
    """
    by = who_asks(request, application) or new.approved_by or ""
    trail_of(request.scope).told = {"plan": plan_id, "sha256": new.sha256, "by": masked(by)}
    sha256 = application.motion_sha256(plan_id)
    return _view(application.approvals.add(plan_id, new.sha256, sha256, by), sha256)


def who_asks(request: Request, application: ApplicationOf) -> str:
    """The name, where the service knows it; "" where it asks nobody."""
    return trail_of(request.scope).actor if application.settings.login else ""


def _view(approval: ApprovalDocument, sha256: str) -> ApprovalView:
    return ApprovalView(**approval.model_dump(), void=approval.trouble(sha256, now()))
