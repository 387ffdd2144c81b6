"""Diagnoses: jobs of their axes, results, and the experiments that go on with them.

Every method is one transaction and blocks, as in `service.store.store`; raises `NotFound` for what is not there and
`Conflict` for what does not fit the present state. What a diagnosis is about never changes: another one continues it.
"""

from collections.abc import Sequence

from pydantic import JsonValue
from sqlalchemy import select

from service.errors import Conflict
from service.store import rows
from service.store import tables as t
from service.store.database import Database
from service.store.diagnosis import rows as diagnosis_rows
from service.store.diagnosis_documents import (
    BoltedMass,
    DiagnosisDocument,
    DiagnosisEntry,
    DiagnosisState,
    ExperimentDocument,
    NewDiagnosis,
)
from service.store.documents import CampaignDocument, CampaignState, NewSweep, SweepState

Document = dict[str, JsonValue]
_GONE = (CampaignState.ABORTED,)  # of an experiment that will never tell anything


class DiagnosisStore:
    """The service's memory of what it thought about models that do not fit."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, new: NewDiagnosis) -> DiagnosisDocument:
        """A diagnosis that waits."""
        with self._database.write() as session:
            return diagnosis_rows.document(session, diagnosis_rows.add(session, new))

    def go_on(self, new: NewDiagnosis, kept: Sequence[str]) -> DiagnosisDocument | None:
        """The diagnosis that continues its parent, with the parent's results for the axes in `kept`.

        None, without effect, if the parent was continued before.
        """
        with self._database.write() as session:
            parent = rows.get(session, t.DiagnosisRow, new.parent or 0, "diagnosis")
            if diagnosis_rows.child(session, parent.id) is not None:
                return None
            row = diagnosis_rows.add(session, new)
            for result in diagnosis_rows.results(session, parent.id):
                if result.joint in kept:
                    diagnosis_rows.add_result(session, row.id, result.joint, result.verdict, result.document)
            return diagnosis_rows.document(session, row)

    def diagnosis(self, diagnosis_id: int) -> DiagnosisDocument:
        with self._database.read() as session:
            return diagnosis_rows.document(session, rows.get(session, t.DiagnosisRow, diagnosis_id, "diagnosis"))

    def diagnoses(self, after: int = 0, limit: int = 100) -> tuple[DiagnosisEntry, ...]:
        """A page, without the documents."""
        query = select(t.DiagnosisRow).where(t.DiagnosisRow.id > after).order_by(t.DiagnosisRow.id).limit(limit)
        with self._database.read() as session:
            return tuple(diagnosis_rows.entry(session, row) for row in session.scalars(query))

    def newest_of(self, campaign_id: int) -> DiagnosisDocument | None:
        """The newest diagnosis that is done and has this campaign among its evidence."""
        done = t.DiagnosisRow.state == DiagnosisState.DONE
        query = select(t.DiagnosisRow.id, t.DiagnosisRow.campaigns).where(done).order_by(t.DiagnosisRow.id.desc())
        with self._database.read() as session:
            number = next((number for number, campaigns in session.execute(query) if campaign_id in campaigns), None)
            return None if number is None else diagnosis_rows.document(session, session.get_one(t.DiagnosisRow, number))

    def open(self) -> tuple[DiagnosisEntry, ...]:
        """What waits or runs: the open jobs."""
        query = select(t.DiagnosisRow).where(t.DiagnosisRow.state.in_(diagnosis_rows.OPEN)).order_by(t.DiagnosisRow.id)
        with self._database.read() as session:
            return tuple(diagnosis_rows.entry(session, row) for row in session.scalars(query))

    def results(self, diagnosis_id: int) -> dict[str, Document]:
        """Documents of the axes that are done, by joint."""
        with self._database.read() as session:
            return {row.joint: row.document for row in diagnosis_rows.results(session, diagnosis_id)}

    def begin(self, diagnosis_id: int) -> None:
        """waiting -> running; nothing where it runs already."""
        with self._database.write() as session:
            row = rows.get(session, t.DiagnosisRow, diagnosis_id, "diagnosis")
            if row.state is DiagnosisState.WAITING:
                diagnosis_rows.move(session, row, DiagnosisState.RUNNING, row.cause)

    def add_result(self, diagnosis_id: int, joint: str, verdict: str, document: Document) -> None:
        """The result of an axis; without effect if it came before or nothing waits for it."""
        with self._database.write() as session:
            row = rows.get(session, t.DiagnosisRow, diagnosis_id, "diagnosis")
            if row.state in diagnosis_rows.OPEN and joint not in {
                result.joint for result in diagnosis_rows.results(session, diagnosis_id)
            }:
                diagnosis_rows.add_result(session, diagnosis_id, joint, verdict, document)
                diagnosis_rows.emit(session, row)

    def finish(self, diagnosis_id: int, document: Document) -> None:
        """Done; without effect if nothing waits for it."""
        with self._database.write() as session:
            row = rows.get(session, t.DiagnosisRow, diagnosis_id, "diagnosis")
            if row.state in diagnosis_rows.OPEN:
                row.document = document
                diagnosis_rows.move(session, row, DiagnosisState.DONE, row.cause)

    def fail(self, diagnosis_id: int, cause: str, document: Document | None = None) -> None:
        """Failed, and would another time; without effect if nothing waits for it. `document`: of the axes that did."""
        with self._database.write() as session:
            row = rows.get(session, t.DiagnosisRow, diagnosis_id, "diagnosis")
            if row.state in diagnosis_rows.OPEN:
                row.document = document
                diagnosis_rows.move(session, row, DiagnosisState.FAILED, cause)

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

        Conflict unless the diagnosis is done and has no experiment yet but one that was aborted.
        """
        with self._database.write() as session:
            row = rows.get(session, t.DiagnosisRow, diagnosis_id, "diagnosis")
            check_free(diagnosis_rows.entry(session, row), diagnosis_rows.experiment_state(session, row))
            made = t.PlanRow(robot_id=row.robot_id, document=plan)
            session.add(made)
            session.flush()
            campaign = t.CampaignRow(robot_id=row.robot_id, plan_id=made.id, state=CampaignState.PLANNED)
            rows.add_sweeps(session, campaign, sweeps, SweepState.PLANNED)
            rows.emit_campaign(session, campaign)
            experiment = ExperimentDocument(
                axis=axis, campaign_id=campaign.id, approved_by=approved_by, at=t.now(), test_mass=test_mass
            )
            row.experiment, row.experiment_campaign_id = experiment.model_dump(mode="json"), campaign.id
            diagnosis_rows.emit(session, row)
            return rows.campaign_document(session, campaign)

    def experiment_state(self, diagnosis_id: int) -> CampaignState | None:
        """State of the campaign of its experiment, None if it has none."""
        with self._database.read() as session:
            return diagnosis_rows.experiment_state(
                session, rows.get(session, t.DiagnosisRow, diagnosis_id, "diagnosis")
            )

    def to_go_on(self, campaign_id: int | None = None) -> tuple[DiagnosisEntry, ...]:
        """Diagnoses whose experiment (this campaign; None: any) is completed and that nothing continues yet."""
        child = t.DiagnosisRow.id.in_(select(t.DiagnosisRow.parent_id).where(t.DiagnosisRow.parent_id.is_not(None)))
        query = (
            select(t.DiagnosisRow)
            .join(t.CampaignRow, t.CampaignRow.id == t.DiagnosisRow.experiment_campaign_id)
            .where(t.CampaignRow.state == CampaignState.COMPLETED, ~child)
            .order_by(t.DiagnosisRow.id)
        )
        if campaign_id is not None:
            query = query.where(t.CampaignRow.id == campaign_id)
        with self._database.read() as session:
            return tuple(diagnosis_rows.entry(session, row) for row in session.scalars(query))

    def masses(self, campaigns: Sequence[int]) -> dict[int, BoltedMass]:
        """Of those that were measured with a test mass, which."""
        query = select(t.DiagnosisRow).where(t.DiagnosisRow.experiment_campaign_id.in_(campaigns))
        with self._database.read() as session:
            found = [diagnosis_rows.entry(session, row).experiment for row in session.scalars(query)]
        return {one.campaign_id: one.test_mass for one in found if one is not None and one.test_mass is not None}

    def of_experiment(self, campaign_id: int) -> DiagnosisEntry | None:
        """The diagnosis whose experiment this campaign is."""
        query = select(t.DiagnosisRow).where(t.DiagnosisRow.experiment_campaign_id == campaign_id)
        with self._database.read() as session:
            row = session.scalar(query)
            return None if row is None else diagnosis_rows.entry(session, row)

    def attend(self, cause: str, diagnosis_id: int | None = None) -> None:
        """From here on a person must approve what moves: this diagnosis, or (None) whatever is unattended."""
        query = select(t.DiagnosisRow).where(t.DiagnosisRow.unattended)
        if diagnosis_id is not None:
            query = query.where(t.DiagnosisRow.id == diagnosis_id)
        with self._database.write() as session:
            for row in session.scalars(query).all():
                if diagnosis_rows.child(session, row.id) is None:
                    row.unattended = False
                    failed = row.state is DiagnosisState.FAILED  # and its cause says why
                    diagnosis_rows.move(session, row, row.state, row.cause if failed else cause)


def check_free(diagnosis: DiagnosisEntry, experiment: CampaignState | None) -> None:
    """Conflict unless an experiment of the diagnosis may be approved; `experiment`: state of one that was before."""
    if diagnosis.state is not DiagnosisState.DONE:
        raise Conflict(f"diagnosis {diagnosis.id} is {diagnosis.state.value}; an experiment follows one that is done")
    if experiment is not None and experiment not in _GONE and diagnosis.experiment is not None:
        raise Conflict(
            f"diagnosis {diagnosis.id} has its experiment, campaign {diagnosis.experiment.campaign_id} "
            f"({experiment.value}); what continues the diagnosis proposes the next one"
        )
