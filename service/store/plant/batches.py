"""Batches: computations over many stored campaigns, with their progress.

Every method is one transaction and blocks, as in `service.store.store`; `NotFound` if the id does not exist.
"""

from collections.abc import Sequence
from datetime import datetime
from typing import Annotated

from pydantic import JsonValue
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from service.model.errors import BadInput, NotFound
from service.model.results.estimate import Estimate
from service.model.results.part import JsonOf
from service.store import rows
from service.store import tables as t
from service.store.checks import OVER
from service.store.database import Transactions
from service.store.documents import BatchState, EventKind, StoredDocument, SweepState

REIDENTIFY = "reidentify"
_OPEN = (BatchState.WAITING, BatchState.RUNNING)


class BatchDocument(StoredDocument):
    """A batch and its progress: `done` of `campaigns`, `failed` of them without a result, `sweeps` identified again.

    `machine`: the name of the machine whose service computes it. `here`: it is the machine of this service.
    """

    id: int
    machine: str
    here: bool
    kind: str
    asked_by: str
    state: BatchState
    campaigns: int
    done: int
    failed: int
    sweeps: int
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None


class BatchEntry(StoredDocument):
    """A campaign of a batch. `change_percent`: largest change of J of any sweep relative to the stored estimate.

    `cause`: why there is no result; empty if there is one.
    """

    campaign_id: int
    sweeps: int
    change_percent: float | None
    cause: str
    at: datetime


class BatchEstimate(BatchEntry):
    """A campaign of a batch with the estimate's `document`, as `identify --json`; null if there is none."""

    document: Annotated[dict[str, JsonValue], JsonOf(Estimate)] | None


class BatchStore(Transactions):
    """Batches of the plant; only those of this service's machine are changed."""

    def add(self, campaigns: Sequence[int] | None, asked_by: str) -> BatchDocument:
        """A waiting batch: of these campaigns of this machine, or (None) all finished ones. Raises BadInput if there is
        none.
        """
        with self._database.write() as session:
            own = select(t.CampaignRow.id).where(rows.of_own(session), t.CampaignRow.state.in_(OVER))
            identified = select(t.SweepRow.campaign_id).where(t.SweepRow.state == SweepState.IDENTIFIED)
            usable = set(session.scalars(own.where(t.CampaignRow.id.in_(identified))))
            for number in campaigns or ():
                rows.own_campaign(session, number)
                if number not in usable:
                    raise BadInput("campaigns", f"campaign {number} has not ended, or has no identified sweep")
            wanted = sorted(usable if campaigns is None else set(campaigns))
            if not wanted:
                raise BadInput("campaigns", "this machine has no campaign that has ended and has an identified sweep")
            row = t.BatchRow(
                machine_id=rows.own(session),
                kind=REIDENTIFY,
                campaigns=wanted,
                asked_by=asked_by,
                state=BatchState.WAITING,
            )
            session.add(row)
            session.flush()
            return _with_event(session, row)

    def batch(self, batch_id: int) -> BatchDocument:
        with self._database.read() as session:
            return _document(session, rows.get(session, t.BatchRow, batch_id, "job"))

    def batches(self, after: int = 0, limit: int = 100) -> tuple[BatchDocument, ...]:
        query = select(t.BatchRow).where(t.BatchRow.id > after).order_by(t.BatchRow.id).limit(limit)
        with self._database.read() as session:
            return tuple(_document(session, row) for row in session.scalars(query))

    def open(self) -> tuple[int, ...]:
        """Batches of this machine that are not finished."""
        query = select(t.BatchRow.id).where(t.BatchRow.state.in_(_OPEN)).order_by(t.BatchRow.id)
        with self._database.read() as session:
            return tuple(session.scalars(query.where(t.BatchRow.machine_id == rows.own(session))))

    def begin(self, batch_id: int) -> tuple[int, ...]:
        """Its campaigns without a result; the batch is then running. () if it is finished."""
        with self._database.write() as session:
            row = _own(session, batch_id)
            if row.state not in _OPEN:
                return ()
            if row.state is BatchState.WAITING:
                row.state, row.started_at = BatchState.RUNNING, t.now()
                _with_event(session, row)
            done = set(
                session.scalars(select(t.BatchResultRow.campaign_id).where(t.BatchResultRow.batch_id == batch_id))
            )
            return tuple(number for number in row.campaigns if number not in done)

    def add_result(
        self,
        batch_id: int,
        campaign_id: int,
        sweeps: int,
        document: dict[str, JsonValue] | None,
        change_percent: float | None = None,
        cause: str = "",
    ) -> None:
        """Store the result of one campaign; no effect if it exists, or the batch is finished."""
        with self._database.write() as session:
            row = _own(session, batch_id)
            there = select(t.BatchResultRow.id).where(
                t.BatchResultRow.batch_id == batch_id, t.BatchResultRow.campaign_id == campaign_id
            )
            if row.state not in _OPEN or session.scalar(there) is not None:
                return
            found = {"sweeps": sweeps, "document": document, "change_percent": change_percent, "cause": cause}
            session.add(t.BatchResultRow(batch_id=batch_id, campaign_id=campaign_id, **found))
            session.flush()
            _with_event(session, row)

    def end(self, batch_id: int, state: BatchState) -> BatchDocument:
        """Set `done` or `cancelled`; a finished batch does not change."""
        with self._database.write() as session:
            row = _own(session, batch_id)
            if row.state not in _OPEN:
                return _document(session, row)
            row.state, row.finished_at = state, t.now()
            return _with_event(session, row)

    def results(self, batch_id: int, after: int = 0, limit: int = 100) -> tuple[BatchEntry, ...]:
        """By campaign, without their documents."""
        row = t.BatchResultRow
        query = select(row).where(row.batch_id == batch_id, row.campaign_id > after)
        with self._database.read() as session:
            rows.get(session, t.BatchRow, batch_id, "job")
            return rows.documents(BatchEntry, session, query.order_by(row.campaign_id).limit(limit))

    def result(self, batch_id: int, campaign_id: int) -> BatchEstimate:
        row = t.BatchResultRow
        query = select(row).where(row.batch_id == batch_id, row.campaign_id == campaign_id)
        with self._database.read() as session:
            found = session.scalar(query)
            if found is None:
                raise NotFound(f"job {batch_id} has no result of campaign {campaign_id}")
            return rows.document(BatchEstimate, found)


def _own(session: Session, batch_id: int) -> t.BatchRow:
    row = rows.get(session, t.BatchRow, batch_id, "job")
    rows.check_own(session, row.machine_id, f"job {batch_id}")
    return row


def _with_event(session: Session, row: t.BatchRow) -> BatchDocument:
    """The document of its present state, which is also added to the outbox as an event."""
    found = _document(session, row)
    data: dict[str, JsonValue] = {
        "batch": row.id,
        "state": row.state.value,
        "done": found.done,
        "campaigns": found.campaigns,
    }
    rows.emit(session, None, EventKind.BATCH, data)
    return found


def _document(session: Session, row: t.BatchRow) -> BatchDocument:
    result = t.BatchResultRow
    query = select(func.count(), func.coalesce(func.sum(result.sweeps), 0)).where(result.batch_id == row.id)
    done, sweeps = session.execute(query).one()
    failed = session.scalar(query.with_only_columns(func.count()).where(result.cause != ""))
    counts = {"campaigns": len(row.campaigns), "done": done, "failed": failed or 0, "sweeps": sweeps}
    return rows.document(BatchDocument, row, **counts, **rows.machine_of(session, row.machine_id))
