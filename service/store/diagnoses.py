"""Diagnoses: jobs of their axes, results, and their experiments.

Every method is one transaction and blocks, as in `service.store.store`; raises `NotFound` for what is not there and
`Conflict` if the present state does not allow it. The input of a diagnosis never changes: another one continues it.
"""

from collections.abc import Sequence

from pydantic import JsonValue
from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from service import Conflict
from service.store import table_rows as rows, tables as t
from service.store.documents import (
    BoltedMass,
    CampaignDocument,
    CampaignState,
    DiagnosisDocument,
    DiagnosisEntry,
    DiagnosisState,
    EventKind,
    ExperimentDocument,
    ModelDocument,
    NewDiagnosis,
    NewSweep,
    SweepState,
)

Document = dict[str, JsonValue]
_OPEN = (DiagnosisState.WAITING, DiagnosisState.RUNNING)


class DiagnosisStore(rows.Transactions):
    """Stored diagnoses, their results and experiments."""

    def add(self, new: NewDiagnosis) -> DiagnosisDocument:
        """Add a waiting diagnosis."""
        with self._database.write() as session:
            return rows.document(DiagnosisDocument, _add(session, new))

    def go_on(self, new: NewDiagnosis, kept: Sequence[str]) -> DiagnosisDocument | None:
        """The diagnosis that continues its parent, with the parent's results for the axes in `kept`.

        None, without effect, if the parent was already continued.
        """
        with self._database.write() as session:
            parent = _own(session, new.parent or 0)
            if _child(session, parent.id) is not None:
                return None
            row = _add(session, new)
            for result in parent.results:
                if result.joint in kept:
                    own = {"joint": result.joint, "verdict": result.verdict, "document": result.document}
                    rows.added(session, t.AxisDiagnosisRow(diagnosis_id=row.id, **own))
            return rows.document(DiagnosisDocument, row)

    def diagnosis(self, diagnosis_id: int) -> DiagnosisDocument:
        return self._one(DiagnosisDocument, t.DiagnosisRow, diagnosis_id, "diagnosis")

    def diagnoses(self, after: int = 0, limit: int = 100, machine: str | None = None) -> tuple[DiagnosisEntry, ...]:
        """A page, without the documents; of one machine, or of all."""
        query = rows.page(t.DiagnosisRow, after, limit)
        if machine is not None:
            of_name = select(t.MachineRow.id).where(t.MachineRow.name == machine).scalar_subquery()
            query = query.where(t.DiagnosisRow.machine_id == of_name)
        return self._all(DiagnosisEntry, query)

    def newest_of(self, campaign_id: int) -> DiagnosisDocument | None:
        """The newest finished diagnosis that uses this campaign."""
        done = t.DiagnosisRow.state == DiagnosisState.DONE
        query = select(t.DiagnosisRow.id, t.DiagnosisRow.campaigns).where(done).order_by(t.DiagnosisRow.id.desc())
        with self._database.read() as session:
            number = next((number for number, campaigns in session.execute(query) if campaign_id in campaigns), None)
            return None if number is None else rows.document(DiagnosisDocument, session.get_one(t.DiagnosisRow, number))

    def open(self) -> tuple[DiagnosisEntry, ...]:
        """Waiting and running diagnoses of this service's machine: its open jobs."""
        query = select(t.DiagnosisRow).where(t.DiagnosisRow.state.in_(_OPEN)).order_by(t.DiagnosisRow.id)
        return self._all(DiagnosisEntry, query, own=t.DiagnosisRow.machine_id)

    def results(self, diagnosis_id: int) -> dict[str, Document]:
        """Documents of the finished axes, by joint."""
        with self._database.read() as session:
            diagnosis = rows.get(session, t.DiagnosisRow, diagnosis_id, "diagnosis")
            return {row.joint: row.document for row in diagnosis.results}

    def begin(self, diagnosis_id: int) -> None:
        """waiting -> running; no effect if it already runs."""
        with self._database.write() as session:
            row = _own(session, diagnosis_id)
            if row.state is DiagnosisState.WAITING:
                _move(session, row, DiagnosisState.RUNNING, row.cause)

    def add_result(self, diagnosis_id: int, joint: str, verdict: str, document: Document) -> None:
        """Store the result of an axis; no effect if it exists or the diagnosis is not open."""
        with self._database.write() as session:
            row = _own(session, diagnosis_id)
            if row.state in _OPEN and joint not in row.verdicts:
                new = t.AxisDiagnosisRow(diagnosis_id=diagnosis_id, joint=joint, verdict=verdict, document=document)
                rows.added(session, new)
                _emit(session, row)

    def finish(self, diagnosis_id: int, document: Document) -> None:
        """Mark as done; no effect if it is not open."""
        with self._database.write() as session:
            row = _own(session, diagnosis_id)
            if row.state in _OPEN:
                row.document = document
                _move(session, row, DiagnosisState.DONE, row.cause)

    def fail(self, diagnosis_id: int, cause: str, document: Document | None = None) -> None:
        """Mark as failed permanently; no effect if it is not open. `document`: of the finished axes."""
        with self._database.write() as session:
            row = _own(session, diagnosis_id)
            if row.state in _OPEN:
                row.document = document
                _move(session, row, DiagnosisState.FAILED, cause)

    # experiments

    def approve(
        self,
        diagnosis_id: int,
        axis: str,
        approved_by: str,
        test_mass: BoltedMass | None,
        plan: Document,
        sweeps: Sequence[NewSweep],
    ) -> CampaignDocument:
        """Plan and planned campaign of a diagnosis's next experiment, all or nothing.

        Raises Conflict unless the diagnosis is done and has no experiment except an aborted one.
        """
        with self._database.write() as session:
            row = _own(session, diagnosis_id)
            check_free(rows.document(DiagnosisEntry, row), _experiment_state(session, row))
            made = rows.added(session, t.PlanRow(robot_id=row.robot_id, document=plan))
            campaign = t.CampaignRow(robot_id=row.robot_id, plan_id=made.id, state=CampaignState.PLANNED)
            rows.add_sweeps(session, campaign, sweeps, SweepState.PLANNED)
            rows.emit_campaign(session, campaign)
            experiment = ExperimentDocument(
                axis=axis, campaign_id=campaign.id, approved_by=approved_by, at=t.now(), test_mass=test_mass
            )
            row.experiment, row.experiment_campaign_id = experiment.model_dump(mode="json"), campaign.id
            _emit(session, row)
            return rows.document(CampaignDocument, campaign)

    def experiment_state(self, diagnosis_id: int) -> CampaignState | None:
        """State of the campaign of its experiment, None if it has none."""
        with self._database.read() as session:
            return _experiment_state(session, rows.get(session, t.DiagnosisRow, diagnosis_id, "diagnosis"))

    def to_go_on(self, campaign_id: int | None = None) -> tuple[DiagnosisEntry, ...]:
        """Diagnoses of this machine whose experiment (this campaign; None: any) is completed, not continued yet."""
        child = t.DiagnosisRow.id.in_(select(t.DiagnosisRow.parent).where(t.DiagnosisRow.parent.is_not(None)))
        query = (
            select(t.DiagnosisRow)
            .join(t.CampaignRow, t.CampaignRow.id == t.DiagnosisRow.experiment_campaign_id)
            .where(t.CampaignRow.state == CampaignState.COMPLETED, ~child)
            .order_by(t.DiagnosisRow.id)
        )
        if campaign_id is not None:
            query = query.where(t.CampaignRow.id == campaign_id)
        return self._all(DiagnosisEntry, query, own=t.DiagnosisRow.machine_id)

    def masses(self, campaigns: Sequence[int]) -> dict[int, BoltedMass]:
        """Test masses of those campaigns that were measured with one."""
        query = select(t.DiagnosisRow).where(t.DiagnosisRow.experiment_campaign_id.in_(campaigns))
        with self._database.read() as session:
            found = [rows.document(DiagnosisEntry, row).experiment for row in session.scalars(query)]
        return {one.campaign_id: one.test_mass for one in found if one is not None and one.test_mass is not None}

    def of_experiment(self, campaign_id: int) -> DiagnosisEntry | None:
        """The diagnosis that has this campaign as its experiment."""
        query = select(t.DiagnosisRow).where(t.DiagnosisRow.experiment_campaign_id == campaign_id)
        return self._first(DiagnosisEntry, query)

    def attend(self, cause: str, diagnosis_id: int | None = None) -> None:
        """From now on a person approves experiments: of this diagnosis, or (None) all unattended of this machine."""
        query = select(t.DiagnosisRow).where(t.DiagnosisRow.unattended)
        if diagnosis_id is not None:
            query = query.where(t.DiagnosisRow.id == diagnosis_id)
        with self._database.write() as session:
            query = query.where(t.DiagnosisRow.machine_id == rows.own_id(session))
            for row in session.scalars(query).all():
                if _child(session, row.id) is None:
                    row.unattended = False
                    failed = row.state is DiagnosisState.FAILED  # its cause is stored
                    _move(session, row, row.state, row.cause if failed else cause)


