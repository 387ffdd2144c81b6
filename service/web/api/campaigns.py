"""Campaigns: the ordered sweeps of one session at the machine, and the operator's commands.

Commands need `If-Match` with the campaign's ETag: 412 if the campaign has changed since the client read it.
"""

import re
import time
from collections.abc import Sequence
from itertools import pairwise
from statistics import median
from typing import Annotated, Literal

from fastapi import APIRouter, Path, Request, Response
from fastapi.responses import FileResponse
from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from starlette.concurrency import run_in_threadpool

from service.machine.execution.check_move import DURATION, CheckMove
from service.machine.execution.energising import SignOfLife
from service.machine.execution.sweep_executor import CurrentActivity
from service.model.results.diagnosis import DataCheck
from service.planning.campaigns.stored_plan import PlannedTime, PlanSubject
from service.planning.compiled_plan import Range
from service.store.access import Role, masked
from service.store.documents import (
    LARGEST_ID,
    CampaignDocument,
    CampaignState,
    RecordingDocument,
    SweepDocument,
    SweepState,
    SweepStatus,
)
from service.web.api.access import Fact, audit_trail_of
from service.web.api.dependencies import (
    After,
    ApplicationOf,
    FilesOf,
    Id,
    IdempotentRoute,
    IfMatch,
    IntentionOf,
    Limit,
    Page,
    RunnerOf,
    StoreOf,
    media,
    page,
    set_etag,
)
from service.web.api.route_roles import allow
from service.web.application import Application

campaign_routes = APIRouter(prefix="/campaigns", tags=["campaigns"], route_class=IdempotentRoute)
sweep_routes = APIRouter(prefix="/campaigns/{campaign_id}/sweeps", tags=["sweeps"])


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


class Progress(BaseModel):
    """Progress of the measurement: `done` sweeps of `total` are recorded; `current` is the sweep that runs.

    `remaining`: s, with moves, check moves and settling; for a paused campaign, the time after its resume. Null if
    it is not known. `repeat`: additional s if a resume repeats the failed and interrupted sweeps. `pace`: ratio of
    measured to planned time, in both and in the steps; 1 below two sweeps.
    """

    done: int
    total: int
    remaining: float | None
    repeat: float
    pace: float
    current: SweepDocument | None


class StepView(BaseModel):
    """One step of the machine: `travel` of an axis to `target` rad (m), its `check_move`, or the `sweep` itself.

    `seconds`: duration of the whole step at the `pace` of the progress, s.
    """

    kind: Literal["check_move", "travel", "sweep"]
    axes: tuple[str, ...]
    target: float | None
    seconds: float


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


@campaign_routes.post("", status_code=201)
@allow(Role.OPERATOR)
async def add_campaign(
    new: NewCampaign, request: Request, response: Response, application: ApplicationOf
) -> CampaignView:
    """Create a campaign of a stored plan. Nothing moves until the campaign is started."""
    campaign = await application.add_campaign(new.plan_id)
    response.headers["Location"] = str(request.url_for("get_campaign", campaign_id=campaign.id))
    return await _answer(application, campaign, response)


@campaign_routes.get("")
@allow(Role.VIEWER)
def list_campaigns(store: StoreOf, after: After = 0, limit: Limit = 50) -> Page[CampaignDocument]:
    return page(store.campaigns(after, limit), limit)


@campaign_routes.get("/{campaign_id}")
@allow(Role.VIEWER)
async def get_campaign(campaign_id: Id, response: Response, application: ApplicationOf) -> CampaignView:
    return await _answer(application, await run_in_threadpool(application.store.campaign, campaign_id), response)


@campaign_routes.post("/{campaign_id}/start")
@allow(Role.OPERATOR)
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


@campaign_routes.post("/{campaign_id}/sign_of_life")
@allow(Role.OPERATOR)
async def show_life(campaign_id: Id, runner: RunnerOf) -> AttendedView | None:
    """A person monitors the machine; null if no sign of life is required. 409 if the campaign does not run.

    Needs no audit entry; the database is read only to check the key. Without signs of life the campaign is paused.
    """
    return _attended(runner.sign_of_life(campaign_id))


@campaign_routes.post("/{campaign_id}/pause")
@allow(Role.OPERATOR)
async def pause_campaign(
    campaign_id: Id, response: Response, application: ApplicationOf, version: IfMatch
) -> CampaignView:
    """Pause after the present sweep."""
    return await _answer(application, await application.runner.pause(campaign_id, version), response)


@campaign_routes.post("/{campaign_id}/resume")
@allow(Role.OPERATOR)
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


