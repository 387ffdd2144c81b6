"""Collects the published data from the objects of the machine and from the events of the store."""

import asyncio
from collections.abc import Sequence
from datetime import UTC, datetime

import structlog
from pydantic import JsonValue
from sqlalchemy.exc import SQLAlchemyError

from service import BadInput, NotFound
from service.machine.execution.machine import Machine
from service.machine.execution.runner import Runner
from service.planning.campaigns.live import EventFeed
from service.planning.campaigns.stored_results import quality_of
from service.publishing.publisher import Publisher
from service.publishing.state import (
    CampaignProgress,
    Held,
    LatestEstimate,
    LinkParameters,
    MachineState,
    Notice,
    PublishedState,
)
from service.store.database import refusal
from service.store.documents import CampaignDocument, CampaignState, EventDocument, EventKind, StopDocument, SweepState
from service.store.store import Store

_log = structlog.get_logger(__name__)


class Following:
    """One machine; the drives are asked at each look (`Machine.ask`)."""

    def __init__(self, store: Store, machine: Machine, runner: Runner, name: str, publisher: Publisher) -> None:
        self._store, self._machine, self._runner = store, machine, runner
        self._name, self._publisher = name, publisher
        self._campaign: CampaignDocument | None = None
        self._estimate: LatestEstimate | None = None
        self._stops: tuple[StopDocument, ...] = ()
        self._published: PublishedState | None = None

    async def look(self) -> None:
        """Publish changes, until cancelled."""
        while True:
            await self._machine.ask()
            self._tell()
            await asyncio.sleep(0.5)

    async def follow(self, feed: EventFeed, after: int) -> None:
        """Publish events after `after`, and the changes by them, until the feed is closed."""
        await asyncio.to_thread(self._recover)
        self._tell()
        async for event in feed.follow(after):
            if event.campaign_id is None:  # `look` publishes stops: other machines may share the database
                continue
            try:
                ours = await asyncio.to_thread(self._take, event, event.campaign_id)
            except (SQLAlchemyError, BadInput, NotFound) as error:
                reason = refusal(error) if isinstance(error, SQLAlchemyError) else str(error)
                _log.warning("not_published", event_number=event.id, reason=reason)
                continue
            if ours:
                self._publisher.notice(
                    Notice(
                        number=event.id, kind=event.kind.value, campaign=event.campaign_id, at=event.at, data=event.data
                    )
                )
                self._tell()

    def _recover(self) -> None:
        """Read the state before the start of the service. Blocks."""
        open_ = (CampaignState.RUNNING, CampaignState.PAUSING, CampaignState.PAUSED)
        try:
            ours = [campaign for campaign in self._store.campaigns_in(*open_) if campaign.here]
            self._campaign = ours[-1] if ours else None
            latest = sorted(self._store.latest_estimates().values(), key=lambda one: one.campaign_id)
            for newest in reversed(latest):
                if self._store.campaign(newest.campaign_id).here:
                    self._estimate = self._latest(newest.campaign_id)
                    break
        except (SQLAlchemyError, BadInput) as error:
            _log.warning("not_published", reason=str(error))

    def _take(self, event: EventDocument, campaign_id: int) -> bool:
        """Whether the event is of this machine. Blocks."""
        campaign = self._store.campaign(campaign_id)
        if not campaign.here:
            return False
        self._campaign = campaign
        if event.kind is EventKind.ESTIMATE:
            self._estimate = self._latest(campaign_id)
        return True

    def _latest(self, campaign_id: int) -> LatestEstimate:
        """BadInput if the document is no estimate of this version. Blocks."""
        document = self._store.estimate(campaign_id)
        quality = quality_of(document)
        robot = self._store.robot(self._store.campaign(campaign_id).robot_id)
        links = document.content.standard_parameters.links
        return LatestEstimate(
            robot=robot.name,
            campaign=campaign_id,
            revision=document.revision,
            made=document.created_at,
            condition=quality.condition,
            axes=quality.axes,
            links={link: LinkParameters(parameters=parameters) for link, parameters in links.items()},
        )

    def _tell(self) -> None:
        stops = self._machine.stops
        if {stop.at for stop in stops} != {stop.at for stop in self._stops}:  # its id changes as the database stores it
            self._publisher.notice(_of_stops(stops))
        self._stops = stops
        state = PublishedState(machine=self._machine_state(stops), campaign=self._progress(), estimate=self._estimate)
        if state != self._published:
            self._published = state
            self._publisher.state(state)

    def _machine_state(self, stops: Sequence[StopDocument]) -> MachineState:
        machine = self._machine
        return MachineState(
            name=self._name,
            connected=machine.answers,
            may_move=machine.answers and not machine.forbidden,
            state=machine.statement.state.value,
            stopped=bool(stops),
            stops=tuple(Held(id=stop.id, by=stop.by, why=stop.why, at=stop.at) for stop in stops),
            reason=machine.silence or machine.forbidden,
        )

    def _progress(self) -> CampaignProgress | None:
        campaign = self._campaign
        if campaign is None:
            return None
        now = self._runner.under_way if self._runner.running == campaign.id else None
        return CampaignProgress(
            id=campaign.id,
            state=campaign.state,
            cause=campaign.cause,
            done=sum(campaign.sweeps.get(state, 0) for state in (SweepState.RECORDED, SweepState.IDENTIFIED)),
            total=sum(campaign.sweeps.values()),
            sweeps=() if now is None else now.numbers,
            axes=() if now is None else now.joints,
        )


def _of_stops(stops: Sequence[StopDocument]) -> Notice:
    held: list[JsonValue] = [{"id": stop.id, "by": stop.by, "why": stop.why} for stop in stops]
    data: JsonValue = {"latched": bool(stops), "stops": held}
    return Notice(number=None, kind=EventKind.STOP.value, campaign=None, at=datetime.now(UTC), data=data)
