"""Campaigns: the ordered sweeps of one session at the machine, and the operator's commands.

Commands need `If-Match` with the campaign's ETag: 412 if the campaign has changed since the client read it.
"""

from collections.abc import Sequence
from typing import Annotated

from fastapi import APIRouter, Request, Response
from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from starlette.concurrency import run_in_threadpool

from service.machine.execution.check_move import CheckMove
from service.machine.execution.sign_of_life import SignOfLife
from service.model.results.check import DataCheck
from service.planning.ahead import Range
from service.planning.campaigns.plan_subject import PlanSubject
from service.store.access.credentials import masked
from service.store.documents import LARGEST_ID, CampaignDocument, SweepDocument, SweepState, SweepStatus
from service.web.api.campaign.progress import Progress, StepView, progress, steps
from service.web.api.dependencies import After, ApplicationOf, Id, IfMatch, IntentionOf, Limit, Page, page, set_etag
from service.web.api.idempotent import IdempotentRoute
from service.web.api.people.audit_trail import Fact, audit_trail_of
from service.web.application import Application

router = APIRouter(prefix="/campaigns", tags=["campaigns"], route_class=IdempotentRoute)


class NewCampaign(BaseModel):
    model_config = ConfigDict(extra="forbid")
    plan_id: int = Field(ge=1, le=LARGEST_ID)


class Attended(BaseModel):
    """`within_s`: maximum time between two signs of life, s; otherwise the axes stop and the campaign is paused."""

    model_config = ConfigDict(extra="forbid")
    within_s: float = Field(ge=1, le=3600)


class StartRequest(BaseModel):
    """`attended`: null if no sign of life is required. `seen`: `range` of GET ahead that was shown to the person; null:
    none was shown.
    """

    model_config = ConfigDict(extra="forbid")
    attended: Attended | None = None
    seen: dict[str, Range] | None = Field(default=None, max_length=100)

    @property
    def within(self) -> float | None:
        return None if self.attended is None else self.attended.within_s


class Resume(StartRequest):
    """`repeat`: failed and interrupted sweeps are measured again."""

    repeat: bool = False


class Abort(BaseModel):
    model_config = ConfigDict(extra="forbid")
    why: Annotated[str, AfterValidator(masked)] = Field(default="aborted by request", min_length=1, max_length=500)


class CheckMoveView(BaseModel):
    """An axis moves by `way` rad (m) and back. Only a person sees if it is the right axis and the right direction."""

    axis: str
    way: float
    unit: str


class AttendedView(BaseModel):
    """`left_s`: time until the campaign is paused, s."""

    within_s: float
    left_s: float


class CampaignView(CampaignDocument):
    """A campaign with its progress, the present motion (`motion`, with the next steps of this sweep) and the findings.

    `subject`: robot, cell and machine of its plan; null for an imported one. `check_move`: the one that runs now.
    `attended`: only while the campaign runs and requires a sign of life.
    `data_check`: as `sweepid check --json` gives it; null until the campaign is over and was checked.
    """

    subject: PlanSubject | None
    progress: Progress
    motion: tuple[StepView, ...]
    check_move: CheckMoveView | None
    attended: AttendedView | None
    data_check: DataCheck | None


@router.post("", status_code=201)
async def add_campaign(
    new: NewCampaign, request: Request, response: Response, application: ApplicationOf
) -> CampaignView:
    """Create a campaign of a stored plan. Nothing moves until the campaign is started."""
    campaign = await application.add_campaign(new.plan_id)
    response.headers["Location"] = str(request.url_for("get_campaign", campaign_id=campaign.id))
    return await _answer(application, campaign, response)


@router.get("")
def list_campaigns(application: ApplicationOf, after: After = 0, limit: Limit = 50) -> Page[CampaignDocument]:
    return page(application.store.campaigns(after, limit), limit)


@router.get("/{campaign_id}")
async def get_campaign(campaign_id: Id, response: Response, application: ApplicationOf) -> CampaignView:
    return await _answer(application, await run_in_threadpool(application.store.campaign, campaign_id), response)


@router.post("/{campaign_id}/start")
async def start_campaign(
    campaign_id: Id,
    request: Request,
    response: Response,
    application: ApplicationOf,
    version: IfMatch,
    intention: IntentionOf,
    start: StartRequest | None = None,
) -> CampaignView:
    """Start to move and measure. 409 with the reason, also if the plan needs an approval and has no valid one, if its
    robot or cell is not the machine's and nobody confirmed it, or if an axis has left what was `seen`.

    409 `superseded`: a stop, a gap of the host or trouble with the lease came after the request.
    """
    wanted = start or StartRequest()
    audit_trail_of(request.scope).facts = await _facts(application, campaign_id, wanted)
    campaign = await application.runner.start(campaign_id, intention, version, wanted.within, wanted.seen)
    return await _answer(application, campaign, response)