@campaign_routes.post("/{campaign_id}/abort")
@allow(Role.OPERATOR)
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
    done = progress(campaign.state, statuses, times, under_way, current=current)
    return CampaignView(
        **campaign.model_dump(),
        subject=subject,
        progress=done,
        motion=steps(under_way, check_move, done.pace),
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


SweepNumber = Annotated[int, Path(ge=1, le=LARGEST_ID, description="1, 2, ... in the order of the plan")]


@sweep_routes.get("")
@allow(Role.VIEWER)
def list_sweeps(campaign_id: Id, store: StoreOf) -> tuple[SweepDocument, ...]:
    """All sweeps, in the order of the plan."""
    store.campaign(campaign_id)  # NotFound: an unknown campaign must not look like one without sweeps
    return store.sweeps(campaign_id)


@sweep_routes.get("/{number}")
@allow(Role.VIEWER)
def get_sweep(campaign_id: Id, number: SweepNumber, store: StoreOf) -> SweepDocument:
    return store.sweep(campaign_id, number)


@sweep_routes.get("/{number}/recording")
@allow(Role.VIEWER)
def get_recording(campaign_id: Id, number: SweepNumber, store: StoreOf) -> RecordingDocument:
    """The latest recording of a sweep: its extent and its SHA-256."""
    return store.recording(campaign_id, number)


@sweep_routes.get(
    "/{number}/recording/file", response_class=FileResponse, responses=media("application/vnd.apache.parquet")
)
@allow(Role.VIEWER)
def get_recording_file(campaign_id: Id, number: SweepNumber, store: StoreOf, files: FilesOf) -> FileResponse:
    """The samples as Parquet, with the columns of the bundle format; only a part of them for a partial recording."""
    recording = store.recording(campaign_id, number)
    name = re.sub(r"\W+", "-", f"campaign-{campaign_id}-sweep-{number:04d}-attempt-{recording.attempt}") + ".parquet"
    return FileResponse(
        files.local(recording),
        media_type="application/vnd.apache.parquet",
        filename=name,
        headers={"X-Content-SHA256": recording.sha256, "X-Recording-State": recording.state.value},
    )


CHECK_MOVE = 2 * DURATION + 1.0  # s: motion in both directions, switching on and off
_LEFT = (SweepState.PLANNED, SweepState.RUNNING)
_RECORDED = (SweepState.RECORDED, SweepState.IDENTIFIED)


def expected_time(times: Sequence[PlannedTime]) -> float:
    """Duration of a campaign that has not begun, s: moves, sweeps, and one check move of each axis that moves."""
    moving = frozenset[str]().union(*(each.joints for each in times))
    return sum(each.duration for each in times) + CHECK_MOVE * len(moving)


def progress(
    state: CampaignState,
    sweeps: Sequence[SweepStatus],
    times: Sequence[PlannedTime],
    under_way: CurrentActivity | None = None,
    now: float | None = None,
    current: SweepDocument | None = None,
) -> Progress:
    """Progress with the remaining time: the planned time of the sweeps left, times the pace of the recorded sweeps.

    `times`: () for a campaign without plan. `now`: s, of the clock of `under_way`. `current`: the sweep that runs.
    """
    left = [sweep for sweep in sweeps if sweep.state in _LEFT]
    open_states = (CampaignState.PLANNED, CampaignState.RUNNING, CampaignState.PAUSING, CampaignState.PAUSED)
    predictable = state in open_states and len(times) == len(sweeps)
    remaining = _time_left(state, sweeps, times, under_way, now) if predictable and left else None
    return Progress(
        done=sum(sweep.state in _RECORDED for sweep in sweeps),
        total=len(sweeps),
        remaining=remaining if left else 0.0,
        repeat=_pace(sweeps, times) * _sum(sweeps, times, (SweepState.FAILED, SweepState.INTERRUPTED))
        if predictable
        else 0.0,
        pace=_pace(sweeps, times) if predictable else 1.0,
        current=current,
    )


def _time_left(
    state: CampaignState,
    sweeps: Sequence[SweepStatus],
    times: Sequence[PlannedTime],
    under_way: CurrentActivity | None,
    now: float | None,
) -> float:
    """Remaining time of a campaign with sweeps left, s."""
    pace, by_number = _pace(sweeps, times), dict(zip((sweep.number for sweep in sweeps), times, strict=True))
    left = [sweep.number for sweep in sweeps if sweep.state in _LEFT]
    moving = frozenset[str]().union(*(by_number[number].joints for number in left))
    checked: frozenset[str] = frozenset()
    if under_way is not None:
        checked = under_way.checked
    elif state in (CampaignState.RUNNING, CampaignState.PAUSING):
        checked = checked.union(*(by_number[each.number].joints for each in sweeps if each.attempt))
    seconds = pace * (sum(by_number[number].duration for number in left) + CHECK_MOVE * len(moving - checked))
    if under_way is not None:
        present = pace * sum(by_number[number].duration for number in under_way.numbers)
        seconds -= min((time.monotonic() if now is None else now) - under_way.begun, present)
    return seconds


def _sum(sweeps: Sequence[SweepStatus], times: Sequence[PlannedTime], states: Sequence[SweepState]) -> float:
    return sum(each.duration for sweep, each in zip(sweeps, times, strict=True) if sweep.state in states)


def _pace(sweeps: Sequence[SweepStatus], times: Sequence[PlannedTime]) -> float:
    """Ratio of measured to planned time from sweep to sweep; 1 below two sweeps. Pauses do not count."""
    ways: list[tuple[float, float]] = []
    recorded = sorted(
        ((sweep, each) for sweep, each in zip(sweeps, times, strict=True) if sweep.state in _RECORDED),
        key=lambda pair: pair[0].started_at,
    )
    for (before, planned_before), (after, planned) in pairwise(recorded):
        gap = planned.start - planned_before.start
        if after.number == before.number + 1 and gap > 0:
            ways.append((after.started_at - before.started_at, gap))
    if not ways:
        return 1.0
    usual = median(taken / gap for taken, gap in ways)
    counted = [(taken, gap) for taken, gap in ways if taken / gap <= 2 * usual]  # above: a pause
    return sum(taken for taken, _ in counted) / sum(gap for _, gap in counted)


def steps(under_way: CurrentActivity | None, check_move: CheckMove | None, pace: float) -> tuple[StepView, ...]:
    """The step that moves now, then the steps up to the end of the present sweep; () while they are not known."""
    found: list[StepView] = []
    if check_move is not None:
        found.append(StepView(kind="check_move", axes=(check_move.joint,), target=None, seconds=pace * 2 * DURATION))
    if under_way is not None:
        found += [
            StepView(kind="travel", axes=(each.joint,), target=each.target, seconds=pace * each.seconds)
            for each in under_way.travels
        ]
        found.append(StepView(kind="sweep", axes=under_way.joints, target=None, seconds=pace * under_way.seconds))
    return tuple(found)
