"""Retention rule: which data of finished campaigns may be removed, what is protected, and holds set by people.

Protected campaigns are kept completely: unfinished ones, held ones, the evidence of accepted models and of open
diagnoses, of open batches, and campaigns named by their plans. The newest estimate of every campaign is kept, and
each revision from which a diagnosis started.
"""

from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta

from pydantic import JsonValue
from sqlalchemy import ColumnElement, delete, func, select
from sqlalchemy.orm import Session

from service.model.errors import Conflict, NotFound
from service.store import rows
from service.store import tables as t
from service.store.access.audit_chain import Entry
from service.store.database import Database
from service.store.diagnosis_documents import DiagnosisState
from service.store.documents import BatchState, CampaignState, StoredDocument
from service.store.people.audit import append

_OVER = (CampaignState.COMPLETED, CampaignState.ABORTED)
_OPEN_DIAGNOSES = (DiagnosisState.WAITING, DiagnosisState.RUNNING)
_OPEN_BATCHES = (BatchState.WAITING, BatchState.RUNNING)


@dataclass(frozen=True, slots=True)
class Rules:
    """Days after the last recording of a campaign; None: keep forever."""

    samples: float | None
    spectra: float | None
    estimates: float | None


@dataclass(frozen=True, slots=True)
class Sample:
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
    samples: tuple[Sample, ...]
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


class RetentionStore:
    """For one machine, by its id. Every method is one transaction and blocks; NotFound if the id does not exist."""

    def __init__(self, database: Database, machine_id: int) -> None:
        self._database, self._machine = database, machine_id

    def doomed(self, rules: Rules, at: datetime) -> tuple[tuple[Doomed, ...], dict[int, str]]:
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

    def removed(self) -> tuple[Sample, ...]:
        """Recordings marked as removed: files may still exist after an interrupted removal."""
        with self._database.read() as session:
            return tuple(_samples(session, t.CampaignRow.machine_id == self._machine, pruned=True))

    def object_is_gone(self, sample: Sample) -> None:
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
            session.add(row := t.HoldRow(campaign_id=campaign_id, by=by, why=why, at=t.now()))
            append(session, [{**entry, "event": "hold added", "campaign": campaign_id, "why": why}])
            session.flush()
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
        with self._database.read() as session:
            query = select(t.HoldRow).order_by(t.HoldRow.campaign_id)
            return rows.documents(HoldDocument, session, query)


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


def _doomed(session: Session, campaign_id: int, age: timedelta, rules: Rules) -> Doomed:
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


def _samples(session: Session, of: ColumnElement[bool], pruned: bool) -> Iterator[Sample]:
    recording = t.RecordingRow
    query = select(recording).join(t.SweepRow, t.SweepRow.id == recording.sweep_id)
    query = query.join(t.CampaignRow, t.CampaignRow.id == t.SweepRow.campaign_id).where(of)
    found = session.scalars(query.where(recording.pruned_at.is_not(None) if pruned else recording.pruned_at.is_(None)))
    for row in found.all():
        others = select(func.count()).where(recording.sha256 == row.sha256, recording.id != row.id)
        alone = session.scalar(others.where(recording.pruned_at.is_(None))) == 0
        yield Sample(row.id, row.path, row.sha256, row.moved_at is not None, alone)


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
    over = t.CampaignRow.state.in_(_OVER)
    for number in session.scalars(select(t.CampaignRow.id).where(~over)):
        found[number] = "it has not ended"
    for hold in session.scalars(select(t.HoldRow)):
        found.setdefault(hold.campaign_id, f"held by {hold.by}: {hold.why}")
    for model, diagnosis in session.execute(select(t.ModelRow.id, t.ModelRow.diagnosis_id)):
        for number in _evidence(session, diagnosis):
            found.setdefault(number, f"model {model} was made from it")
    open_ones = select(t.DiagnosisRow.id).where(t.DiagnosisRow.state.in_(_OPEN_DIAGNOSES))
    for diagnosis in session.scalars(open_ones):
        for number in _evidence(session, diagnosis):
            found.setdefault(number, f"diagnosis {diagnosis} has not ended")
    for batch in session.scalars(select(t.BatchRow).where(t.BatchRow.state.in_(_OPEN_BATCHES))):
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
