"""Conversion between rows and documents, inside a session of the caller."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from pydantic import JsonValue, TypeAdapter
from sqlalchemy import ColumnElement, Select, func, select
from sqlalchemy.orm import Session

from drivers.errors import Cause
from service.errors import Conflict, NotFound
from service.recording import SweepSpec
from service.robot import Robot, RobotDescription
from service.store import tables as t
from service.store.database import OWN, OwnMachine
from service.store.documents import (
    CampaignDocument,
    EstimateDocument,
    EventKind,
    NewSweep,
    PlanRecord,
    RecordingDocument,
    RobotDocument,
    SpectrumRecord,
    SweepDocument,
    SweepState,
)

Row = TypeVar("Row", bound=t.Base)
_CAUSE = TypeAdapter(Cause)


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


def own(session: Session) -> int:
    """The id of this service's machine. Raises NoMachine."""
    machine = owned(session)
    if machine is None:
        raise NoMachine
    return machine.id


def owned(session: Session) -> OwnMachine | None:
    """This service's machine."""
    return session.info[OWN]


def check_own(session: Session, machine_id: int, what: str) -> None:
    """Raises OtherMachine, or NoMachine, unless the machine is this service's. `what`: the object that belongs
    to it.
    """
    if own(session) != machine_id:
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
    return t.CampaignRow.machine_id == own(session)


def stops_of_machine_of(campaign_id: int) -> ColumnElement[bool]:
    """Condition: stop events of the machine of a campaign."""
    machine = select(t.CampaignRow.machine_id).where(t.CampaignRow.id == campaign_id).scalar_subquery()
    return (t.EventRow.kind == EventKind.STOP) & (t.EventRow.machine_id == machine)


def emit(session: Session, campaign_id: int | None, kind: EventKind, data: dict[str, JsonValue]) -> None:
    """Add an event of this service's machine to the outbox. Raises NoMachine."""
    session.add(t.EventRow(machine_id=own(session), campaign_id=campaign_id, kind=kind, data=data))


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
    campaign.machine_id = own(session)
    session.add(campaign)
    session.flush()
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
    document = sweep_document(row)
    data: dict[str, JsonValue] = {
        "number": row.number,
        "state": row.state.value,
        "cause": row.cause,
        "axis": document.spec.axis,
        "attempt": row.attempt,
    }
    emit(session, row.campaign_id, EventKind.SWEEP, data)
    return document


def set_cause(row: t.CampaignRow | t.SweepRow, cause: Cause | None) -> None:
    """The sentence, and beside it the cause for programs and pages."""
    row.cause, row.structured_cause = str(cause or ""), cause_json(cause)


def cause_json(cause: Cause | None) -> dict[str, JsonValue] | None:
    return None if cause is None else _CAUSE.dump_python(cause, mode="json")


def cause_of(stored: dict[str, JsonValue] | None) -> Cause | None:
    return None if stored is None else _CAUSE.validate_python(stored)


def emit_campaign(session: Session, row: t.CampaignRow) -> None:
    """Emit the state of a campaign."""
    data: dict[str, JsonValue] = {"state": row.state.value, "cause": row.cause, "version": row.version}
    emit(session, row.id, EventKind.CAMPAIGN, data)
    session.flush()


def robot_row(robot: Robot, sha256: str) -> t.RobotRow:
    return t.RobotRow(
        sha256=sha256,
        name=robot.name,
        serial=robot.description.serial,
        revision=robot.description.revision,
        description=robot.description.model_dump(mode="json"),
        urdf_text=robot.urdf_text,
    )


def robot_document(row: t.RobotRow) -> RobotDocument:
    return RobotDocument(
        id=row.id,
        name=row.name,
        serial=row.serial,
        revision=row.revision,
        description=RobotDescription.model_validate(row.description),
        urdf_text=row.urdf_text,
        created_at=row.created_at,
    )


def plan_document(row: t.PlanRow) -> PlanRecord:
    return PlanRecord(id=row.id, robot_id=row.robot_id, document=row.document, created_at=row.created_at)


