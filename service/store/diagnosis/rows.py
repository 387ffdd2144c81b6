"""Conversion between rows and documents of diagnoses, inside a session of the caller."""

from collections.abc import Sequence

from pydantic import JsonValue
from sqlalchemy import select
from sqlalchemy.orm import Session

from service.store import rows
from service.store import tables as t
from service.store.diagnosis_documents import (
    DiagnosisDocument,
    DiagnosisEntry,
    DiagnosisState,
    EstimateOf,
    ExperimentDocument,
    NewDiagnosis,
    Weighing,
)
from service.store.documents import CampaignState, EventKind

OPEN = (DiagnosisState.WAITING, DiagnosisState.RUNNING)


def add(session: Session, new: NewDiagnosis) -> t.DiagnosisRow:
    rows.get(session, t.RobotRow, new.robot_id, "robot")
    for campaign in new.campaigns:
        rows.get(session, t.CampaignRow, campaign, "campaign")
    if new.model is not None:
        rows.get(session, t.ModelRow, new.model, "model")
    row = t.DiagnosisRow(
        machine_id=rows.own(session),
        robot_id=new.robot_id,
        parent_id=new.parent,
        model_id=new.model,
        campaigns=list(new.campaigns),
        axes=list(new.axes),
        weighed=None if new.weighed is None else new.weighed.model_dump(mode="json"),
        estimate=None if new.estimate is None else new.estimate.model_dump(mode="json"),
        unattended=new.unattended,
        state=DiagnosisState.WAITING,
    )
    session.add(row)
    session.flush()
    emit(session, row)
    return row


def add_result(session: Session, diagnosis_id: int, joint: str, verdict: str, document: dict[str, JsonValue]) -> None:
    session.add(t.AxisDiagnosisRow(diagnosis_id=diagnosis_id, joint=joint, verdict=verdict, document=document))
    session.flush()


def move(session: Session, row: t.DiagnosisRow, state: DiagnosisState, cause: str = "") -> None:
    if state is not row.state and state not in OPEN:
        row.finished_at = t.now()
    row.state, row.cause = state, cause
    emit(session, row)


def emit(session: Session, row: t.DiagnosisRow) -> None:
    data: dict[str, JsonValue] = {
        "diagnosis": row.id,
        "state": row.state.value,
        "cause": row.cause,
        "verdicts": dict[str, JsonValue](_verdicts(session, row.id)),
        "parent": row.parent_id,
    }
    rows.emit(session, None, EventKind.DIAGNOSIS, data)


def child(session: Session, diagnosis_id: int) -> int | None:
    return session.scalar(select(t.DiagnosisRow.id).where(t.DiagnosisRow.parent_id == diagnosis_id))


def results(session: Session, diagnosis_id: int) -> Sequence[t.AxisDiagnosisRow]:
    query = select(t.AxisDiagnosisRow).where(t.AxisDiagnosisRow.diagnosis_id == diagnosis_id)
    return session.scalars(query.order_by(t.AxisDiagnosisRow.id)).all()


def _verdicts(session: Session, diagnosis_id: int) -> dict[str, str]:
    return {row.joint: row.verdict for row in results(session, diagnosis_id)}


def experiment_state(session: Session, row: t.DiagnosisRow) -> CampaignState | None:
    if row.experiment_campaign_id is None:
        return None
    return session.get_one(t.CampaignRow, row.experiment_campaign_id).state


def entry(session: Session, row: t.DiagnosisRow) -> DiagnosisEntry:
    return DiagnosisEntry(
        id=row.id,
        machine=session.get_one(t.MachineRow, row.machine_id).name,
        here=(owned := rows.owned(session)) is not None and owned.id == row.machine_id,
        robot_id=row.robot_id,
        campaigns=tuple(row.campaigns),
        axes=tuple(row.axes),
        model=row.model_id,
        weighed=None if row.weighed is None else Weighing.model_validate(row.weighed),
        estimate=None if row.estimate is None else EstimateOf.model_validate(row.estimate),
        parent=row.parent_id,
        unattended=row.unattended,
        state=row.state,
        cause=row.cause,
        verdicts=_verdicts(session, row.id),
        experiment=None if row.experiment is None else ExperimentDocument.model_validate(row.experiment),
        created_at=row.created_at,
        finished_at=row.finished_at,
    )


def document(session: Session, row: t.DiagnosisRow) -> DiagnosisDocument:
    return DiagnosisDocument(**entry(session, row).model_dump(), document=row.document)
