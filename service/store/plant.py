"""The machines of a plant, its measured robots, and batches: computations over many stored campaigns.

Every method is one transaction and blocks, as in `service.store.store`; `NotFound` if the id does not exist.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, TypeVar

from pydantic import JsonValue
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from service import BadInput, Conflict, NotFound
from service.model.results.estimate import Estimate
from service.model.results.part import JsonOf
from service.model.results.payload import Payload
from service.store import table_rows as rows, tables as t
from service.store.database import Database
from service.store.documents import BatchState, CampaignState, EstimateDocument, EventKind, StoredDocument, SweepState
from service.store.store import OVER, Store


class MachineDocument(StoredDocument):
    """A machine of the plant, with robot and cell as its service has them configured; null: not configured.

    `here`: it is the machine of this service. `robot`: the robot's name.
    """

    name: str
    here: bool
    robot_id: int | None
    robot: str | None
    cell: str | None


class PlantStore(rows.Transactions):
    """Every method is one transaction and blocks."""

    def machines(self) -> tuple[MachineDocument, ...]:
        """In the order in which they were added."""
        machine, robot = t.MachineRow, t.RobotRow
        query = select(machine.id, machine.name, machine.robot_id, robot.name, machine.cell)
        query = query.outerjoin(robot, robot.id == machine.robot_id).order_by(machine.id)
        with self._database.read() as session:
            own = rows.owned(session)
            return tuple(
                MachineDocument(name=name, here=own is not None and own.id == key, robot_id=number, robot=of, cell=cell)
                for key, name, number, of, cell in session.execute(query)
            )

    def configure(self, robot_id: int | None, cell: str | None) -> None:
        """Store robot and cell of this service's machine, if they have changed. Raises NoMachine."""
        with self._database.write(quiet=True) as session:
            row = rows.get(session, t.MachineRow, rows.own_id(session), "machine")
            row.robot_id, row.cell = robot_id, cell

    def campaigns(self) -> dict[tuple[str, CampaignState], int]:
        """Number of campaigns by machine and state; states without campaigns are omitted."""
        machine, campaign = t.MachineRow, t.CampaignRow
        query = (
            select(machine.name, campaign.state, func.count())
            .join(campaign, campaign.machine_id == machine.id)
            .group_by(machine.name, campaign.state)
        )
        with self._database.read() as session:
            return {(name, state): count for name, state, count in session.execute(query)}

    def stops_held(self) -> dict[str, int]:
        """Number of stops that hold each machine; 0 for a machine without one."""
        machine, stop = t.MachineRow, t.StopRow
        held = (stop.machine_id == machine.id) & stop.reset_at.is_(None)
        query = select(machine.name, func.count(stop.id)).outerjoin(stop, held).group_by(machine.name)
        with self._database.read() as session:
            return dict(session.execute(query).all())


@dataclass(frozen=True, slots=True)
class RobotNamed:
    """A robot of a plant. `serial`: None if its file has none; then the machine identifies the robot."""

    name: str
    serial: str | None
    machine: str


@dataclass(frozen=True, slots=True)
class MeasuredCampaign:
    """A campaign that measured a robot, and the newest revision of its estimate. `at`: its start."""

    id: int
    revision: int
    robot: RobotNamed
    at: datetime


