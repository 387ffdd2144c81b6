"""Rows to documents; rows of this service's machine; events. Inside a session of the caller."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from pydantic import BaseModel, JsonValue, TypeAdapter
from sqlalchemy import ColumnElement, Select, select
from sqlalchemy.orm import InstrumentedAttribute, Session

from drivers.errors import Cause
from service import Conflict, NotFound
from service.store import tables as t
from service.store.database import Database
from service.store.documents import EventKind, NewSweep, SweepDocument, SweepState

Row = TypeVar("Row", bound=t.StoredRow)
Kind = TypeVar("Kind", bound=BaseModel)
_CAUSE = TypeAdapter(Cause)


def document(kind: type[Kind], row: t.StoredRow, **more: object) -> Kind:
    """The row as a document of this kind: each field from `more`, or from the attribute with its name."""
    return kind.model_validate({name: more[name] if name in more else getattr(row, name) for name in kind.model_fields})


def documents(kind: type[Kind], session: Session, query: Select[Any]) -> tuple[Kind, ...]:
    """As `document`, of each row that the query selects."""
    return tuple(document(kind, row) for row in session.scalars(query))


class Transactions:
    """Reads and writes one database: every method is one transaction and blocks."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def _one(self, kind: type[Kind], table: type[t.StoredRow], key: int, name: str) -> Kind:
        """The row by its key, as a document. NotFound names it."""
        with self._database.read() as session:
            return document(kind, get(session, table, key, name))

    def _first(self, kind: type[Kind], query: Select[Any]) -> Kind | None:
        """The first row of a query, as a document; None if there is none."""
        with self._database.read() as session:
            return next(iter(documents(kind, session, query.limit(1))), None)

    def _all(
        self, kind: type[Kind], query: Select[Any], own: InstrumentedAttribute[int] | None = None
    ) -> tuple[Kind, ...]:
        """The rows of a query, as documents. `own`: only those with the id of this service's machine. NoMachine."""
        with self._database.read() as session:
            return documents(kind, session, query if own is None else query.where(own == own_id(session)))


def page(table: type[Row], after: int, limit: int) -> Select[Row]:
    """Rows with an id above `after`, in their order."""
    return select(table).where(table.__table__.c.id > after).order_by(table.__table__.c.id).limit(limit)


def added(session: Session, row: Row) -> Row:
    """The row with its id."""
    session.add(row)
    session.flush()
    return row


class NoMachine(Conflict):
    """This service only reads the plant: it owns no machine (API: 409)."""

    def __init__(self) -> None:
        super().__init__(
            "this service has no machine (`--no-machine`) and only shows the plant; ask the service of the machine"
        )


class OtherMachine(Conflict):
    """The object to be changed belongs to the machine of another service (API: 409)."""


def get(session: Session, kind: type[Row], key: int, name: str) -> Row:
    """A row by primary key; NotFound names it. No other transaction changes it during a writing one."""
    row = session.get(kind, key)
    if row is None:
        raise NotFound(f"{name} {key} does not exist")
    return row


def own_id(session: Session) -> int:
    """The id of this service's machine. Raises NoMachine."""
    machine = owned(session)
    if machine is None:
        raise NoMachine
    return machine.id


def owned(session: Session) -> t.OwnMachine | None:
    """This service's machine."""
    return session.info[t.OfMachine.own]


def check_own(session: Session, machine_id: int, what: str) -> None:
    """Raises OtherMachine, or NoMachine, unless the machine is this service's. `what` belongs to it."""
    if own_id(session) != machine_id:
        name = get(session, t.MachineRow, machine_id, "machine").name
        raise OtherMachine(f"{what} belongs to machine {name!r}: send it to the service of that machine")


def own_campaign(session: Session, campaign_id: int) -> t.CampaignRow:
    """As `get`, for a campaign of this service's machine. Raises OtherMachine, NoMachine."""
    row = get(session, t.CampaignRow, campaign_id, "campaign")
    check_own(session, row.machine_id, f"campaign {campaign_id}")
    return row


def own_sweep(session: Session, campaign_id: int, number: int) -> t.SweepRow:
    """As `get_sweep`, for a campaign of this service's machine. Raises OtherMachine, NoMachine."""
    own_campaign(session, campaign_id)
    return get_sweep(session, campaign_id, number)


def of_own(session: Session) -> ColumnElement[bool]:
    """Condition: campaigns of this service's machine. Raises NoMachine."""
    return t.CampaignRow.machine_id == own_id(session)


def stops_of_machine_of(campaign_id: int) -> ColumnElement[bool]:
    """Condition: stop events of the machine of a campaign."""
    machine = select(t.CampaignRow.machine_id).where(t.CampaignRow.id == campaign_id).scalar_subquery()
    return (t.EventRow.kind == EventKind.STOP) & (t.EventRow.machine_id == machine)


def emit(session: Session, campaign_id: int | None, kind: EventKind, data: dict[str, JsonValue]) -> None:
    """Add an event of this service's machine to the outbox. Raises NoMachine."""
    session.add(t.EventRow(machine_id=own_id(session), campaign_id=campaign_id, kind=kind, data=data))


def get_sweep(session: Session, campaign_id: int, number: int) -> t.SweepRow:
    """As `get`, a sweep by campaign and number."""
    row = session.scalar(select(t.SweepRow).where(t.SweepRow.campaign_id == campaign_id, t.SweepRow.number == number))
    if row is None:
        raise NotFound(f"campaign {campaign_id} sweep {number} does not exist")
    return row


def add_sweeps(
    session: Session, campaign: t.CampaignRow, sweeps: Sequence[NewSweep], state: SweepState
) -> list[t.SweepRow]:
    """Insert a campaign of this service's machine with its sweeps, numbered from 1."""
    campaign.machine_id = own_id(session)
    added(session, campaign)
    new = [
        t.SweepRow(
            campaign_id=campaign.id,
            number=number,
            spec=sweep.spec.model_dump(mode="json"),
            mode=sweep.mode,
            state=state,
            attempt=1 if state is SweepState.RECORDED else 0,
        )
        for number, sweep in enumerate(sweeps, 1)
    ]
    session.add_all(new)
    session.flush()
    return new


def move_sweep(
    session: Session, row: t.SweepRow, move: Callable[[SweepState], SweepState], cause: Cause | None
) -> SweepDocument:
    """Change the state of a sweep and emit the event."""
    row.state = move(row.state)
    set_cause(row, cause)
    moved = document(SweepDocument, row)
    data: dict[str, JsonValue] = {
        "number": row.number,
        "state": row.state.value,
        "cause": row.cause,
        "axis": moved.spec.axis,
        "attempt": row.attempt,
    }
    emit(session, row.campaign_id, EventKind.SWEEP, data)
    return moved


def set_cause(row: t.CampaignRow | t.SweepRow, cause: Cause | None) -> None:
    """The sentence, and beside it the cause for programs and pages."""
    row.cause, row.structured_cause = str(cause or ""), cause_json(cause)


def cause_json(cause: Cause | None) -> dict[str, JsonValue] | None:
    return None if cause is None else _CAUSE.dump_python(cause, mode="json")


def emit_campaign(session: Session, row: t.CampaignRow) -> None:
    """Emit the state of a campaign."""
    data: dict[str, JsonValue] = {"state": row.state.value, "cause": row.cause, "version": row.version}
    emit(session, row.id, EventKind.CAMPAIGN, data)
    session.flush()