def _own(session: Session, diagnosis_id: int) -> t.DiagnosisRow:
    """One of this service's machine. NotFound, OtherMachine, NoMachine."""
    row = rows.get(session, t.DiagnosisRow, diagnosis_id, "diagnosis")
    rows.check_own(session, row.machine_id, f"diagnosis {diagnosis_id}")
    return row


def _add(session: Session, new: NewDiagnosis) -> t.DiagnosisRow:
    rows.get(session, t.RobotRow, new.robot_id, "robot")
    for campaign in new.campaigns:
        rows.get(session, t.CampaignRow, campaign, "campaign")
    if new.model is not None:
        rows.get(session, t.ModelRow, new.model, "model")
    state = DiagnosisState.WAITING
    row = t.DiagnosisRow(machine_id=rows.own_id(session), state=state, **new.model_dump(mode="json"))
    rows.added(session, row)
    _emit(session, row)
    return row


def _move(session: Session, row: t.DiagnosisRow, state: DiagnosisState, cause: str = "") -> None:
    if state is not row.state and state not in _OPEN:
        row.finished_at = t.now()
    row.state, row.cause = state, cause
    _emit(session, row)


def _emit(session: Session, row: t.DiagnosisRow) -> None:
    data: dict[str, JsonValue] = {
        "diagnosis": row.id,
        "state": row.state.value,
        "cause": row.cause,
        "verdicts": dict[str, JsonValue](row.verdicts),
        "parent": row.parent,
    }
    rows.emit(session, None, EventKind.DIAGNOSIS, data)


