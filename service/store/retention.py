"""Where recordings are and how long: moved to the object store, removed here, removed for ever.

Retention rule: protected campaigns are kept completely: unfinished ones, held ones, the evidence of accepted models and
of open diagnoses, of open batches, and campaigns named by their plans. The newest estimate of every campaign is kept,
and each revision from which a diagnosis started. Rows go first, then files, so that an interrupted run is completed by
the next one.
"""

import time
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, TypeVar

from pydantic import JsonValue
from sqlalchemy import ColumnElement, Select, delete, func, select
from sqlalchemy.orm import Session

from service import Conflict, NotFound
from service.store import table_rows as rows, tables as t
from service.store.database import Database
from service.store.documents import BatchState, CampaignState, DiagnosisState, RecordingDocument, StoredDocument
from service.store.objects import ObjectStore
from service.store.people.audit import Entry, append


@dataclass(frozen=True, slots=True)
class RetentionRules:
    """Days after the last recording of a campaign; None: keep forever."""

    samples: float | None
    spectra: float | None
    estimates: float | None


@dataclass(frozen=True, slots=True)
class StoredSamples:
    """A recording. `moved`: it is in the object store. `alone`: no other recording has the same content."""

    id: int
    path: str
    sha256: str
    moved: bool
    alone: bool


@dataclass(frozen=True, slots=True)
class Doomed:
    """Data of a campaign that may be removed. `spectra`: ids and paths of their rows."""

    campaign_id: int
    samples: tuple[StoredSamples, ...]
    spectra: tuple[tuple[int, str], ...]
    estimates: tuple[int, ...]

    def __bool__(self) -> bool:
        return bool(self.samples or self.spectra or self.estimates)


class HoldDocument(StoredDocument):
    """A campaign from which nothing is removed."""

    campaign_id: int
    by: str
    why: str
    at: datetime


class RetentionStore(rows.Transactions):
    """For one machine, by its id. Every method is one transaction and blocks; NotFound if the id does not exist."""

    def __init__(self, database: Database, machine_id: int) -> None:
        super().__init__(database)
        self._machine = machine_id

    def doomed(self, rules: RetentionRules, at: datetime) -> tuple[tuple[Doomed, ...], dict[int, str]]:
        """What may be removed at this time, and why other campaigns of that age are kept."""
        with self._database.read() as session:
            reasons = _protected(session)
            found: list[Doomed] = []
            stay: dict[int, str] = {}
            for campaign_id, last in _last_recorded(session, self._machine):
                one = _doomed(session, campaign_id, at - last, rules)
                if not one:
                    continue
                if campaign_id in reasons:
                    stay[campaign_id] = reasons[campaign_id]
                else:
                    found.append(one)
            return tuple(found), stay

    def remove(self, one: Doomed, at: datetime, entry: Entry) -> None:
        """Mark as removed, with an audit entry; the files still exist.

        Raises Conflict if the campaign was protected meanwhile.
        """
        with self._database.write(quiet=True) as session:
            reason = _protected(session).get(one.campaign_id)
            if reason is not None:
                raise Conflict(f"campaign {one.campaign_id} is kept: {reason}")
            for sample in one.samples:
                session.get_one(t.RecordingRow, sample.id).pruned_at = at
            session.execute(delete(t.SpectrumRow).where(t.SpectrumRow.id.in_([number for number, _ in one.spectra])))
            session.execute(delete(t.EstimateRow).where(t.EstimateRow.id.in_(one.estimates)))
            counts = {"recordings": len(one.samples), "spectra": len(one.spectra), "estimates": len(one.estimates)}
            machine = rows.get(session, t.MachineRow, self._machine, "machine").name
            append(session, [{**entry, "event": "pruned", "machine": machine, "campaign": one.campaign_id, **counts}])

    def removed(self) -> tuple[StoredSamples, ...]:
        """Recordings marked as removed: files may still exist after an interrupted removal."""
        with self._database.read() as session:
            return tuple(_samples(session, t.CampaignRow.machine_id == self._machine, pruned=True))

    def object_is_gone(self, sample: StoredSamples) -> None:
        """The object is no longer in the object store."""
        with self._database.write(quiet=True) as session:
            session.get_one(t.RecordingRow, sample.id).moved_at = None

    def hold(self, campaign_id: int, by: str, why: str, entry: Entry) -> HoldDocument:
        """Remove nothing of this campaign from now on. Raises Conflict if it is already held."""
        with self._database.write(quiet=True) as session:
            rows.get(session, t.CampaignRow, campaign_id, "campaign")
            row = session.get(t.HoldRow, campaign_id)
            if row is not None:
                raise Conflict(f"campaign {campaign_id} is already held by {row.by}: {row.why}")
            row = rows.added(session, t.HoldRow(campaign_id=campaign_id, by=by, why=why, at=t.now()))
            append(session, [{**entry, "event": "hold added", "campaign": campaign_id, "why": why}])
            return rows.document(HoldDocument, row)

    def release(self, campaign_id: int, entry: Entry) -> HoldDocument:
        with self._database.write(quiet=True) as session:
            row = session.get(t.HoldRow, campaign_id)
            if row is None:
                raise NotFound(f"campaign {campaign_id} is not held")
            found = rows.document(HoldDocument, row)
            session.delete(row)
            append(session, [{**entry, "event": "hold released", "campaign": campaign_id}])
            return found

    def holds(self) -> tuple[HoldDocument, ...]:
        return self._all(HoldDocument, select(t.HoldRow).order_by(t.HoldRow.campaign_id))


