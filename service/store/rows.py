"""Between rows and documents, inside a session that the caller holds."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from pydantic import JsonValue
from sqlalchemy import Select, func, select
from sqlalchemy.orm import Session

from service.errors import NotFound
from service.recording import SweepSpec
from service.robot import RobotDescription
from service.store import tables as t
from service.store.documents import (
    CampaignDocument,
    EstimateDocument,
    EventKind,
    NewSweep,
    PlanRecord,
    RecordingDocument,
    RobotDocument,
    SweepDocument,
    SweepState,
)

Row = TypeVar("Row", bound=t.Base)


def get(session: Session, kind: type[Row], key: int, name: str) -> Row:
    """A row by primary key; NotFound names it. Locked until the transaction ends, where the database locks rows."""
    row = session.get(kind, key, with_for_update=True)
    if row is None:
        raise NotFound(f"{name} {key} does not exist")
    return row


def get_sweep(session: Session, campaign_id: int, number: int) -> t.SweepRow:
    """As `get`, a sweep by campaign and number."""
    row = session.scalar(
        select(t.SweepRow).where(t.SweepRow.campaign_id == campaign_id, t.SweepRow.number == number).with_for_update()
    )
    if row is None:
        raise NotFound(f"campaign {campaign_id} sweep {number} does not exist")
    return row


def add_sweeps(
    session: Session, campaign: t.CampaignRow, sweeps: Sequence[NewSweep], state: SweepState
) -> list[t.SweepRow]:
    """Insert a campaign with its sweeps, numbered from 1."""
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
    session: Session, row: t.SweepRow, move: Callable[[SweepState], SweepState], cause: str
) -> SweepDocument:
    """Change the state of a sweep and tell it."""
    row.state = move(row.state)
    row.cause = cause
    document = sweep_document(row)
    data: dict[str, JsonValue] = {
        "number": row.number,
        "state": row.state.value,
        "cause": cause,
        "axis": document.spec.axis,
        "attempt": row.attempt,
    }
    session.add(t.EventRow(campaign_id=row.campaign_id, kind=EventKind.SWEEP, data=data))
    return document


def emit_campaign(session: Session, row: t.CampaignRow) -> None:
    """Tell the state of a campaign."""
    data: dict[str, JsonValue] = {"state": row.state.value, "cause": row.cause, "version": row.version}
    session.add(t.EventRow(campaign_id=row.id, kind=EventKind.CAMPAIGN, data=data))
    session.flush()


def robot_document(row: t.RobotRow) -> RobotDocument:
    return RobotDocument(
        id=row.id,
        name=row.name,
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
        robot_id=row.robot_id,
        plan_id=row.plan_id,
        state=row.state,
        cause=row.cause,
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
    )


def estimates_of(campaign_id: int) -> Select[t.EstimateRow, int]:
    """Estimates with the numbers of their sweeps."""
    return (
        select(t.EstimateRow, t.SweepRow.number)
        .join(t.SweepRow, t.SweepRow.id == t.EstimateRow.sweep_id)
        .where(t.EstimateRow.campaign_id == campaign_id)
    )


def estimate_document(row: t.EstimateRow, number: int) -> EstimateDocument:
    return EstimateDocument(
        campaign_id=row.campaign_id,
        revision=row.revision,
        number=number,
        document=row.document,
        created_at=row.created_at,
    )