def campaign_document(session: Session, row: t.CampaignRow) -> CampaignDocument:
    counts = select(t.SweepRow.state, func.count()).where(t.SweepRow.campaign_id == row.id).group_by(t.SweepRow.state)
    return CampaignDocument(
        id=row.id,
        machine=session.get_one(t.MachineRow, row.machine_id).name,
        here=(machine := owned(session)) is not None and machine.id == row.machine_id,
        robot_id=row.robot_id,
        plan_id=row.plan_id,
        state=row.state,
        cause=row.cause,
        structured_cause=cause_of(row.structured_cause),
        version=row.version,
        sweeps=dict(session.execute(counts).all()),
        created_at=row.created_at,
        started_at=row.started_at,
    )


def sweep_document(row: t.SweepRow) -> SweepDocument:
    return SweepDocument(
        campaign_id=row.campaign_id,
        number=row.number,
        spec=SweepSpec.model_validate(row.spec),
        mode=row.mode,
        state=row.state,
        cause=row.cause,
        structured_cause=cause_of(row.structured_cause),
        attempt=row.attempt,
    )


def recording_document(row: t.RecordingRow, campaign_id: int, number: int) -> RecordingDocument:
    return RecordingDocument(
        campaign_id=campaign_id,
        number=number,
        attempt=row.attempt,
        state=row.state,
        path=row.path,
        sha256=row.sha256,
        samples=row.samples,
        pruned_at=row.pruned_at,
    )


def add_estimate(
    session: Session,
    identified: Sequence[tuple[SweepDocument, SpectrumRecord]],
    move: Callable[[SweepState], SweepState],
    document: dict[str, JsonValue],
) -> EstimateDocument | None:
    """Insert the next revision with the spectra of its new sweeps; see `Store.add_estimate`."""
    found: list[t.SweepRow] = []
    for sweep, _ in identified:
        row = own_sweep(session, sweep.campaign_id, sweep.number)
        if row.state is not SweepState.RECORDED or row.attempt != sweep.attempt:
            return None
        found.append(row)
    last = found[-1]
    revisions = select(func.max(t.EstimateRow.revision)).where(t.EstimateRow.campaign_id == last.campaign_id)
    estimate = t.EstimateRow(
        campaign_id=last.campaign_id,
        revision=(session.scalar(revisions) or 0) + 1,
        sweep_id=last.id,
        document=document,
    )
    session.add(estimate)
    data: dict[str, JsonValue] = {"revision": estimate.revision, "sweep": last.number}
    emit(session, last.campaign_id, EventKind.ESTIMATE, data)
    for row, (_, spectrum) in zip(found, identified, strict=True):
        session.add(t.SpectrumRow(sweep_id=row.id, **spectrum.model_dump()))
        move_sweep(session, row, move, None)
    session.flush()
    return estimate_document(estimate, last.number)


def estimates_of(campaign_id: int) -> Select[t.EstimateRow, int]:
    """Estimates with the numbers of their sweeps."""
    return (
        select(t.EstimateRow, t.SweepRow.number)
        .join(t.SweepRow, t.SweepRow.id == t.EstimateRow.sweep_id)
        .where(t.EstimateRow.campaign_id == campaign_id)
    )


def confidences_of(campaign_id: int, joints: Sequence[str]) -> Select[*tuple[Any, ...]]:
    """Revision, number of its sweep, then "confidence_percent" of each joint, read from the documents."""
    axes = t.EstimateRow.document["axes"]
    query = select(t.EstimateRow.revision, t.SweepRow.number, *(axes[one]["confidence_percent"] for one in joints))
    query = query.join(t.SweepRow, t.SweepRow.id == t.EstimateRow.sweep_id).order_by(t.EstimateRow.revision)
    return query.where(t.EstimateRow.campaign_id == campaign_id)


def estimate_document(row: t.EstimateRow, number: int) -> EstimateDocument:
    return EstimateDocument(
        campaign_id=row.campaign_id,
        revision=row.revision,
        number=number,
        document=row.document,
        created_at=row.created_at,
    )