def _child(session: Session, diagnosis_id: int) -> int | None:
    return session.scalar(select(t.DiagnosisRow.id).where(t.DiagnosisRow.parent == diagnosis_id))


def _experiment_state(session: Session, row: t.DiagnosisRow) -> CampaignState | None:
    if row.experiment_campaign_id is None:
        return None
    return session.get_one(t.CampaignRow, row.experiment_campaign_id).state


def check_free(diagnosis: DiagnosisEntry, experiment: CampaignState | None) -> None:
    """Raises Conflict unless an experiment of the diagnosis may be approved; `experiment`: state of an earlier one."""
    if diagnosis.state is not DiagnosisState.DONE:
        raise Conflict(
            f"diagnosis {diagnosis.id} is {diagnosis.state.value}; an experiment requires a diagnosis that is done"
        )
    if experiment not in (None, CampaignState.ABORTED) and diagnosis.experiment is not None:
        raise Conflict(
            f"diagnosis {diagnosis.id} already has an experiment, campaign "
            f"{diagnosis.experiment.campaign_id} ({experiment.value}); the next one is proposed by the "
            "diagnosis that continues it"
        )


class ModelStore(rows.Transactions):
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
            newest = session.scalar(_by_revision(diagnosis.robot_id).limit(1))
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
            return rows.document(ModelDocument, rows.added(session, row))

    def model(self, model_id: int) -> ModelDocument:
        return self._one(ModelDocument, t.ModelRow, model_id, "model")

    def newest(self, robot_id: int) -> ModelDocument | None:
        """The last revision of a robot's model."""
        return self._first(ModelDocument, _by_revision(robot_id))

    def models(self, robot_id: int | None = None, after: int = 0, limit: int = 100) -> tuple[ModelDocument, ...]:
        """A page of all models, or of one robot's."""
        query = rows.page(t.ModelRow, after, limit)
        if robot_id is not None:
            query = query.where(t.ModelRow.robot_id == robot_id)
        return self._all(ModelDocument, query)


def _by_revision(robot_id: int) -> Select[t.ModelRow]:
    """The models of a robot, the newest first."""
    return select(t.ModelRow).where(t.ModelRow.robot_id == robot_id).order_by(t.ModelRow.revision.desc())