class FleetStore:
    """Reads only; every method is one transaction and blocks."""

    def __init__(self, database: Database) -> None:
        self._database, self._store = database, Store(database)

    def types(self) -> tuple[str, ...]:
        """Names of the robots in the database, sorted: robots with one name are of one type."""
        with self._database.read() as session:
            return tuple(session.scalars(select(t.RobotRow.name).distinct().order_by(t.RobotRow.name)))

    def serials(self, name: str) -> tuple[str, ...]:
        """Serial numbers of the robots with this name that have one, measured or not."""
        row = t.RobotRow
        query = select(row.serial).distinct().where(row.name == name, row.serial.is_not(None)).order_by(row.serial)
        with self._database.read() as session:
            return tuple(serial for serial in session.scalars(query) if serial is not None)

    def measured(self, name: str) -> tuple[MeasuredCampaign, ...]:
        """Finished campaigns with an estimate of robots with this name, the oldest first.

        Imported ones and those of plans for the inertia. Not those of an initial analysis, of a trajectory, or of a
        diagnosis, whose experiments may have a test mass on the robot.
        """
        campaign, robot, plan = t.CampaignRow, t.RobotRow, t.PlanRow
        at = func.coalesce(campaign.started_at, campaign.created_at)
        newest = (
            select(t.EstimateRow.campaign_id, func.max(t.EstimateRow.revision).label("revision"))
            .group_by(t.EstimateRow.campaign_id)
            .subquery()
        )
        query = (
            select(
                campaign.id,
                newest.c.revision,
                robot.name,
                robot.serial,
                t.MachineRow.name,
                campaign.started_at,
                campaign.created_at,
            )
            .join(newest, newest.c.campaign_id == campaign.id)
            .join(robot, robot.id == campaign.robot_id)
            .join(t.MachineRow, t.MachineRow.id == campaign.machine_id)
            .outerjoin(plan, plan.id == campaign.plan_id)
            .where(robot.name == name, campaign.state.in_((CampaignState.MEASURED, CampaignState.COMPLETED)))
            .where(plan.document["request"]["kind"].as_string().is_(None))
            .order_by(at, campaign.id)
        )
        with self._database.read() as session:
            return tuple(
                MeasuredCampaign(number, revision, RobotNamed(robot_name, serial, machine), started or created)
                for number, revision, robot_name, serial, machine, started, created in session.execute(query)
            )

    def estimate(self, campaign: MeasuredCampaign) -> EstimateDocument:
        """Raises NotFound if it was removed meanwhile."""
        return self._store.estimate(campaign.id, campaign.revision)

    def poses(self, campaign_id: int) -> dict[str, tuple[float, ...]]:
        """Poses of a campaign's sweeps, rad (m), by the name of the sweep."""
        return {sweep.spec.id: sweep.spec.pose for sweep in self._store.sweeps(campaign_id)}


_UNFINISHED = (BatchState.WAITING, BatchState.RUNNING)


class BatchDocument(StoredDocument):
    """A batch and its progress: `done` of `campaigns`, `failed` of them without a result, `sweeps` identified again.

    `machine`: the name of the machine whose service computes it. `here`: it is the machine of this service.
    """

    id: int
    machine: str
    here: bool
    kind: str
    asked_by: str
    state: BatchState
    campaigns: int
    done: int
    failed: int
    sweeps: int
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None


class BatchEntry(StoredDocument):
    """A campaign of a batch. `change_percent`: largest change of J of any sweep relative to the stored estimate.

    `cause`: why there is no result; empty if there is one.
    """

    campaign_id: int
    sweeps: int
    change_percent: float | None
    cause: str
    at: datetime


class BatchEstimate(BatchEntry):
    """A campaign of a batch with the estimate's `document`, as `identify --json`; null if there is none."""

    document: Annotated[dict[str, JsonValue], JsonOf(Estimate)] | None


class PayloadEntry(StoredDocument):
    """The payload that the robot carried in campaign `after` and not in `before`; `machine`, `here` as of a job.

    `cause`: why there is no result although it is done; empty if there is one.
    """

    id: int
    machine: str
    here: bool
    before: int
    after: int
    asked_by: str
    state: BatchState
    cause: str
    created_at: datetime
    finished_at: datetime | None


class PayloadDocument(PayloadEntry):
    """A payload with its `document`, as `sweepid estimate payload --json` prints it, once it is done."""

    document: Annotated[dict[str, JsonValue], JsonOf(Payload)] | None

    @property
    def found(self) -> Payload:
        """Content of `document`. Raises Conflict if there is none, BadInput."""
        if self.document is None:
            raise Conflict(f"payload {self.id} has no result: {self.cause or self.state.value}")
        return Payload.read(self.document, f"payload {self.id}")


_REIDENTIFY, _PAYLOAD = "reidentify", "payload"  # kinds of a batch


