"""Which recordings of this service's machine are in the object store, and which still have to be moved."""

from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import func, select

from service.store import tables as t
from service.store.database import Transactions
from service.store.documents import RecordingDocument
from service.store.rows import document, of_own


@dataclass(frozen=True, slots=True)
class Backlog:
    """Recordings that are only here: number, and time of the oldest; `trouble`: the reason, if the store fails."""

    waiting: int
    since: datetime | None
    trouble: str = ""


class MoveStore(Transactions):
    """Every method is one transaction and blocks, as in `service.store.store`."""

    def backlog(self) -> Backlog:
        query = (
            select(func.count(), func.min(t.RecordingRow.created_at))
            .join(t.SweepRow, t.SweepRow.id == t.RecordingRow.sweep_id)
            .join(t.CampaignRow, t.CampaignRow.id == t.SweepRow.campaign_id)
            .where(t.RecordingRow.moved_at.is_(None), t.RecordingRow.pruned_at.is_(None))
        )
        with self._database.read() as session:
            return Backlog(*session.execute(query.where(of_own(session))).one())

    def waiting(self, after: int, limit: int) -> dict[int, RecordingDocument]:
        """Recordings not moved yet, by the id of their row above `after`, the oldest first."""
        query = (
            select(t.RecordingRow, t.SweepRow.campaign_id, t.SweepRow.number)
            .join(t.SweepRow, t.SweepRow.id == t.RecordingRow.sweep_id)
            .join(t.CampaignRow, t.CampaignRow.id == t.SweepRow.campaign_id)
            .where(t.RecordingRow.moved_at.is_(None), t.RecordingRow.pruned_at.is_(None), t.RecordingRow.id > after)
            .order_by(t.RecordingRow.id)
            .limit(limit)
        )
        with self._database.read() as session:
            found = session.execute(query.where(of_own(session))).all()
            return {
                row.id: document(RecordingDocument, row, campaign_id=campaign_id, number=number)
                for row, campaign_id, number in found
            }

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