@router.post("/{campaign_id}/sign_of_life")
async def show_life(campaign_id: Id, application: ApplicationOf) -> AttendedView | None:
    """A person monitors the machine; null if no sign of life is required. 409 if the campaign does not run.

    Needs no audit entry; the database is read only to check the key. Without signs of life the campaign is paused.
    """
    return _attended(application.runner.sign_of_life(campaign_id))


@router.post("/{campaign_id}/pause")
async def pause_campaign(
    campaign_id: Id, response: Response, application: ApplicationOf, version: IfMatch
) -> CampaignView:
    """Pause after the present sweep."""
    return await _answer(application, await application.runner.pause(campaign_id, version), response)


@router.post("/{campaign_id}/resume")
async def resume_campaign(
    campaign_id: Id,
    request: Request,
    response: Response,
    application: ApplicationOf,
    version: IfMatch,
    intention: IntentionOf,
    resume: Resume | None = None,
) -> CampaignView:
    """Continue with the next planned sweep. 409 as for a start.

    If the campaign is still pausing, the pause is cancelled; `attended` null then keeps the condition of the start.
    """
    wanted = resume or Resume()
    audit_trail_of(request.scope).facts = await _facts(application, campaign_id, wanted)
    campaign = await application.runner.resume(
        campaign_id, intention, version, wanted.repeat, wanted.within, wanted.seen
    )
    return await _answer(application, campaign, response)


@router.post("/{campaign_id}/abort")
async def abort_campaign(
    campaign_id: Id, response: Response, application: ApplicationOf, version: IfMatch, abort: Abort | None = None
) -> CampaignView:
    """Stop the present sweep now and abort the campaign. Recorded data are kept."""
    why = (abort or Abort()).why
    return await _answer(application, await application.runner.abort(campaign_id, why, version), response)


def view(application: Application, campaign: CampaignDocument) -> CampaignView:
    """The campaign with its progress. Reads the store."""
    checked = application.checks.document(campaign.id)
    times = () if campaign.plan_id is None else application.planned_times(campaign.plan_id)
    subject = None if campaign.plan_id is None else application.subjects(campaign.plan_id)
    statuses = application.store.sweep_statuses(campaign.id)
    current = _current(application, campaign.id, statuses)
    runner = None if application.cell is None or application.runner.running != campaign.id else application.runner
    under_way, check_move = (None, None) if runner is None else (runner.under_way, runner.check_move)
    return CampaignView(
        **campaign.model_dump(),
        subject=subject,
        progress=progress(campaign.state, statuses, times, under_way, current=current),
        motion=steps(under_way, check_move),
        check_move=_check_move(check_move),
        attended=None if runner is None else _attended(runner.attendance),
        data_check=None if checked is None else DataCheck.read(checked, f"data check of campaign {campaign.id}"),
    )


async def _facts(application: Application, campaign_id: int, start: StartRequest) -> dict[str, Fact]:
    """What the audit has of a start."""
    campaign = await run_in_threadpool(application.store.campaign, campaign_id)
    facts: dict[str, Fact] = {"attended": start.within}
    if campaign.plan_id is None:
        return facts
    subject = await run_in_threadpool(application.subjects, campaign.plan_id)
    return facts | {"plan": campaign.plan_id, "subject": subject.sentence}


def _current(application: Application, campaign_id: int, statuses: Sequence[SweepStatus]) -> SweepDocument | None:
    """The sweep that runs; None also if it has just ended."""
    running = next((one.number for one in statuses if one.state is SweepState.RUNNING), None)
    found = None if running is None else application.store.sweep(campaign_id, running)
    return found if found is not None and found.state is SweepState.RUNNING else None


def _attended(attendance: SignOfLife | None) -> AttendedView | None:
    return None if attendance is None else AttendedView(within_s=attendance.within, left_s=attendance.left)


def _check_move(move: CheckMove | None) -> CheckMoveView | None:
    if move is None:
        return None
    return CheckMoveView(axis=move.joint, way=move.way, unit=move.units[move.joint])


async def _answer(application: Application, campaign: CampaignDocument, response: Response) -> CampaignView:
    set_etag(response, campaign.version)
    return await run_in_threadpool(view, application, campaign)
