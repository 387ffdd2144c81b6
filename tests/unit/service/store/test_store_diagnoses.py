"""Diagnoses and models in a real database: every result counts once, nothing is ever changed afterwards."""

import pytest

from service.model.errors import Conflict, NotFound
from service.model.recording import SweepSpec
from service.model.robot import Robot
from service.store.database import Database
from service.store.diagnoses import DiagnosisStore, ModelStore
from service.store.documents import (
    BoltedMass,
    CampaignState,
    DiagnosisDocument,
    DiagnosisState,
    EventKind,
    NewDiagnosis,
    NewRecording,
    NewSweep,
    RecordingState,
)
from service.store.store import Store

pytestmark = pytest.mark.slow

MASS = BoltedMass(mass=20.0, center=(0.1, 0.0, 0.0))


@pytest.fixture
def diagnoses(database: Database) -> DiagnosisStore:
    return DiagnosisStore(database)


@pytest.fixture
def models(database: Database) -> ModelStore:
    return ModelStore(database)


@pytest.fixture
def sweeps(specs: tuple[SweepSpec, ...]) -> list[NewSweep]:
    return [NewSweep(spec=spec, mode=None) for spec in specs]


@pytest.fixture
def new(store: Store, robot: Robot, sweeps: list[NewSweep]) -> NewDiagnosis:
    """Of one measured campaign."""
    recordings = [
        NewRecording(state=RecordingState.COMPLETE, path=f"{n}", sha256="0" * 64, samples=9) for n in range(3)
    ]
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
    parent = done(diagnoses, new)
    child = diagnoses.go_on(new.model_copy(update={"parent": parent.id}), ())
    assert child is not None
    diagnoses.attend("restarted")
    assert diagnoses.diagnosis(parent.id).unattended  # as it was: its loop went on
    found = diagnoses.diagnosis(child.id)
    assert (found.unattended, found.cause, found.state) == (False, "restarted", DiagnosisState.WAITING)


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


def test_what_failed_stays_failed_for_its_own_reason(diagnoses: DiagnosisStore, new: NewDiagnosis) -> None:
    unattended = new.model_copy(update={"unattended": True})
    failed, waiting = diagnoses.add(unattended), diagnoses.add(unattended)
    diagnoses.fail(failed.id, "recording file was changed", {"axes": {}})
    diagnoses.attend("the service was restarted")
    found = [diagnoses.diagnosis(one.id) for one in (failed, waiting)]
    assert [one.cause for one in found] == ["recording file was changed", "the service was restarted"]
    assert not any(one.unattended for one in found)
    assert found[0].document == {"axes": {}}


def test_what_is_not_there_is_not_found(diagnoses: DiagnosisStore, models: ModelStore, new: NewDiagnosis) -> None:
    for ask in (diagnoses.diagnosis, models.model):
        with pytest.raises(NotFound, match="99 does not exist"):
            ask(99)
    with pytest.raises(NotFound, match="model 99 does not exist"):
        diagnoses.add(new.model_copy(update={"model": 99}))
