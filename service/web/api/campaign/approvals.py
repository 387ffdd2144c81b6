"""Approvals of plans: with the setting `approval`, a plan moves nothing before an engineer has approved it."""

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict, StringConstraints

from service.planning.campaigns.plan_subject import PlanSubject
from service.planning.compiled_plan import present_motion_sha256
from service.store.access.credentials import PersonName
from service.store.guards import ApprovalDocument
from service.store.tables import now
from service.web.api.dependencies import ApplicationOf, Id, IntentionOf, who_asks
from service.web.api.idempotent import IdempotentRoute
from service.web.api.people.audit_trail import audit_trail_of
from service.web.application import Application

router = APIRouter(prefix="/plans/{plan_id}/approvals", tags=["plans"], route_class=IdempotentRoute)


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


@router.get("")
def list_approvals(plan_id: Id, request: Request, application: ApplicationOf) -> PlanApprovals:
    sha256, by = _sha256(application, plan_id), who_asks(request, application)
    return PlanApprovals(
        needed=application.approvals.needed,
        subject=application.subjects(plan_id),
        sha256=sha256,
        missing=application.approvals.missing(plan_id, sha256, by),
        items=tuple(_view(each, sha256) for each in application.approvals.of_plan(plan_id)),
    )


@router.post("", status_code=201)
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
    return _view(application.approvals.add(plan_id, new.sha256, sha256, by, wanted), sha256)


def _sha256(application: Application, plan_id: int) -> str:
    return present_motion_sha256(application.store, application.settings, application.own.setup, plan_id)


def _view(approval: ApprovalDocument, sha256: str) -> ApprovalView:
    return ApprovalView(**approval.model_dump(), void=approval.trouble(sha256, now()))