def _last_recorded(session: Session, machine_id: int) -> Iterator[tuple[int, datetime]]:
    """Campaigns of the machine with the time of their last recording, or of their start."""
    last = (
        select(t.SweepRow.campaign_id, func.max(t.RecordingRow.created_at).label("at"))
        .join(t.RecordingRow, t.RecordingRow.sweep_id == t.SweepRow.id)
        .group_by(t.SweepRow.campaign_id)
        .subquery()
    )
    query = select(t.CampaignRow.id, t.CampaignRow.created_at, last.c.at)
    query = query.outerjoin(last, last.c.campaign_id == t.CampaignRow.id).order_by(t.CampaignRow.id)
    for number, created, recorded in session.execute(query.where(t.CampaignRow.machine_id == machine_id)):
        yield number, recorded or created


def _doomed(session: Session, campaign_id: int, age: timedelta, rules: RetentionRules) -> Doomed:
    def old(days: float | None) -> bool:
        return days is not None and age >= timedelta(days=days)

    samples = _samples(session, t.CampaignRow.id == campaign_id, pruned=False) if old(rules.samples) else ()
    spectra = select(t.SpectrumRow.id, t.SpectrumRow.path).join(t.SweepRow, t.SweepRow.id == t.SpectrumRow.sweep_id)
    spectra = spectra.where(t.SweepRow.campaign_id == campaign_id).order_by(t.SpectrumRow.id)
    return Doomed(
        campaign_id,
        tuple(samples),
        tuple((number, path) for number, path in session.execute(spectra)) if old(rules.spectra) else (),
        _earlier_estimates(session, campaign_id) if old(rules.estimates) else (),
    )


def _samples(session: Session, of: ColumnElement[bool], pruned: bool) -> Iterator[StoredSamples]:
    recording = t.RecordingRow
    query = select(recording).join(t.SweepRow, t.SweepRow.id == recording.sweep_id)
    query = query.join(t.CampaignRow, t.CampaignRow.id == t.SweepRow.campaign_id).where(of)
    found = session.scalars(query.where(recording.pruned_at.is_not(None) if pruned else recording.pruned_at.is_(None)))
    for row in found.all():
        others = select(func.count()).where(recording.sha256 == row.sha256, recording.id != row.id)
        alone = session.scalar(others.where(recording.pruned_at.is_(None))) == 0
        yield StoredSamples(row.id, row.path, row.sha256, row.moved_at is not None, alone)


