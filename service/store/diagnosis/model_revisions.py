"""Models accepted from diagnoses: append-only, numbered per robot."""

from pydantic import JsonValue
from sqlalchemy import select
from sqlalchemy.orm import Session

from service.model.errors import Conflict
from service.store import rows
from service.store import tables as t
from service.store.database import Transactions
from service.store.diagnosis_documents import ModelDocument


class ModelStore(Transactions):
    """Every method is one transaction and blocks, as in `service.store.store`; `NotFound` if the id does not exist."""

    def add(
        self, diagnosis_id: int, accepted_by: str, document: dict[str, JsonValue], parent: int | None
    ) -> ModelDocument:
        """The next revision of the robot's model, based on `parent`.

        Raises Conflict if the diagnosis was already accepted, or `parent` is not the newest revision.
        """
        with self._database.write() as session:
            diagnosis = rows.get(session, t.DiagnosisRow, diagnosis_id, "diagnosis")
            rows.get(session, t.RobotRow, diagnosis.robot_id, "robot")
            before = session.scalar(select(t.ModelRow).where(t.ModelRow.diagnosis_id == diagnosis_id))
            if before is not None:
                raise Conflict(
                    f"diagnosis {diagnosis_id} was already accepted as model {before.id}; diagnose again "
                    "from that model"
                )
            newest = _newest(session, diagnosis.robot_id)
            if (None if newest is None else newest.id) != parent:
                raise Conflict(f"another model of robot {diagnosis.robot_id} was accepted in the meantime")
            row = t.ModelRow(
                robot_id=diagnosis.robot_id,
                revision=1 if newest is None else newest.revision + 1,
                parent=parent,
                diagnosis_id=diagnosis_id,
                accepted_by=accepted_by,
                document=document,
            )
            session.add(row)
            session.flush()
            return rows.document(ModelDocument, row)

    def model(self, model_id: int) -> ModelDocument:
        with self._database.read() as session:
            return rows.document(ModelDocument, rows.get(session, t.ModelRow, model_id, "model"))

    def newest(self, robot_id: int) -> ModelDocument | None:
        """The last revision of a robot's model."""
        with self._database.read() as session:
            row = _newest(session, robot_id)
            return None if row is None else rows.document(ModelDocument, row)

    def models(self, robot_id: int | None = None, after: int = 0, limit: int = 100) -> tuple[ModelDocument, ...]:
        """A page of all models, or of one robot's."""
        query = select(t.ModelRow).where(t.ModelRow.id > after).order_by(t.ModelRow.id).limit(limit)
        if robot_id is not None:
            query = query.where(t.ModelRow.robot_id == robot_id)
        with self._database.read() as session:
            return rows.documents(ModelDocument, session, query)


def _newest(session: Session, robot_id: int) -> t.ModelRow | None:
    query = select(t.ModelRow).where(t.ModelRow.robot_id == robot_id).order_by(t.ModelRow.revision.desc()).limit(1)
    return session.scalar(query)
