"""Campaigns, sweeps, estimates and the outbox."""

from collections.abc import Callable

import pytest
from pydantic import JsonValue
from sqlalchemy.exc import IntegrityError

from drivers.errors import Cause, CauseCode
from service.model.errors import Conflict, NotFound
from service.model.recording import SweepSpec
from service.model.robot import Robot
from service.planning.campaigns.state_machine import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.store import tables as t
from service.store.database import Database
from service.store.documents import (
    CampaignDocument,
    CampaignState,
    EventKind,
    NewRecording,
    NewSweep,
    RecordingState,
    SpectrumRecord,
    SweepDocument,
    SweepState,
    SweepStatus,
)
from service.store.store import StaleVersion, Store

pytestmark = pytest.mark.slow

RECORDING = NewRecording(state=RecordingState.COMPLETE, path="recordings/x.parquet", sha256="0" * 64, samples=10)
SPECTRUM = SpectrumRecord(path="recordings/x.spectrum.json", sha256="1" * 64)


@pytest.fixture
def campaign(store: Store, robot: Robot, specs: tuple[SweepSpec, ...]) -> CampaignDocument:
    plan = store.add_plan(store.add_robot(robot).id, {"any": "document"})
    return store.add_campaign(plan.id, [NewSweep(spec=spec, mode=None) for spec in specs])


@pytest.fixture
def record(store: Store, campaign: CampaignDocument) -> Callable[[int], SweepDocument]:
    def run(number: int) -> SweepDocument:
        store.begin_sweep(campaign.id, number, sweep_move(SweepEvent.BEGIN))
        return store.end_sweep(campaign.id, number, sweep_move(SweepEvent.RECORD), recording=RECORDING)

    return run


def test_the_same_robot_is_stored_once(store: Store, robot: Robot) -> None:
    assert store.add_robot(robot) == store.add_robot(robot)
    assert len(store.robots()) == 1


def test_a_new_campaign_is_planned(store: Store, campaign: CampaignDocument) -> None:
    assert (campaign.state, campaign.version, campaign.started_at) == (CampaignState.PLANNED, 1, None)
    assert campaign.sweeps == {SweepState.PLANNED: 3}
    assert [(s.number, s.spec.id, s.attempt) for s in store.sweeps(campaign.id)] == [
        (1, "0001", 0),
        (2, "0002", 0),
        (3, "0003", 0),
    ]


@pytest.mark.parametrize(
    "read",
    [
        lambda s: s.campaign(7),
        lambda s: s.sweeps(7),
        lambda s: s.plan(7),
        lambda s: s.robot(7),
        lambda s: s.estimate(7),
        lambda s: s.sweep(1, 9),
        lambda s: s.recording(1, 1),
        lambda s: s.estimate(1, 3),
    ],
)
def test_what_is_not_there_is_not_found(
    store: Store, campaign: CampaignDocument, read: Callable[[Store], object]
) -> None:
    with pytest.raises(NotFound):
        read(store)


def test_a_move_of_another_version_or_state_changes_nothing(store: Store, campaign: CampaignDocument) -> None:
    before = store.last_event_id()
    with pytest.raises(Conflict, match="pause is not possible in state planned"):
        store.move_campaign(campaign.id, campaign_move(CampaignEvent.PAUSE))
    assert (store.campaign(campaign.id), store.last_event_id()) == (campaign, before)
    started = store.move_campaign(campaign.id, campaign_move(CampaignEvent.START), if_version=1)
    assert (started.state, started.version) == (CampaignState.RUNNING, 2)
    with pytest.raises(StaleVersion, match="version 2, not 1"):
        store.move_campaign(campaign.id, campaign_move(CampaignEvent.PAUSE), if_version=1)
    assert store.campaign(campaign.id) == started


def test_sweeps_go_with_their_campaign_in_one_step(store: Store, campaign: CampaignDocument) -> None:
    skip = {SweepState.PLANNED: sweep_move(SweepEvent.SKIP)}
    aborted = store.move_campaign(
        campaign.id, campaign_move(CampaignEvent.ABORT), Cause(CauseCode.ABORTED, detail="no time"), None, skip
    )
    assert aborted.state is CampaignState.ABORTED
    assert aborted.sweeps == {SweepState.SKIPPED: 3}