class BatchStore(rows.Transactions):
    """Batches of the plant; only those of this service's machine are changed."""

    def add(self, campaigns: Sequence[int] | None, asked_by: str) -> BatchDocument:
        """A waiting batch of these campaigns of this machine, or (None) all finished. BadInput if there is none."""
        with self._database.write() as session:
            own = select(t.CampaignRow.id).where(rows.of_own(session), t.CampaignRow.state.in_(OVER))
            identified = select(t.SweepRow.campaign_id).where(t.SweepRow.state == SweepState.IDENTIFIED)
            usable = set(session.scalars(own.where(t.CampaignRow.id.in_(identified))))
            for number in campaigns or ():
                rows.own_campaign(session, number)
                if number not in usable:
                    raise BadInput("campaigns", f"campaign {number} has not ended, or has no identified sweep")
            wanted = sorted(usable if campaigns is None else set(campaigns))
            if not wanted:
                raise BadInput("campaigns", "this machine has no campaign that has ended and has an identified sweep")
            return _document(session, _added(session, _REIDENTIFY, wanted, asked_by))

    def add_payload(self, before: int, after: int, asked_by: str) -> PayloadDocument:
        """A waiting batch of a payload. BadInput unless the campaigns are completed, of one plan and this machine."""
        with self._database.write() as session:
            first = _completed(session, "before", before)
            second = _completed(session, "after", after)
            for what, own, other in (
                ("robot", first.robot_id, second.robot_id),
                ("plan", first.plan_id or "none, imported", second.plan_id or "none, imported"),
            ):
                if own != other:
                    raise BadInput(
                        "after",
                        f"campaign {after} has {what} {other}, campaign {before} has {what} {own}, must be the same: "
                        f"measure the plan of campaign {before} again with the payload",
                    )
            if before == after:
                raise BadInput("after", f"is {after}, as `before`: name the campaign with the payload")
            return _payload(PayloadDocument, session, _added(session, _PAYLOAD, [before, after], asked_by))

    def payload(self, payload_id: int) -> PayloadDocument:
        with self._database.read() as session:
            return _payload(PayloadDocument, session, _of_kind(session, _PAYLOAD, payload_id))

    def payloads(self, after: int = 0, limit: int = 100) -> tuple[PayloadEntry, ...]:
        """Without their documents."""
        query = rows.page(t.BatchRow, after, limit).where(t.BatchRow.kind == _PAYLOAD)
        with self._database.read() as session:
            return tuple(_payload(PayloadEntry, session, row) for row in session.scalars(query))

    def before(self, batch_id: int) -> int | None:
        """Of a payload, the campaign without it; None for other batches."""
        with self._database.read() as session:
            row = rows.get(session, t.BatchRow, batch_id, "job")
            return row.campaigns[0] if row.kind == _PAYLOAD else None

    def batch(self, batch_id: int) -> BatchDocument:
        with self._database.read() as session:
            return _document(session, _of_kind(session, _REIDENTIFY, batch_id))

    def batches(self, after: int = 0, limit: int = 100) -> tuple[BatchDocument, ...]:
        query = rows.page(t.BatchRow, after, limit).where(t.BatchRow.kind == _REIDENTIFY)
        with self._database.read() as session:
            return tuple(_document(session, row) for row in session.scalars(query))

    def open(self) -> tuple[int, ...]:
        """Batches of this machine that are not finished."""
        query = select(t.BatchRow.id).where(t.BatchRow.state.in_(_UNFINISHED)).order_by(t.BatchRow.id)
        with self._database.read() as session:
            return tuple(session.scalars(query.where(t.BatchRow.machine_id == rows.own_id(session))))

    def begin(self, batch_id: int) -> tuple[int, ...]:
        """Its campaigns without a result (of a payload, `after`); the batch then runs. () if it is finished."""
        with self._database.write() as session:
            row = _own(session, batch_id)
            if row.state not in _UNFINISHED:
                return ()
            if row.state is BatchState.WAITING:
                row.state, row.started_at = BatchState.RUNNING, t.now()
                _with_event(session, row)
            done = set(
                session.scalars(select(t.BatchResultRow.campaign_id).where(t.BatchResultRow.batch_id == batch_id))
            )
            wanted = row.campaigns[1:] if row.kind == _PAYLOAD else row.campaigns
            return tuple(number for number in wanted if number not in done)

    def add_result(
        self,
        batch_id: int,
        campaign_id: int,
        sweeps: int,
        document: dict[str, JsonValue] | None,
        change_percent: float | None = None,
        cause: str = "",
    ) -> None:
        """Store the result of one campaign; no effect if it exists, or the batch is finished."""
        with self._database.write() as session:
            row = _own(session, batch_id)
            there = select(t.BatchResultRow.id).where(
                t.BatchResultRow.batch_id == batch_id, t.BatchResultRow.campaign_id == campaign_id
            )
            if row.state not in _UNFINISHED or session.scalar(there) is not None:
                return
            found = {"sweeps": sweeps, "document": document, "change_percent": change_percent, "cause": cause}
            rows.added(session, t.BatchResultRow(batch_id=batch_id, campaign_id=campaign_id, **found))
            _with_event(session, row)

    def end(self, batch_id: int, state: BatchState) -> BatchDocument:
        """Set `done` or `cancelled`; a finished batch does not change."""
        with self._database.write() as session:
            row = _own(session, batch_id)
            if row.state not in _UNFINISHED:
                return _document(session, row)
            row.state, row.finished_at = state, t.now()
            return _with_event(session, row)

    def results(self, batch_id: int, after: int = 0, limit: int = 100) -> tuple[BatchEntry, ...]:
        """By campaign, without their documents."""
        row = t.BatchResultRow
        query = select(row).where(row.batch_id == batch_id, row.campaign_id > after)
        with self._database.read() as session:
            _of_kind(session, _REIDENTIFY, batch_id)
            return rows.documents(BatchEntry, session, query.order_by(row.campaign_id).limit(limit))

    def result(self, batch_id: int, campaign_id: int) -> BatchEstimate:
        self.batch(batch_id)
        row = t.BatchResultRow
        query = select(row).where(row.batch_id == batch_id, row.campaign_id == campaign_id)
        found = self._first(BatchEstimate, query)
        if found is None:
            raise NotFound(f"job {batch_id} has no result of campaign {campaign_id}")
        return found