def _earlier_estimates(session: Session, campaign_id: int) -> tuple[int, ...]:
    """Ids of all revisions but the newest, and those that a diagnosis started from."""
    started = {
        str(one.get("revision"))
        for one in session.scalars(select(t.DiagnosisRow.estimate).where(t.DiagnosisRow.estimate.is_not(None)))
        if one is not None and one.get("campaign_id") == campaign_id
    }
    query = select(t.EstimateRow.id, t.EstimateRow.revision).where(t.EstimateRow.campaign_id == campaign_id)
    revisions = session.execute(query.order_by(t.EstimateRow.revision)).all()
    return tuple(number for number, revision in revisions[:-1] if str(revision) not in started)


def _protected(session: Session) -> dict[int, str]:
    """Campaigns from which nothing may be removed, and why."""
    found: dict[int, str] = {}
    over = t.CampaignRow.state.in_((CampaignState.COMPLETED, CampaignState.ABORTED))
    for number in session.scalars(select(t.CampaignRow.id).where(~over)):
        found[number] = "it has not ended"
    for hold in session.scalars(select(t.HoldRow)):
        found.setdefault(hold.campaign_id, f"held by {hold.by}: {hold.why}")
    for model, diagnosis in session.execute(select(t.ModelRow.id, t.ModelRow.diagnosis_id)):
        for number in _evidence(session, diagnosis):
            found.setdefault(number, f"model {model} was made from it")
    open_ones = select(t.DiagnosisRow.id).where(
        t.DiagnosisRow.state.in_((DiagnosisState.WAITING, DiagnosisState.RUNNING))
    )
    for diagnosis in session.scalars(open_ones):
        for number in _evidence(session, diagnosis):
            found.setdefault(number, f"diagnosis {diagnosis} has not ended")
    for batch in session.scalars(
        select(t.BatchRow).where(t.BatchRow.state.in_((BatchState.WAITING, BatchState.RUNNING)))
    ):
        for number in batch.campaigns:
            found.setdefault(number, f"job {batch.id} has not ended")
    for number, by in _named_by_plans(session, found).items():
        found.setdefault(number, f"the plan of campaign {by} refers to it")
    return found


def _evidence(session: Session, diagnosis_id: int | None) -> Iterator[int]:
    """Campaigns of a diagnosis and of those that it continues, with experiments, weighings and the start estimate."""
    while diagnosis_id is not None:
        row = session.get_one(t.DiagnosisRow, diagnosis_id)
        yield from row.campaigns
        if row.experiment_campaign_id is not None:
            yield row.experiment_campaign_id
        for named in (row.weighed, row.estimate):
            number = None if named is None else named.get("campaign_id")
            if isinstance(number, int):
                yield number
        diagnosis_id = row.parent


def _named_by_plans(session: Session, campaigns: Collection[int]) -> dict[int, int]:
    """Campaigns named in plans of these, as initial analysis or for their sweeps; each with the naming campaign."""
    query = select(t.CampaignRow.id, t.PlanRow.document["request"]).join(
        t.PlanRow, t.PlanRow.id == t.CampaignRow.plan_id
    )
    named: dict[int, list[int]] = defaultdict(list)
    for number, request in session.execute(query):
        fields: dict[str, JsonValue] = request or {}
        for key in ("analysis", "sweeps"):
            other = fields.get(key)
            if isinstance(other, int):
                named[number].append(other)
    found: dict[int, int] = {}
    waiting = list(campaigns)
    while waiting:
        by = waiting.pop()
        for other in named[by]:
            if other not in found and other not in campaigns:
                found[other] = by
                waiting.append(other)
    return found


@dataclass(slots=True)
class Pruned:
    """What was, or would be, removed. `bytes`: of files in the data folder. `stay`: campaigns kept, and why."""

    campaigns: int = 0
    recordings: int = 0
    spectra: int = 0
    estimates: int = 0
    bytes: int = 0
    stay: dict[int, str] = field(default_factory=dict[int, str])