def test_a_result_counts_once(store: Store, campaign: CampaignDocument, record: Callable[[int], SweepDocument]) -> None:
    sweep = record(1)
    identify = sweep_move(SweepEvent.IDENTIFY)
    first = store.add_estimate([(sweep, SPECTRUM)], identify, {"value": 0.1})
    events = store.last_event_id()
    assert first is not None
    assert store.add_estimate([(sweep, SPECTRUM)], identify, {"value": 0.1}) is None
    assert store.estimates(campaign.id) == (first,)
    assert store.spectra(campaign.id) == (SPECTRUM,)
    assert store.last_event_id() == events


def test_revisions_follow_one_another(
    store: Store, campaign: CampaignDocument, record: Callable[[int], SweepDocument]
) -> None:
    for number in (2, 1):
        store.add_estimate([(record(number), SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), {"n": number})
    assert [(e.revision, e.number) for e in store.estimates(campaign.id)] == [(1, 2), (2, 1)]
    assert store.estimate(campaign.id).document == {"n": 1}
    assert store.estimate(campaign.id, 1).document == {"n": 2}


def test_the_result_of_an_earlier_attempt_has_no_effect(
    store: Store, campaign: CampaignDocument, record: Callable[[int], SweepDocument]
) -> None:
    old = record(1)
    store.move_sweep(campaign.id, 1, sweep_move(SweepEvent.FAIL), Cause(CauseCode.NOT_IDENTIFIED))
    store.move_sweep(campaign.id, 1, sweep_move(SweepEvent.REPEAT))
    new = record(1)
    assert (old.attempt, new.attempt) == (1, 2)
    assert store.add_estimate([(old, SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), {}) is None
    assert store.add_estimate([(new, SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), {}) is not None


def test_the_database_itself_refuses_a_second_estimate_of_a_sweep(
    database: Database, store: Store, record: Callable[[int], SweepDocument]
) -> None:
    sweep = record(1)
    store.add_estimate([(sweep, SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), {})
    with pytest.raises(IntegrityError, match=r"(?i)unique"), database.write() as session:
        session.add(t.EstimateRow(campaign_id=sweep.campaign_id, revision=2, sweep_id=1, document={}))


def test_floats_come_back_exactly(store: Store, record: Callable[[int], SweepDocument]) -> None:
    document: dict[str, JsonValue] = {"x": [0.1 + 0.2, 1e-300, 2.0**-1074, -1.7976931348623157e308]}
    sweep = record(1)
    store.add_estimate([(sweep, SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), document)
    assert store.estimate(sweep.campaign_id).document == document


def test_every_change_is_told_in_order(
    store: Store, campaign: CampaignDocument, record: Callable[[int], SweepDocument]
) -> None:
    store.move_campaign(campaign.id, campaign_move(CampaignEvent.START))
    store.add_estimate([(record(1), SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), {})
    events = store.events(0, campaign.id)
    assert [event.id for event in events] == sorted(event.id for event in events)
    told = [(event.kind, event.data.get("state") or event.data.get("revision")) for event in events]
    assert told == [
        (EventKind.CAMPAIGN, "planned"),
        (EventKind.CAMPAIGN, "running"),
        (EventKind.SWEEP, "running"),
        (EventKind.SWEEP, "recorded"),
        (EventKind.ESTIMATE, 1),
        (EventKind.SWEEP, "identified"),
    ]
    assert store.events(events[2].id, limit=2) == events[3:5]


def test_statuses_tell_of_each_sweep_what_its_document_tells(
    store: Store, campaign: CampaignDocument, record: Callable[[int], SweepDocument]
) -> None:
    record(1)
    sweeps = store.sweeps(campaign.id)
    assert len({sweep.state for sweep in sweeps}) == 2
    assert store.sweep_statuses(campaign.id) == tuple(
        SweepStatus(sweep.number, sweep.state, sweep.attempt, sweep.spec.started_at) for sweep in sweeps
    )
    assert store.sweep_statuses(campaign.id + 1) == ()
