"""The retention rule: what it removes, what it never removes, and what an interruption leaves."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service import BadInput, Conflict, NotFound
from service.model import Recording, Robot
from service.store import tables as t
from service.store.database import Database, open_database
from service.store.diagnoses import DiagnosisStore, ModelStore
from service.store.documents import (
    CampaignState,
    EstimateOf,
    NewDiagnosis,
    NewRecording,
    NewSweep,
    RecordingState,
    SweepState,
)
from service.store.files.data_folder import claim_folder
from service.store.files.recordings import RecordingFiles
from service.store.objects import ObjectStore
from service.store.people.audit import AuditStore, Entry
from service.store.plant import BatchStore
from service.store.retention import Pruned, RetentionRules, RetentionStore, prune
from service.store.store import Store
from tests.command import sweepid
from tests.unit.service.store.conftest import Specs

pytestmark = pytest.mark.slow

ALL = RetentionRules(samples=30, spectra=30, estimates=30)
ENTRY: Entry = {"actor": "ada (shell)", "address": "shell"}
LATER = timedelta(days=31)


@dataclass
class Plant:
    database: Database
    store: Store
    files: RecordingFiles
    data: Path
    robot: int

    @property
    def retention(self) -> RetentionStore:
        assert self.database.machine is not None
        return RetentionStore(self.database, self.database.machine.id)

    def campaign(self, specs: Specs, state: CampaignState = CampaignState.COMPLETED) -> int:
        """Three sweeps with recordings, spectra and an estimate each."""
        folder = self.files.folder(f"import-{len(self.store.campaigns())}")
        new: list[NewRecording] = []
        for number in range(1, len(specs) + 1):
            time = np.arange(10.0)
            recording = Recording(time, time * number + 100 * len(self.store.campaigns()), time, time)
            path = folder / f"{number:04d}-1.parquet"
            new.append(self.files.save(path, recording, RecordingState.COMPLETE, {}))
        campaign = self.store.add_measured(self.robot, [NewSweep(spec=spec, mode=None) for spec in specs], new)
        for sweep, recording_ in zip(self.store.sweeps(campaign.id), new, strict=True):
            document: Any = {"a": sweep.number}
            spectrum = self.files.save_spectrum(recording_.path, document)
            self.store.add_estimate([(sweep, spectrum)], lambda _: SweepState.IDENTIFIED, {"axes": {}})
        self.store.move_campaign(campaign.id, lambda _: state)
        return campaign.id

    def prune(self, rules: RetentionRules = ALL, dry: bool = False, objects: ObjectStore | None = None) -> Pruned:
        return prune(self.retention, self.data, objects, rules, datetime.now(UTC) + LATER, None if dry else ENTRY)

    def on_disk(self, kind: str = "*-1.parquet") -> int:
        return len(list((self.data / "recordings").rglob(kind)))


@pytest.fixture
def plant(sqlite_url: str, tmp_path: Path, robot: Robot) -> Iterator[Plant]:
    data = tmp_path
    with open_database(sqlite_url) as database:
        assert claim_folder(data, database) == ""
        store = Store(database)
        yield Plant(database, store, RecordingFiles(data), data, store.add_robot(robot).id)


def test_what_is_old_goes_and_the_newest_estimate_stays(plant: Plant, specs: Specs) -> None:
    number = plant.campaign(specs)
    dry = plant.prune(dry=True)
    assert (plant.on_disk(), len(plant.store.estimates(number))) == (3, 3)
    found = plant.prune()
    assert dry == found
    assert (found.campaigns, found.recordings, found.spectra, found.estimates) == (1, 3, 3, 2)
    assert found.bytes > 0
    assert plant.on_disk() == 0
    assert plant.on_disk("*.spectrum-*.json") == 0
    assert plant.on_disk("*-1.json") == 3  # manifests tell what was measured
    assert [one.revision for one in plant.store.estimates(number)] == [3]
    assert plant.store.spectra(number) == ()
    recording = plant.store.recording(number, 1)
    assert recording.pruned_at is not None
    for read in (plant.files.local, plant.files.named, plant.files.load):
        with pytest.raises(BadInput, match=r"samples were removed on .* by the rule `keep_samples_days`"):
            read(recording)
    assert plant.prune().campaigns == 0  # and again nothing
    told = [json.loads(entry) for _, entry, _ in AuditStore(plant.database).links()]
    (entry,) = (one for one in told if one["event"] == "pruned")
    assert {key: entry[key] for key in ("actor", "machine", "campaign", "recordings", "spectra", "estimates")} == {
        "actor": "ada (shell)",
        "machine": "machine",
        "campaign": number,
        "recordings": 3,
        "spectra": 3,
        "estimates": 2,
    }


@pytest.mark.parametrize(
    ("rules", "left"),
    [
        (RetentionRules(30, None, None), (0, 3, 3)),
        (RetentionRules(None, 30, None), (3, 0, 3)),
        (RetentionRules(None, None, 30), (3, 3, 1)),
        (RetentionRules(32, 32, 32), (3, 3, 3)),  # nothing is so old
    ],
)
def test_each_rule_is_for_itself(plant: Plant, specs: Specs, rules: RetentionRules, left: tuple[int, int, int]) -> None:
    number = plant.campaign(specs)
    assert plant.prune(rules).campaigns == (left != (3, 3, 3))
    assert (plant.on_disk(), plant.on_disk("*.spectrum-*.json"), len(plant.store.estimates(number))) == left


def test_what_an_accepted_model_rests_on_never_goes(plant: Plant, specs: Specs) -> None:
    """Also the evidence of the diagnosis that it continues, and the campaign of the estimate that it started from."""
    first, second, start, other = (plant.campaign(specs) for _ in range(4))
    diagnoses = DiagnosisStore(plant.database)
    new = NewDiagnosis(
        robot_id=plant.robot, campaigns=(first,), axes=("joint_1",), estimate=EstimateOf(campaign_id=start, revision=2)
    )
    parent = diagnoses.add(new)
    diagnoses.finish(parent.id, {})
    child = diagnoses.go_on(new.model_copy(update={"campaigns": (second,), "parent": parent.id}), [])
    assert child is not None
    diagnoses.finish(child.id, {})
    ModelStore(plant.database).add(child.id, "Ada", {}, None)
    found = plant.prune()
    assert set(found.stay) == {first, second, start}
    assert set(found.stay.values()) == {"model 1 was made from it"}
    assert (found.campaigns, plant.on_disk()) == (1, 9)
    assert len(plant.store.estimates(other)) == 1


def test_a_revision_that_a_diagnosis_started_from_stays(plant: Plant, specs: Specs) -> None:
    number, evidence = plant.campaign(specs), plant.campaign(specs)
    diagnoses = DiagnosisStore(plant.database)
    of = EstimateOf(campaign_id=number, revision=2)
    new = NewDiagnosis(robot_id=plant.robot, campaigns=(evidence,), axes=("joint_1",), estimate=of)
    diagnoses.finish(diagnoses.add(new).id, {})
    plant.prune()
    assert [one.revision for one in plant.store.estimates(number)] == [2, 3]


def test_a_held_campaign_stays_until_it_is_released(plant: Plant, specs: Specs) -> None:
    number = plant.campaign(specs)
    plant.retention.hold(number, "ada", "report signed 2026-11-25", ENTRY)
    with pytest.raises(Conflict, match="is already held by ada: report signed"):
        plant.retention.hold(number, "bob", "again", ENTRY)
    assert plant.prune().stay == {number: "held by ada: report signed 2026-11-25"}
    assert plant.on_disk() == 3
    plant.retention.release(number, ENTRY)
    with pytest.raises(NotFound, match="is not held"):
        plant.retention.release(number, ENTRY)
    assert plant.prune().campaigns == 1
    events = [json.loads(entry)["event"] for _, entry, _ in AuditStore(plant.database).links()]
    assert events == ["hold added", "hold released", "pruned"]


def test_what_is_open_or_named_by_it_stays(plant: Plant, specs: Specs) -> None:
    paused = plant.campaign(specs, CampaignState.PAUSED)
    diagnosed, batched = plant.campaign(specs), plant.campaign(specs)
    new = NewDiagnosis(robot_id=plant.robot, campaigns=(diagnosed,), axes=("joint_1",))
    DiagnosisStore(plant.database).add(new)
    BatchStore(plant.database).add([batched], "Ada")
    analysis = plant.campaign(specs)
    plan = plant.store.add_plan(plant.robot, {"request": {"analysis": analysis}})
    planned = plant.store.add_campaign(plan.id, []).id
    found = plant.prune()
    assert found.stay == {
        paused: "it has not ended",
        diagnosed: "diagnosis 1 has not ended",
        batched: "job 1 has not ended",
        analysis: f"the plan of campaign {planned} refers to it",
    }
    assert found.campaigns == 0


def test_an_interrupted_run_is_finished_by_the_next(
    plant: Plant, specs: Specs, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant.campaign(specs)

    def killed(self: Path, missing_ok: bool = False) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", killed)
        with pytest.raises(KeyboardInterrupt):
            plant.prune()
    assert plant.on_disk() == 3
    plant.prune()
    assert plant.on_disk() == 0


def test_objects_go_with_their_last_recording(plant: Plant, specs: Specs, tmp_path: Path) -> None:
    from service.process.settings import store_address

    shared = tmp_path / "shared"
    shared.mkdir()
    objects = ObjectStore(store_address(f"file://{shared}", None, None, 60.0))
    number = plant.campaign(specs)
    for sweep in specs:
        recording = plant.store.recording(number, int(sweep.id))
        objects.put(plant.files.path(recording), recording.sha256)
    with plant.database.write() as session:
        for row in session.query(t.RecordingRow):
            row.moved_at = t.now()
    assert len([path for path in shared.rglob("*") if path.is_file()]) == 3
    plant.prune(objects=objects)
    assert [path for path in shared.rglob("*") if path.is_file()] == []
    assert not any(sample.moved for sample in plant.retention.removed())


def test_the_command(plant: Plant, specs: Specs, monkeypatch: pytest.MonkeyPatch) -> None:
    held, number = plant.campaign(specs), plant.campaign(specs)
    with plant.database.write() as session:
        for row in session.query(t.RecordingRow):
            row.created_at = t.now() - LATER
    folder = ("--data-dir", str(plant.data))
    refused = sweepid("data", "prune", *folder)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert "keep_samples_days" in refused.stderr
    monkeypatch.setenv("SWEEPID_KEEP_SAMPLES_DAYS", "30")
    placed = sweepid("data", "hold", str(held), "--why", "report signed by Ada", *folder)
    assert placed.stdout.endswith(": report signed by Ada\n")
    assert json.loads(sweepid("data", "holds", *folder).stdout)["campaign_id"] == held
    dry = sweepid("data", "prune", "--dry-run", *folder)
    assert dry.stdout.splitlines()[0] == f"campaign {number}: 3 recordings, 0 spectra, 0 estimates"
    assert dry.stdout.splitlines()[1].startswith(
        "would be removed: 3 recordings, 0 spectra, 0 estimates of 1 campaigns"
    )
    assert f"campaign {held} is kept: held by " in dry.stderr
    assert plant.on_disk() == 6
    assert sweepid("data", "prune", *folder).stdout.splitlines()[1].startswith("removed: 3 recordings")
    assert plant.on_disk() == 3
    assert sweepid("data", "doctor", *folder).stdout == ""  # what was removed by rule is not missing
    assert sweepid("data", "release", str(held), *folder).returncode == 0
