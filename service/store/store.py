"""Robots, plans, campaigns, sweeps, recordings and estimates in the database.

Every method is one transaction; methods block (SQLite waits for the disk), so a coroutine calls them in a thread.
Raises `NotFound` for what is not there, `Conflict` (from a move) for what does not fit the present state.
A page of a list is what has an id (number, revision) above `after`, in that order, at most `limit`.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType
from typing import cast

from pydantic import JsonValue
from sqlalchemy import func, select

from drivers.errors import Cause
from service import Conflict, NotFound
from service.model import Robot, SweepSpec
from service.store import table_rows as rows, tables as t
from service.store.documents import (
    CampaignDocument,
    CampaignState,
    EstimateDocument,
    EstimateOf,
    EventDocument,
    EventKind,
    NewRecording,
    NewSweep,
    PlanRecord,
    Recorded,
    RecordingDocument,
    RecordingState,
    RobotDocument,
    SpectrumRecord,
    SweepDocument,
    SweepState,
    SweepStatus,
    robot_sha256,
)

CampaignMove = Callable[[CampaignState], CampaignState]
SweepMove = Callable[[SweepState], SweepState]


class StaleVersion(Conflict):
    """The campaign has changed since the client read it (API: 412)."""


class Store(rows.Transactions):
    """The service's memory."""

    # robots and plans: written once, never changed

    def add_robot(self, robot: Robot) -> RobotDocument:
        """The same content gives the same row."""
        sha256 = robot_sha256(robot.description, robot.urdf_text)
        with self._database.write() as session:
            row = session.scalar(select(t.RobotRow).where(t.RobotRow.sha256 == sha256))
            if row is None:
                row = t.RobotRow(
                    sha256=sha256,
                    name=robot.name,
                    serial=robot.description.serial,
                    revision=robot.description.revision,
                    description=robot.description.model_dump(mode="json"),
                    urdf_text=robot.urdf_text,
                )
                rows.added(session, row)
            return rows.document(RobotDocument, row)

    def robot(self, robot_id: int) -> RobotDocument:
        return self._one(RobotDocument, t.RobotRow, robot_id, "robot")

    def robots(self, after: int = 0, limit: int = 100) -> tuple[RobotDocument, ...]:
        return self._all(RobotDocument, rows.page(t.RobotRow, after, limit))

    def add_plan(self, robot_id: int, document: dict[str, JsonValue]) -> PlanRecord:
        with self._database.write() as session:
            rows.get(session, t.RobotRow, robot_id, "robot")
            return rows.document(PlanRecord, rows.added(session, t.PlanRow(robot_id=robot_id, document=document)))

    def plan(self, plan_id: int) -> PlanRecord:
        return self._one(PlanRecord, t.PlanRow, plan_id, "plan")

    def plan_request(self, plan_id: int) -> Mapping[str, JsonValue]:
        """The request of a plan, without its sweeps; {} if there is none."""
        with self._database.read() as session:
            found = session.scalar(select(t.PlanRow.document["request"]).where(t.PlanRow.id == plan_id))
        return cast("Mapping[str, JsonValue] | None", found) or {}

    def plans(self, after: int = 0, limit: int = 100) -> tuple[PlanRecord, ...]:
        return self._all(PlanRecord, rows.page(t.PlanRow, after, limit))

    # campaigns and sweeps: read

    def campaign(self, campaign_id: int) -> CampaignDocument:
        return self._one(CampaignDocument, t.CampaignRow, campaign_id, "campaign")

    def own_campaign(self, campaign_id: int) -> CampaignDocument:
        """As `campaign`, for one of this service's machine. Raises OtherMachine, NoMachine."""
        with self._database.read() as session:
            return rows.document(CampaignDocument, rows.own_campaign(session, campaign_id))

    def campaigns(self, after: int = 0, limit: int = 100) -> tuple[CampaignDocument, ...]:
        return self._all(CampaignDocument, rows.page(t.CampaignRow, after, limit))

    def campaigns_in(self, *states: CampaignState) -> tuple[CampaignDocument, ...]:
        """Of this service's machine."""
        query = select(t.CampaignRow).where(t.CampaignRow.state.in_(states)).order_by(t.CampaignRow.id)
        return self._all(CampaignDocument, query, own=t.CampaignRow.machine_id)

    def sweep(self, campaign_id: int, number: int) -> SweepDocument:
        with self._database.read() as session:
            return rows.document(SweepDocument, rows.get_sweep(session, campaign_id, number))

    def sweeps(self, campaign_id: int) -> tuple[SweepDocument, ...]:
        query = select(t.SweepRow).where(t.SweepRow.campaign_id == campaign_id).order_by(t.SweepRow.number)
        with self._database.read() as session:
            rows.get(session, t.CampaignRow, campaign_id, "campaign")
            return rows.documents(SweepDocument, session, query)

    def sweep_statuses(self, campaign_id: int) -> tuple[SweepStatus, ...]:
        """Of all sweeps, in the order of the plan; no spec is read for it."""
        sweep = t.SweepRow
        started_at = sweep.spec["started_at"].as_float()
        query = select(sweep.number, sweep.state, sweep.attempt, started_at)
        with self._database.read() as session:
            found = session.execute(query.where(sweep.campaign_id == campaign_id).order_by(sweep.number))
            return tuple(SweepStatus(*row) for row in found)

    def sweeps_in(self, state: SweepState) -> tuple[SweepDocument, ...]:
        """Of all campaigns of this service's machine; RECORDED gives its open identification jobs."""
        query = select(t.SweepRow).join(t.CampaignRow, t.CampaignRow.id == t.SweepRow.campaign_id)
        query = query.where(t.SweepRow.state == state).order_by(t.SweepRow.id)
        return self._all(SweepDocument, query, own=t.CampaignRow.machine_id)

    def recording(self, campaign_id: int, number: int) -> RecordingDocument:
        """Of the latest attempt that has one."""
        with self._database.read() as session:
            of_it = t.RecordingRow.sweep_id == rows.get_sweep(session, campaign_id, number).id
            row = session.scalar(select(t.RecordingRow).where(of_it).order_by(t.RecordingRow.attempt.desc()).limit(1))
            if row is None:
                raise NotFound(f"campaign {campaign_id} sweep {number} has no recording")
            return rows.document(RecordingDocument, row)

    def recorded_sweeps(
        self, campaign_id: int, states: Collection[SweepState]
    ) -> list[tuple[SweepSpec, RecordingDocument]]:
        """The sweeps of a campaign that are in these states and their recordings, by number."""
        recordings = self.recordings(campaign_id)
        return [(sweep.spec, recordings[sweep.number]) for sweep in self.sweeps(campaign_id) if sweep.state in states]

    def recordings(self, campaign_id: int) -> dict[int, RecordingDocument]:
        """Of every sweep that has one, by number: that of its latest attempt."""
        query = (
            select(t.RecordingRow)
            .join(t.SweepRow, t.SweepRow.id == t.RecordingRow.sweep_id)
            .where(t.SweepRow.campaign_id == campaign_id)
            .order_by(t.SweepRow.number, t.RecordingRow.attempt)
        )
        return {recording.number: recording for recording in self._all(RecordingDocument, query)}

    def spectra(self, campaign_id: int) -> tuple[SpectrumRecord, ...]:
        """Of the identified sweeps, by number."""
        query = (
            select(t.SpectrumRow.path, t.SpectrumRow.sha256)
            .join(t.SweepRow, t.SpectrumRow.sweep_id == t.SweepRow.id)
            .where(t.SweepRow.campaign_id == campaign_id)
            .order_by(t.SweepRow.number)
        )
        with self._database.read() as session:
            return tuple(SpectrumRecord(path=path, sha256=sha256) for path, sha256 in session.execute(query))

    def estimate(self, campaign_id: int, revision: int | None = None) -> EstimateDocument:
        """A revision, or the latest."""
        query = select(t.EstimateRow).where(t.EstimateRow.campaign_id == campaign_id)
        query = query.order_by(t.EstimateRow.revision.desc())
        if revision is not None:
            query = query.where(t.EstimateRow.revision == revision)
        found = self._first(EstimateDocument, query)
        if found is None:
            which = "estimate" if revision is None else f"estimate revision {revision}"
            raise NotFound(f"campaign {campaign_id} has no {which}")
        return found

    def estimated(self, robot_id: int) -> tuple[EstimateOf, ...]:
        """The latest revision of each campaign of a robot that has an estimate, the newest first."""
        query = (
            select(t.EstimateRow.campaign_id, func.max(t.EstimateRow.revision))
            .join(t.CampaignRow, t.CampaignRow.id == t.EstimateRow.campaign_id)
            .where(t.CampaignRow.robot_id == robot_id)
            .group_by(t.EstimateRow.campaign_id)
            .order_by(func.max(t.EstimateRow.id).desc())
        )
        with self._database.read() as session:
            return tuple(EstimateOf(campaign_id=number, revision=last) for number, last in session.execute(query))

    def latest_estimates(self) -> dict[str, EstimateOf]:
        """The newest revision of each robot by its name: robot files of one name are one robot."""
        newest = (
            select(func.max(t.EstimateRow.id))
            .join(t.CampaignRow, t.CampaignRow.id == t.EstimateRow.campaign_id)
            .join(t.RobotRow, t.RobotRow.id == t.CampaignRow.robot_id)
            .group_by(t.RobotRow.name)
        )
        query = (
            select(t.RobotRow.name, t.EstimateRow.campaign_id, t.EstimateRow.revision)
            .join(t.CampaignRow, t.CampaignRow.id == t.EstimateRow.campaign_id)
            .join(t.RobotRow, t.RobotRow.id == t.CampaignRow.robot_id)
            .where(t.EstimateRow.id.in_(newest))
            .order_by(t.RobotRow.name)
        )
        with self._database.read() as session:
            found = session.execute(query)
            return {name: EstimateOf(campaign_id=number, revision=revision) for name, number, revision in found}

    def estimates(self, campaign_id: int, after: int = 0, limit: int = 100) -> tuple[EstimateDocument, ...]:
        row = t.EstimateRow
        query = select(row).where(row.campaign_id == campaign_id, row.revision > after).order_by(row.revision)
        return self._all(EstimateDocument, query.limit(limit))

    def base_parameters(self, campaign_id: int, revisions: Sequence[int]) -> dict[int, JsonValue]:
        """ "base_parameters" of these revisions; the rest of their documents, which is large, is not read."""
        query = (
            select(t.EstimateRow.revision, t.EstimateRow.document["base_parameters"])
            .where(t.EstimateRow.campaign_id == campaign_id, t.EstimateRow.revision.in_(revisions))
            .order_by(t.EstimateRow.revision)
        )
        with self._database.read() as session:
            return dict(session.execute(query).all())

    def confidences(self, campaign_id: int, joints: Sequence[str]) -> list[Sequence[JsonValue]]:
        """Revision, its sweep, then "confidence_percent" of each joint; the large documents are not read."""
        axes, revision = t.EstimateRow.document["axes"], t.EstimateRow.revision
        query = select(revision, t.SweepRow.number, *(axes[one]["confidence_percent"] for one in joints))
        query = query.join(t.SweepRow, t.SweepRow.id == t.EstimateRow.sweep_id).order_by(revision)
        with self._database.read() as session:
            found = session.execute(query.where(t.EstimateRow.campaign_id == campaign_id))
            return [tuple(row) for row in found]

    # campaigns and sweeps: write

    def add_campaign(self, plan_id: int, sweeps: Sequence[NewSweep]) -> CampaignDocument:
        """A campaign in state `planned` with its sweeps, numbered from 1."""
        with self._database.write() as session:
            plan = rows.get(session, t.PlanRow, plan_id, "plan")
            campaign = t.CampaignRow(robot_id=plan.robot_id, plan_id=plan_id, state=CampaignState.PLANNED)
            rows.add_sweeps(session, campaign, sweeps, SweepState.PLANNED)
            rows.emit_campaign(session, campaign)
            return rows.document(CampaignDocument, campaign)

    def add_measured(
        self, robot_id: int, sweeps: Sequence[NewSweep], recordings: Sequence[NewRecording]
    ) -> CampaignDocument:
        """A campaign measured elsewhere, every sweep with its recording, ready to be identified."""
        with self._database.write() as session:
            rows.get(session, t.RobotRow, robot_id, "robot")
            campaign = t.CampaignRow(robot_id=robot_id, state=CampaignState.MEASURED, started_at=t.now())
            new = rows.add_sweeps(session, campaign, sweeps, SweepState.RECORDED)
            for row, recording in zip(new, recordings, strict=True):
                session.add(t.RecordingRow(sweep_id=row.id, attempt=row.attempt, **recording.model_dump()))
            rows.emit_campaign(session, campaign)
            return rows.document(CampaignDocument, campaign)

    def move_campaign(
        self,
        campaign_id: int,
        move: CampaignMove,
        cause: Cause | None = None,
        if_version: int | None = None,
        sweeps: Mapping[SweepState, SweepMove] = MappingProxyType({}),
    ) -> CampaignDocument:
        """Take the campaign to the state that `move` gives, and its sweeps in the states of `sweeps` with it.

        StaleVersion if `if_version` is not the present one.
        """
        with self._database.write() as session:
            row = rows.own_campaign(session, campaign_id)
            if if_version is not None and if_version != row.version:
                raise StaleVersion(f"campaign {campaign_id} is at version {row.version}, not {if_version}")
            row.state = move(row.state)
            rows.set_cause(row, cause)
            row.version += 1
            if row.state is CampaignState.RUNNING and row.started_at is None:
                row.started_at = t.now()
            query = select(t.SweepRow).where(t.SweepRow.campaign_id == campaign_id, t.SweepRow.state.in_(sweeps))
            for sweep in session.scalars(query.order_by(t.SweepRow.number)).all():
                rows.move_sweep(session, sweep, sweeps[sweep.state], cause)
            rows.emit_campaign(session, row)
            return rows.document(CampaignDocument, row)

    def begin_sweep(self, campaign_id: int, number: int, move: SweepMove, last_attempt: int = 0) -> SweepDocument:
        """As `move_sweep`, and count the attempt, on from `last_attempt` on disk. Committed before anything moves."""
        with self._database.write() as session:
            row = rows.own_sweep(session, campaign_id, number)
            row.attempt = max(row.attempt, last_attempt) + 1
            return rows.move_sweep(session, row, move, None)

    def move_sweep(self, campaign_id: int, number: int, move: SweepMove, cause: Cause | None = None) -> SweepDocument:
        with self._database.write() as session:
            return rows.move_sweep(session, rows.own_sweep(session, campaign_id, number), move, cause)

    def end_sweep(
        self,
        campaign_id: int,
        number: int,
        move: SweepMove,
        cause: Cause | None = None,
        spec: SweepSpec | None = None,
        recording: NewRecording | None = None,
    ) -> SweepDocument:
        """The end of a run: state, what was measured and its file. A sweep that is `recorded` now is an open job."""
        with self._database.write() as session:
            row = rows.own_sweep(session, campaign_id, number)
            if spec is not None:
                row.spec = spec.model_dump(mode="json")
            if recording is not None:
                session.add(t.RecordingRow(sweep_id=row.id, attempt=row.attempt, **recording.model_dump()))
            return rows.move_sweep(session, row, move, cause)

    def add_recording(self, campaign_id: int, number: int, attempt: int, recording: NewRecording) -> None:
        """A recording that was saved after its run had ended."""
        with self._database.write() as session:
            sweep = rows.own_sweep(session, campaign_id, number)
            session.add(t.RecordingRow(sweep_id=sweep.id, attempt=attempt, **recording.model_dump()))

    def add_estimate(
        self,
        identified: Sequence[tuple[SweepDocument, SpectrumRecord]],
        move: SweepMove,
        document: dict[str, JsonValue],
    ) -> EstimateDocument | None:
        """The result of a job: spectra, next estimate revision, states of the sweeps and events, all or nothing.

        The revision belongs to the last of the sweeps, which are of one campaign. The revision before it gives up the
        values of single sweeps, which the new one has as well. None, without effect, unless all of the sweeps still
        wait to be identified: a result that is received twice counts once.
        """
        with self._database.write() as session:
            found: list[t.SweepRow] = []
            for sweep, _ in identified:
                row = rows.own_sweep(session, sweep.campaign_id, sweep.number)
                if row.state is not SweepState.RECORDED or row.attempt != sweep.attempt:
                    return None
                found.append(row)
            last = found[-1]
            earlier = select(t.EstimateRow).where(t.EstimateRow.campaign_id == last.campaign_id)
            before = session.scalars(earlier.order_by(t.EstimateRow.revision.desc()).limit(1)).first()
            if before is not None:
                before.document = _without_sweeps(before.document)
            revision = 1 if before is None else before.revision + 1
            estimate = t.EstimateRow(
                campaign_id=last.campaign_id, revision=revision, sweep_id=last.id, document=document
            )
            session.add(estimate)
            data: dict[str, JsonValue] = {"revision": revision, "sweep": last.number}
            rows.emit(session, last.campaign_id, EventKind.ESTIMATE, data)
            for row, (_, spectrum) in zip(found, identified, strict=True):
                session.add(t.SpectrumRow(sweep_id=row.id, **spectrum.model_dump()))
                rows.move_sweep(session, row, move, None)
            session.flush()
            return rows.document(EstimateDocument, estimate)

    def replace_estimate(self, campaign_id: int, revision: int, document: dict[str, JsonValue]) -> None:
        """Another document of a revision, told as a new one is."""
        query = select(t.EstimateRow).where(
            t.EstimateRow.campaign_id == campaign_id, t.EstimateRow.revision == revision
        )
        with self._database.write() as session:
            rows.own_campaign(session, campaign_id)
            estimate = session.scalars(query).one()
            estimate.document = document
            data: dict[str, JsonValue] = {"revision": revision, "sweep": estimate.number}
            rows.emit(session, campaign_id, EventKind.ESTIMATE, data)

    # outbox

    def add_check_move(self, campaign_id: int, number: int, axis: str, way: float, unit: str) -> None:
        """Tell that an axis is about to make its check move before the sweep `number`: `way` in `unit`, rad (m)."""
        data: dict[str, JsonValue] = {"number": number, "axis": axis, "way": way, "unit": unit}
        with self._database.write() as session:
            rows.own_campaign(session, campaign_id)
            rows.emit(session, campaign_id, EventKind.CHECK_MOVE, data)

    def events(self, after: int, campaign_id: int | None = None, limit: int = 100) -> tuple[EventDocument, ...]:
        """Events of one campaign (with the stops of its machine) or of all."""
        query = select(t.EventRow).where(t.EventRow.id > after).order_by(t.EventRow.id).limit(limit)
        if campaign_id is not None:
            query = query.where((t.EventRow.campaign_id == campaign_id) | rows.stops_of_machine_of(campaign_id))
        return self._all(EventDocument, query)

    def recorded(self) -> dict[RecordingState, Recorded]:
        """How many recordings there are of each state, with their samples."""
        row = t.RecordingRow
        query = select(row.state, func.count(), func.sum(row.samples)).group_by(row.state)
        with self._database.read() as session:
            return {state: Recorded(count, samples) for state, count, samples in session.execute(query)}

    def last_event_id(self) -> int:
        """0 if there was none yet."""
        with self._database.read() as session:
            return session.scalar(select(func.max(t.EventRow.id))) or 0


