"""Approvals of plans, with the hash of everything that determines their motion, and their validity."""

from collections.abc import Callable
from datetime import datetime, timedelta

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from service.store import rows
from service.store import tables as t
from service.store.database import Transactions
from service.store.documents import StoredDocument


class ApprovalDocument(StoredDocument):
    """One approval; `sha256` is the hash of the approved motion. `ended_by`: id of a later stop of its machine."""

    id: int
    plan_id: int
    sha256: str
    approved_by: str
    at: datetime
    expires_at: datetime
    ended_by: int | None

    def trouble(self, sha256: str, at: datetime) -> str:
        """Why it is not valid for this motion at this time; empty if it is."""
        who = f"the approval by {self.approved_by} of {self.at:%Y-%m-%d %H:%M} UTC"
        if self.sha256 != sha256:
            return f"{who} is no longer valid: robot, cell, drives, settings or program have changed since"
        if self.ended_by is not None:
            return f"{who} was ended by stop {self.ended_by} of the machine, which came after it: approve it again"
        if not self.at <= at:
            return f"{who} is in the future: the clock of the computer was set back"
        return f"{who} expired at {self.expires_at:%Y-%m-%d %H:%M} UTC" if at >= self.expires_at else ""


class ApprovalStore(Transactions):
    """Every method is one transaction and blocks, as in `service.store.store`."""

    def add(
        self, plan_id: int, sha256: str, approved_by: str, valid: timedelta, wanted: Callable[[], None]
    ) -> ApprovalDocument:
        """Raises NotFound if the plan does not exist, and what `wanted` raises."""
        with self._database.write(quiet=True) as session:
            machine = rows.own(session)
            last_stop = _last_stop(session, machine)  # read before `wanted`: a stop between the two ends the approval
            wanted()
            rows.get(session, t.PlanRow, plan_id, "plan")
            at = t.now()
            row = t.ApprovalRow(
                machine_id=machine,
                plan_id=plan_id,
                sha256=sha256,
                approved_by=approved_by,
                at=at,
                expires_at=at + valid,
                last_stop=last_stop,
            )
            session.add(row)
            session.flush()
            return _document(row, last_stop)

    def of_plan(self, plan_id: int) -> tuple[ApprovalDocument, ...]:
        """Approvals for this service's machine, the newest first, at most a hundred."""
        query = select(t.ApprovalRow).where(t.ApprovalRow.plan_id == plan_id).order_by(t.ApprovalRow.id.desc())
        with self._database.read() as session:
            machine = rows.owned(session)
            if machine is not None:
                query = query.where(t.ApprovalRow.machine_id == machine.id)
            return tuple(
                _document(row, _last_stop(session, row.machine_id)) for row in session.scalars(query.limit(100)).all()
            )


def _last_stop(session: Session, machine: int) -> int:
    """The id of the newest stop of a machine, 0: none. Ids have an order also when the clock was set."""
    return session.scalar(select(func.max(t.StopRow.id)).where(t.StopRow.machine_id == machine)) or 0


def _document(row: t.ApprovalRow, last_stop: int) -> ApprovalDocument:
    return rows.document(ApprovalDocument, row, ended_by=last_stop if last_stop > row.last_stop else None)