def prune(
    store: RetentionStore,
    data_dir: Path,
    objects: ObjectStore | None,
    rules: RetentionRules,
    at: datetime,
    entry: Entry | None,
    tell: Callable[[Doomed], None] = lambda one: None,
) -> Pruned:
    """Remove what the rules name; without an audit `entry` only report what would be removed. Manifests are kept.

    Blocks. Raises NotNow while the object store does not answer: rows marked as removed are then removed by the next
    run.
    """
    doomed, stay = store.doomed(rules, at)
    found = Pruned(stay=stay)
    if entry is not None:
        for sample in store.removed():  # of an interrupted run
            _remove(store, sample, data_dir, objects)
    for one in doomed:
        paths = [data_dir / path for path in (*(sample.path for sample in one.samples), *(p for _, p in one.spectra))]
        size = sum(path.stat().st_size for path in paths if path.exists())
        if entry is not None:
            try:
                store.remove(one, at, entry)
            except Conflict as error:
                found.stay[one.campaign_id] = str(error)
                continue
            for sample in one.samples:
                _remove(store, sample, data_dir, objects)
            for _, path in one.spectra:
                (data_dir / path).unlink(missing_ok=True)
        tell(one)
        found.campaigns += 1
        found.recordings += len(one.samples)
        found.spectra += len(one.spectra)
        found.estimates += len(one.estimates)
        found.bytes += size
    return found


def _remove(store: RetentionStore, sample: StoredSamples, data_dir: Path, objects: ObjectStore | None) -> None:
    """The object is removed with the last recording of its content."""
    (data_dir / sample.path).unlink(missing_ok=True)
    if objects is not None and sample.moved:
        if sample.alone:
            objects.remove(sample.sha256)
        store.object_is_gone(sample)


@dataclass(frozen=True, slots=True)
class Backlog:
    """Recordings that are only here: number, and time of the oldest; `trouble`: the reason, if the store fails."""

    waiting: int
    since: datetime | None
    trouble: str = ""


Query = TypeVar("Query", bound=Select[*tuple[Any, ...]])


def _unmoved(query: Query) -> Query:
    """Of recordings, in no store yet and not removed, with their campaigns."""
    query = query.join(t.SweepRow, t.SweepRow.id == t.RecordingRow.sweep_id)
    query = query.join(t.CampaignRow, t.CampaignRow.id == t.SweepRow.campaign_id)
    return query.where(t.RecordingRow.moved_at.is_(None), t.RecordingRow.pruned_at.is_(None))


class MoveStore(rows.Transactions):
    """Every method is one transaction and blocks, as in `service.store.store`."""

    def backlog(self) -> Backlog:
        query = _unmoved(select(func.count(), func.min(t.RecordingRow.created_at)))
        with self._database.read() as session:
            return Backlog(*session.execute(query.where(rows.of_own(session))).one())

    def waiting(self, after: int, limit: int) -> dict[int, RecordingDocument]:
        """Recordings not moved yet, by the id of their row above `after`, the oldest first."""
        query = _unmoved(rows.page(t.RecordingRow, after, limit))
        with self._database.read() as session:
            found = session.scalars(query.where(rows.of_own(session)))
            return {row.id: rows.document(RecordingDocument, row) for row in found}

    def mark(self, recording_id: int) -> None:
        """The recording was read back from the store unchanged."""
        with self._database.write(quiet=True) as session:
            row = session.get(t.RecordingRow, recording_id)
            if row is not None and row.moved_at is None:
                row.moved_at = t.now()

    def moved(self) -> frozenset[str]:
        """The paths of the recordings in the store."""
        with self._database.read() as session:
            return frozenset(session.scalars(select(t.RecordingRow.path).where(t.RecordingRow.moved_at.is_not(None))))


def make_room(data_dir: Path, limit: int, moved: Callable[[], Collection[str]]) -> int:
    """Remove the oldest files of moved recordings until the rest has at most `limit` bytes. Returns how many were
    removed.

    `moved` returns the paths (relative) of recordings in the store; called only if something must be removed.
    """
    here = {path: path.stat() for path in (data_dir / "recordings").glob("*/[!.]*.parquet")}
    if sum(status.st_size for status in here.values()) <= limit:
        return 0
    paths = moved()
    # s after writing or fetching in which no file is removed, because it may be about to be opened
    old = time.time() - 60.0
    room, removed = limit, 0
    for path, status in sorted(here.items(), key=lambda each: each[1].st_mtime, reverse=True):
        if path.relative_to(data_dir).as_posix() not in paths:
            continue
        if status.st_size <= room or status.st_mtime > old:
            room -= status.st_size
        else:
            path.unlink(missing_ok=True)
            removed += 1
    return removed
