"""Campaigns, sweeps, estimates and the outbox; campaigns in and out as bundles."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy.exc import IntegrityError

from drivers.errors import Cause, CauseCode
from service import BadInput, Conflict, NotFound
from service.model import Recording, Robot, Sweep
from service.planning.campaigns.state_machine import CampaignEvent, SweepEvent, campaign_move, sweep_move
from service.store import tables as t
from service.store.database import Database
from service.store.diagnoses import DiagnosisStore, ModelStore
from service.store.documents import (
    BoltedMass,
    CampaignDocument,
    CampaignState,
    DiagnosisDocument,
    DiagnosisState,
    EventKind,
    NewDiagnosis,
    NewRecording,
    NewSweep,
    RecordingState,
    SpectrumRecord,
    SweepDocument,
    SweepState,
    SweepStatus,
)
from service.store.files.bundle import Bundle, save_bundle
from service.store.files.data_folder import campaign_bundle, import_campaign
from service.store.files.recordings import RecordingFiles
from service.store.store import StaleVersion, Store
from tests.stored.documents import stored
from tests.unit.service.store.conftest import Specs

pytestmark = pytest.mark.slow


RECORDING = NewRecording(state=RecordingState.COMPLETE, path="recordings/x.parquet", sha256="0" * 64, samples=10)


SPECTRUM = SpectrumRecord(path="recordings/x.spectrum.json", sha256="1" * 64)


@pytest.fixture
def sweeps(specs: Specs) -> list[NewSweep]:
    return [NewSweep(spec=spec, mode=None) for spec in specs]


@pytest.fixture
def campaign(store: Store, robot: Robot, sweeps: list[NewSweep]) -> CampaignDocument:
    plan = store.add_plan(store.add_robot(robot).id, {"any": "document"})
    return store.add_campaign(plan.id, sweeps)


Record = Callable[[int], SweepDocument]


@pytest.fixture
def record(store: Store, campaign: CampaignDocument) -> Record:
    def run(number: int) -> SweepDocument:
        store.begin_sweep(campaign.id, number, sweep_move(SweepEvent.BEGIN))
        return store.end_sweep(campaign.id, number, sweep_move(SweepEvent.RECORD), recording=RECORDING)

    return run


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


def test_two_campaigns_are_told_apart(store: Store, campaign: CampaignDocument, sweeps: list[NewSweep]) -> None:
    other = store.add_campaign(campaign.plan_id or 0, sweeps[:1])
    assert other.sweeps == {SweepState.PLANNED: 1}
    assert (store.campaigns(limit=1), store.campaigns(after=campaign.id)) == ((campaign,), (other,))
    store.begin_sweep(other.id, 1, sweep_move(SweepEvent.BEGIN))
    sweep = store.end_sweep(other.id, 1, sweep_move(SweepEvent.RECORD), recording=RECORDING)
    found = store.recording(other.id, 1)
    assert (found.campaign_id, found.number) == (other.id, 1)
    assert (store.recordings(other.id), store.recordings(campaign.id)) == ({1: found}, {})
    assert store.recorded_sweeps(other.id, {SweepState.RECORDED}) == [(sweep.spec, found)]
    assert store.recorded_sweeps(other.id, {SweepState.IDENTIFIED}) == []
    estimate = store.add_estimate([(sweep, SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), {})
    assert estimate is not None
    assert (estimate, estimate.number) == (store.estimate(other.id), 1)


def test_a_result_counts_once(database: Database, store: Store, campaign: CampaignDocument, record: Record) -> None:
    """The database itself refuses a second one."""
    sweep = record(1)
    identify = sweep_move(SweepEvent.IDENTIFY)
    first = store.add_estimate([(sweep, SPECTRUM)], identify, {"value": 0.1})
    events = store.last_event_id()
    assert first is not None
    assert store.add_estimate([(sweep, SPECTRUM)], identify, {"value": 0.1}) is None
    with pytest.raises(IntegrityError, match=r"(?i)unique"), database.write() as session:
        session.add(t.EstimateRow(campaign_id=sweep.campaign_id, revision=2, sweep_id=1, document={}))
    assert store.estimates(campaign.id) == (first,)
    assert store.estimate(campaign.id, 1) == first
    assert store.spectra(campaign.id) == (SPECTRUM,)
    assert store.last_event_id() == events


def test_only_the_newest_revision_has_the_values_of_single_sweeps(
    store: Store, campaign: CampaignDocument, record: Record
) -> None:
    whole, identify = stored("estimate"), sweep_move(SweepEvent.IDENTIFY)
    assert all(axis["inertia"] for axis in whole["axes"].values())
    for number in (1, 2, 3):
        store.add_estimate([(record(number), SPECTRUM)], identify, whole)
    *earlier, last = store.estimates(campaign.id)
    assert last.document == whole
    for axis in whole["axes"].values():
        axis["inertia"] = []
    assert [one.document for one in earlier] == [whole, whole]


def test_the_result_of_an_earlier_attempt_has_no_effect(
    store: Store, campaign: CampaignDocument, record: Record
) -> None:
    old = record(1)
    store.move_sweep(campaign.id, 1, sweep_move(SweepEvent.FAIL), Cause(CauseCode.NOT_IDENTIFIED))
    store.move_sweep(campaign.id, 1, sweep_move(SweepEvent.REPEAT))
    new = record(1)
    assert (old.attempt, new.attempt) == (1, 2)
    assert store.add_estimate([(old, SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), {}) is None
    assert store.add_estimate([(new, SPECTRUM)], sweep_move(SweepEvent.IDENTIFY), {}) is not None


def test_every_change_is_told_in_order(store: Store, campaign: CampaignDocument, record: Record) -> None:
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
    store: Store, campaign: CampaignDocument, record: Record
) -> None:
    record(1)
    sweeps = store.sweeps(campaign.id)
    assert len({sweep.state for sweep in sweeps}) == 2
    assert store.sweep_statuses(campaign.id) == tuple(
        SweepStatus(sweep.number, sweep.state, sweep.attempt, sweep.spec.started_at) for sweep in sweeps
    )
    assert store.sweep_statuses(campaign.id + 1) == ()


MASS = BoltedMass(mass=20.0, center=(0.1, 0.0, 0.0))


@pytest.fixture
def diagnoses(database: Database) -> DiagnosisStore:
    return DiagnosisStore(database)


@pytest.fixture
def models(database: Database) -> ModelStore:
    return ModelStore(database)


@pytest.fixture
def new(store: Store, robot: Robot, sweeps: list[NewSweep]) -> NewDiagnosis:
    """Of one measured campaign."""
    recordings = [RECORDING.model_copy(update={"path": f"{n}"}) for n in range(len(sweeps))]
    campaign = store.add_measured(store.add_robot(robot).id, sweeps, recordings)
    return NewDiagnosis(
        robot_id=campaign.robot_id, campaigns=(campaign.id,), axes=("joint_1", "joint_2"), unattended=True
    )


def done(diagnoses: DiagnosisStore, new: NewDiagnosis) -> DiagnosisDocument:
    """A diagnosis that came to its end."""
    diagnosis = diagnoses.add(new)
    for joint in new.axes:
        diagnoses.add_result(diagnosis.id, joint, "ambiguous", {"of": joint})
    diagnoses.finish(diagnosis.id, {"axes": {}})
    return diagnoses.diagnosis(diagnosis.id)


def complete(store: Store, campaign_id: int) -> None:
    for state in (CampaignState.RUNNING, CampaignState.MEASURED, CampaignState.COMPLETED):
        store.move_campaign(campaign_id, lambda _, state=state: state)


def test_a_result_that_comes_twice_counts_once(diagnoses: DiagnosisStore, store: Store, new: NewDiagnosis) -> None:
    diagnosis = diagnoses.add(new)
    assert (diagnosis.state, diagnosis.document, diagnosis.verdicts) == (DiagnosisState.WAITING, None, {})
    diagnoses.begin(diagnosis.id)
    diagnoses.begin(diagnosis.id)
    assert [entry.id for entry in diagnoses.open()] == [diagnosis.id]
    diagnoses.add_result(diagnosis.id, "joint_1", "named", {"first": True})
    diagnoses.add_result(diagnosis.id, "joint_1", "none", {"first": False})
    assert diagnoses.results(diagnosis.id) == {"joint_1": {"first": True}}
    diagnoses.finish(diagnosis.id, {"axes": {"joint_1": {}}})
    diagnoses.finish(diagnosis.id, {"axes": {}})
    diagnoses.fail(diagnosis.id, "too late")
    diagnoses.add_result(diagnosis.id, "joint_2", "none", {})
    found = diagnoses.diagnosis(diagnosis.id)
    assert (found.state, found.cause, found.document) == (DiagnosisState.DONE, "", {"axes": {"joint_1": {}}})
    assert found.verdicts == {"joint_1": "named"}
    assert found.finished_at is not None
    assert diagnoses.open() == ()
    told = [event.data["state"] for event in store.events(0) if event.kind is EventKind.DIAGNOSIS]
    assert told == ["waiting", "running", "running", "done"]
    assert [event.kind for event in store.events(0, new.campaigns[0])] == [EventKind.CAMPAIGN]


def test_an_experiment_is_one_and_leads_to_one_diagnosis(
    diagnoses: DiagnosisStore, store: Store, new: NewDiagnosis, sweeps: list[NewSweep]
) -> None:
    waiting = diagnoses.add(new)
    with pytest.raises(Conflict, match="is waiting; an experiment requires a diagnosis that is done"):
        diagnoses.approve(waiting.id, "joint_1", "Ada", None, {}, sweeps)
    parent = done(diagnoses, new)
    first = diagnoses.approve(parent.id, "joint_1", "Ada", MASS, {}, sweeps)
    with pytest.raises(Conflict, match=rf"already has an experiment, campaign {first.id} \(planned\)"):
        diagnoses.approve(parent.id, "joint_1", "Ada", None, {}, sweeps)
    store.move_campaign(first.id, lambda _: CampaignState.ABORTED)
    second = diagnoses.approve(parent.id, "joint_1", "Bob", MASS, {}, sweeps)
    experiment = diagnoses.diagnosis(parent.id).experiment
    assert experiment is not None
    assert (experiment.campaign_id, experiment.approved_by, experiment.test_mass) == (second.id, "Bob", MASS)

    assert diagnoses.to_go_on() == ()
    complete(store, second.id)
    (found,) = diagnoses.to_go_on(second.id)
    assert (found.id, diagnoses.to_go_on(first.id)) == (parent.id, ())
    child = new.model_copy(update={"parent": parent.id, "campaigns": (*new.campaigns, second.id)})
    going_on = diagnoses.go_on(child, kept=("joint_2",))
    assert going_on is not None
    assert diagnoses.results(going_on.id) == {"joint_2": {"of": "joint_2"}}
    assert diagnoses.go_on(child, kept=()) is None
    assert diagnoses.to_go_on() == ()


def test_after_a_restart_nothing_is_unattended(diagnoses: DiagnosisStore, new: NewDiagnosis) -> None:
    parent, failed = done(diagnoses, new), diagnoses.add(new)
    child = diagnoses.go_on(new.model_copy(update={"parent": parent.id}), ())
    assert child is not None
    diagnoses.fail(failed.id, "recording file was changed", {"axes": {}})
    diagnoses.attend("restarted")
    assert diagnoses.diagnosis(parent.id).unattended  # as it was: its loop went on
    failed, child = (diagnoses.diagnosis(one.id) for one in (failed, child))
    assert (child.unattended, child.cause, child.state) == (False, "restarted", DiagnosisState.WAITING)
    assert (failed.unattended, failed.cause, failed.document) == (False, "recording file was changed", {"axes": {}})


def test_models_are_numbered_robot_by_robot_and_a_diagnosis_becomes_one(
    diagnoses: DiagnosisStore, models: ModelStore, new: NewDiagnosis
) -> None:
    first = models.add(done(diagnoses, new).id, "Ada", {"n": 1}, None)
    later = done(diagnoses, new.model_copy(update={"model": first.id}))
    with pytest.raises(Conflict, match="another model of robot 1 was accepted in the meantime"):
        models.add(later.id, "Bob", {"n": 2}, None)
    assert models.newest(new.robot_id) == first
    second = models.add(later.id, "Bob", {"n": 2}, first.id)
    assert models.newest(new.robot_id) == second
    assert models.newest(new.robot_id + 1) is None
    assert [(model.revision, model.parent) for model in (first, second)] == [(1, None), (2, first.id)]
    with pytest.raises(Conflict, match=f"was already accepted as model {second.id}"):
        models.add(later.id, "Bob", {"n": 3}, second.id)
    assert models.models(new.robot_id) == (first, second)
    assert models.models(new.robot_id, after=first.id) == (second,)
    assert models.models(new.robot_id + 1) == ()
    assert models.model(first.id) == first


def test_a_diagnosis_or_model_that_is_not_there_is_not_found(
    diagnoses: DiagnosisStore, models: ModelStore, new: NewDiagnosis
) -> None:
    unknown = new.model_copy(update={"model": 99})
    for ask in (lambda: diagnoses.diagnosis(99), lambda: models.model(99), lambda: diagnoses.add(unknown)):
        with pytest.raises(NotFound, match="99 does not exist"):
            ask()


def recording(seed: int) -> Recording:
    noise = np.random.default_rng(seed).normal(size=(3, 50))
    return Recording(np.arange(50) / 1000.0, *noise)


@pytest.fixture
def files(tmp_path: Path) -> RecordingFiles:
    return RecordingFiles(tmp_path)


@pytest.fixture
def bundle(robot: Robot, specs: Specs) -> Bundle:
    return Bundle(robot, tuple(Sweep(spec, recording(n)) for n, spec in enumerate(specs)))


def test_an_import_that_fails_leaves_nothing(
    store: Store, files: RecordingFiles, bundle: Bundle, tmp_path: Path
) -> None:
    short = Sweep(bundle.sweeps[2].spec, Recording(*np.zeros((4, 1))))
    with pytest.raises(BadInput, match="1 samples"):
        import_campaign(store, files, save_bundle(files, Bundle(bundle.robot, (*bundle.sweeps[:2], short))))
    assert store.campaigns() == ()
    assert list((tmp_path / "recordings").iterdir()) == []


def test_a_changed_or_missing_file_is_refused(store: Store, files: RecordingFiles, bundle: Bundle) -> None:
    campaign = import_campaign(store, files, save_bundle(files, bundle))
    document = store.recording(campaign.id, 1)
    path = files.path(document)
    content = path.read_bytes()
    path.write_bytes(content[:100] + bytes([content[100] ^ 1]) + content[101:])
    with pytest.raises(BadInput, match="was changed"):
        files.load(document)
    path.unlink()
    with pytest.raises(BadInput, match="is missing"):
        campaign_bundle(store, files, campaign.id)


def test_a_campaign_without_samples_is_no_bundle(
    store: Store, files: RecordingFiles, campaign: CampaignDocument
) -> None:
    with pytest.raises(Conflict, match="no complete recording"):
        campaign_bundle(store, files, campaign.id)