def _added(session: Session, kind: str, campaigns: list[int], asked_by: str) -> t.BatchRow:
    """A waiting batch, with its event."""
    state = BatchState.WAITING
    row = t.BatchRow(machine_id=rows.own_id(session), kind=kind, campaigns=campaigns, asked_by=asked_by, state=state)
    _with_event(session, rows.added(session, row))
    return row


def _completed(session: Session, place: str, campaign_id: int) -> t.CampaignRow:
    """A completed campaign of this machine; BadInput, OtherMachine."""
    try:
        row = rows.own_campaign(session, campaign_id)
    except NotFound as error:
        raise BadInput(place, f"{error}: name a completed campaign") from None
    if row.state is not CampaignState.COMPLETED:
        raise BadInput(
            place, f"campaign {campaign_id} is {row.state.value}, must be completed: let it end, or measure it again"
        )
    return row


def _of_kind(session: Session, kind: str, batch_id: int) -> t.BatchRow:
    name = _PAYLOAD if kind == _PAYLOAD else "job"
    row = rows.get(session, t.BatchRow, batch_id, name)
    if row.kind != kind:
        raise NotFound(f"{name} {batch_id} does not exist")
    return row


_Payload = TypeVar("_Payload", bound=PayloadEntry)


def _payload(kind: type[_Payload], session: Session, row: t.BatchRow) -> _Payload:
    before, after = row.campaigns
    result = session.scalar(select(t.BatchResultRow).where(t.BatchResultRow.batch_id == row.id))
    found = {"cause": "", "document": None} if result is None else {"cause": result.cause, "document": result.document}
    return rows.document(kind, row, before=before, after=after, **found)


def _own(session: Session, batch_id: int) -> t.BatchRow:
    row = rows.get(session, t.BatchRow, batch_id, "job")
    rows.check_own(session, row.machine_id, f"job {batch_id}")
    return row


def _with_event(session: Session, row: t.BatchRow) -> BatchDocument:
    """The document of its present state, which is also added to the outbox as an event."""
    found = _document(session, row)
    data: dict[str, JsonValue] = {
        "batch": row.id,
        "state": row.state.value,
        "done": found.done,
        "campaigns": found.campaigns,
    }
    rows.emit(session, None, EventKind.BATCH, data)
    return found


def _document(session: Session, row: t.BatchRow) -> BatchDocument:
    result = t.BatchResultRow
    query = select(func.count(), func.coalesce(func.sum(result.sweeps), 0)).where(result.batch_id == row.id)
    done, sweeps = session.execute(query).one()
    failed = session.scalar(query.with_only_columns(func.count()).where(result.cause != ""))
    counts = {"campaigns": len(row.campaigns), "done": done, "failed": failed or 0, "sweeps": sweeps}
    return rows.document(BatchDocument, row, **counts)