Document = dict[str, JsonValue]

OVER = (CampaignState.MEASURED, CampaignState.COMPLETED, CampaignState.ABORTED)
COMPLETE = (SweepState.RECORDED, SweepState.IDENTIFIED)


class CheckStore(rows.Transactions):
    """Every method is one transaction and blocks, as in `service.store.store`."""

    def document(self, campaign_id: int) -> Document | None:
        """Findings as in `sweepid check --json`; None if there are none yet."""
        query = select(t.DataCheckRow.document).where(t.DataCheckRow.campaign_id == campaign_id)
        with self._database.read() as session:
            return session.scalar(query)

    def add(self, campaign_id: int, document: Document) -> None:
        """Store the result of a job, with its event; a second result of the same campaign is ignored."""
        with self._database.write() as session:
            rows.own_campaign(session, campaign_id)
            if session.scalar(select(t.DataCheckRow.id).where(t.DataCheckRow.campaign_id == campaign_id)) is not None:
                return
            session.add(t.DataCheckRow(campaign_id=campaign_id, document=document))
            rows.emit(session, campaign_id, EventKind.DATA_CHECK, {})

    def wanting(self, campaign_id: int | None = None) -> tuple[int, ...]:
        """Finished campaigns of this machine (or this one) with complete sweeps that were not checked."""
        query = (
            select(t.CampaignRow.id)
            .join(t.SweepRow, t.SweepRow.campaign_id == t.CampaignRow.id)
            .outerjoin(t.DataCheckRow, t.DataCheckRow.campaign_id == t.CampaignRow.id)
            .where(t.CampaignRow.state.in_(OVER), t.SweepRow.state.in_(COMPLETE), t.DataCheckRow.id.is_(None))
            .distinct()
            .order_by(t.CampaignRow.id)
        )
        if campaign_id is not None:
            query = query.where(t.CampaignRow.id == campaign_id)
        with self._database.read() as session:
            return tuple(session.scalars(query.where(rows.of_own(session))))


def _without_sweeps(document: dict[str, JsonValue]) -> dict[str, JsonValue]:
    """Of an estimate: all but what grows with the number of sweeps."""
    axes = cast("dict[str, dict[str, JsonValue]]", document.get("axes", {}))
    return {**document, "axes": {joint: {**axis, "inertia": []} for joint, axis in axes.items()}}
