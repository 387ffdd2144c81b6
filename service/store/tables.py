"""The tables. Rows stay inside `service.store`; what leaves it are documents. Changes need a migration."""

from collections.abc import Sequence
from datetime import UTC, datetime
from enum import Enum
from typing import ClassVar, NamedTuple, cast

from pydantic import JsonValue
from sqlalchemy import (
    DDL,
    JSON,
    DateTime,
    Dialect,
    Enum as SqlEnum,
    ForeignKey,
    Index,
    String,
    TypeDecorator,
    UniqueConstraint,
    event,
    func,
    select,
)
from sqlalchemy.orm import (
    DeclarativeBase,
    InstrumentedAttribute,
    Mapped,
    MappedSQLExpression,
    Session,
    column_property,
    mapped_column,
    object_session,
)

from drivers.ports import SweepMode
from service.store.access import Role
from service.store.documents import BatchState, CampaignState, DiagnosisState, EventKind, RecordingState, SweepState


class Utc(TypeDecorator[datetime]):
    """Aware UTC datetimes; SQLite itself forgets the zone."""

    impl = DateTime
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        return None if value is None else value.astimezone(UTC).replace(tzinfo=None)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        return None if value is None else value.replace(tzinfo=UTC)


def now() -> datetime:
    """Wall clock, for people to read; no deadline hangs on it."""
    return datetime.now(UTC)


KINDS = (CampaignState, SweepState, RecordingState, EventKind, DiagnosisState, BatchState, SweepMode, Role)


def _stored(kind: type[Enum]) -> SqlEnum:
    """By the values of its members, as everywhere outside."""
    return SqlEnum(kind, native_enum=False, length=16, values_callable=_values)


def _values(kind: type[Enum]) -> list[str]:
    return [member.word if isinstance(member, Role) else str(member.value) for member in kind]


class StoredRow(DeclarativeBase):
    """Registry of the tables."""

    type_annotation_map: ClassVar = {
        datetime: Utc(),
        dict[str, JsonValue]: JSON(none_as_null=True),
        list[int]: JSON(),
        list[str]: JSON(),
    } | {kind: _stored(kind) for kind in KINDS}


class NumberedRow(StoredRow):
    """A row with a number of its own."""

    __abstract__ = True
    id: Mapped[int] = mapped_column(primary_key=True, sort_order=-1)  # the first column


class OwnMachine(NamedTuple):
    """The machine of a service, as in its row."""

    id: int
    name: str


class OfMachine:
    """A row of one machine, with the fields of its document that are not in the row."""

    own = "machine"  # in the `info` of a session: the machine of its service

    machine_id: Mapped[int]

    @property
    def machine(self) -> str:
        """The machine's name."""
        return session_of(self).get_one(MachineRow, self.machine_id).name

    @property
    def here(self) -> bool:
        """Whether it is the machine of this service."""
        own: OwnMachine | None = session_of(self).info[OfMachine.own]
        return own is not None and own.id == self.machine_id


def session_of(row: object) -> Session:
    """The session in which a row was read or added."""
    return cast(Session, object_session(row))


class MachineRow(NumberedRow):
    """One row a cell's machine; `machine_id` elsewhere is its id."""

    __tablename__ = "machine"
    name: Mapped[str] = mapped_column(String(64), unique=True)
    robot_id: Mapped[int | None]  # robot and cell as its service has them configured; None: not configured
    cell: Mapped[str | None]
    created_at: Mapped[datetime] = mapped_column(default=now)


class RobotRow(NumberedRow):
    """`serial` and `revision` as the description has them: which robot of several of one name it is."""

    __tablename__ = "robot"
    __table_args__ = (Index("ix_robot_name_serial", "name", "serial"),)
    sha256: Mapped[str] = mapped_column(String(64), unique=True)  # of description and URDF
    name: Mapped[str]
    serial: Mapped[str | None] = mapped_column(String(100))
    revision: Mapped[str | None] = mapped_column(String(100))
    description: Mapped[dict[str, JsonValue]]
    urdf_text: Mapped[str]
    created_at: Mapped[datetime] = mapped_column(default=now)


class PlanRow(NumberedRow):
    __tablename__ = "plan"
    robot_id: Mapped[int] = mapped_column(ForeignKey("robot.id"))
    document: Mapped[dict[str, JsonValue]]
    created_at: Mapped[datetime] = mapped_column(default=now)


class ApprovalRow(NumberedRow):
    """Append-only. It holds for one machine."""

    __tablename__ = "approval"
    machine_id: Mapped[int]
    plan_id: Mapped[int] = mapped_column(ForeignKey("plan.id"), index=True)
    sha256: Mapped[str] = mapped_column(String(64))  # of all that decides what the plan moves
    approved_by: Mapped[str]
    at: Mapped[datetime]
    expires_at: Mapped[datetime]
    last_stop: Mapped[int]  # id of the machine's last stop before it, 0: none


class CampaignRow(OfMachine, NumberedRow):
    __tablename__ = "campaign"
    machine_id: Mapped[int] = mapped_column(index=True)  # runs it, and has its files
    robot_id: Mapped[int] = mapped_column(ForeignKey("robot.id"))
    plan_id: Mapped[int | None] = mapped_column(ForeignKey("plan.id"))
    state: Mapped[CampaignState]
    cause: Mapped[str] = mapped_column(default="")
    structured_cause: Mapped[dict[str, JsonValue] | None]
    version: Mapped[int] = mapped_column(default=1)
    created_at: Mapped[datetime] = mapped_column(default=now)
    started_at: Mapped[datetime | None]

    @property
    def sweeps(self) -> dict[SweepState, int]:
        """Number of sweeps by state."""
        counts = select(SweepRow.state, func.count()).where(SweepRow.campaign_id == self.id).group_by(SweepRow.state)
        return dict(session_of(self).execute(counts).all())


class SweepRow(NumberedRow):
    __tablename__ = "sweep"
    __table_args__ = (UniqueConstraint("campaign_id", "number"), Index("ix_sweep_state", "state"))
    campaign_id: Mapped[int] = mapped_column(ForeignKey("campaign.id"))
    number: Mapped[int]
    spec: Mapped[dict[str, JsonValue]]
    mode: Mapped[SweepMode | None]
    state: Mapped[SweepState]
    cause: Mapped[str] = mapped_column(default="")
    structured_cause: Mapped[dict[str, JsonValue] | None]
    attempt: Mapped[int] = mapped_column(default=0)


def _of_sweep(sweep_id: Mapped[int], value: InstrumentedAttribute[int]) -> MappedSQLExpression[int]:
    """The value of the sweep that a row belongs to."""
    query = select(value).where(SweepRow.id == sweep_id).correlate_except(SweepRow)
    return column_property(query.scalar_subquery())


class RecordingRow(NumberedRow):
    __tablename__ = "recording"
    __table_args__ = (UniqueConstraint("sweep_id", "attempt"),)
    sweep_id: Mapped[int] = mapped_column(ForeignKey("sweep.id"))
    attempt: Mapped[int]
    state: Mapped[RecordingState]
    path: Mapped[str]
    sha256: Mapped[str] = mapped_column(String(64))
    samples: Mapped[int]
    created_at: Mapped[datetime] = mapped_column(default=now)
    moved_at: Mapped[datetime | None] = mapped_column(index=True)  # read back from the object store as it was written
    pruned_at: Mapped[datetime | None]  # its samples were removed by the retention rule
    campaign_id: Mapped[int] = _of_sweep(sweep_id, SweepRow.campaign_id)
    number: Mapped[int] = _of_sweep(sweep_id, SweepRow.number)


class SpectrumRow(NumberedRow):
    """Where the spectrum of an identified sweep lies."""

    __tablename__ = "spectrum_file"
    sweep_id: Mapped[int] = mapped_column(ForeignKey("sweep.id"), unique=True)
    path: Mapped[str]
    sha256: Mapped[str] = mapped_column(String(64))


class IdentityRow(StoredRow):
    """One row: the name of this database, which its data folder bears as well."""

    __tablename__ = "identity"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)


class EstimateRow(NumberedRow):
    """Append-only, but that a fit of all sweeps replaces the last one, and that a newer one takes the values of single
    sweeps out of the one before. The unique sweep makes a result that comes twice count once.
    """

    __tablename__ = "estimate"
    __table_args__ = (UniqueConstraint("campaign_id", "revision"),)
    campaign_id: Mapped[int] = mapped_column(ForeignKey("campaign.id"))
    revision: Mapped[int]
    sweep_id: Mapped[int] = mapped_column(ForeignKey("sweep.id"), unique=True)
    document: Mapped[dict[str, JsonValue]]
    created_at: Mapped[datetime] = mapped_column(default=now)
    number: Mapped[int] = _of_sweep(sweep_id, SweepRow.number)


class DiagnosisRow(OfMachine, NumberedRow):
    """The unique parent makes a diagnosis go on once only, the unique campaign an experiment belong to one."""

    __tablename__ = "diagnosis"
    robot_id: Mapped[int] = mapped_column(ForeignKey("robot.id"))
    parent: Mapped[int | None] = mapped_column("parent_id", ForeignKey("diagnosis.id"), unique=True)
    # diagnosis and model refer to each other: this one is added when both tables are there
    model: Mapped[int | None] = mapped_column(
        "model_id", ForeignKey("model.id", name="diagnosis_model", use_alter=True)
    )
    campaigns: Mapped[list[int]]
    axes: Mapped[list[str]]
    weighed: Mapped[dict[str, JsonValue] | None]
    estimate: Mapped[dict[str, JsonValue] | None]
    unattended: Mapped[bool]
    state: Mapped[DiagnosisState]
    cause: Mapped[str] = mapped_column(default="")
    document: Mapped[dict[str, JsonValue] | None] = mapped_column(deferred=True)
    experiment: Mapped[dict[str, JsonValue] | None]
    experiment_campaign_id: Mapped[int | None] = mapped_column(ForeignKey("campaign.id"), unique=True)
    created_at: Mapped[datetime] = mapped_column(default=now)
    finished_at: Mapped[datetime | None]

    @property
    def results(self) -> "Sequence[AxisDiagnosisRow]":
        """Of the finished axes."""
        query = select(AxisDiagnosisRow).where(AxisDiagnosisRow.diagnosis_id == self.id).order_by(AxisDiagnosisRow.id)
        return session_of(self).scalars(query).all()

    @property
    def verdicts(self) -> dict[str, str]:
        """By joint."""
        return {result.joint: result.verdict for result in self.results}


class AxisDiagnosisRow(NumberedRow):
    """Result of one axis's job. The unique pair makes a result that comes twice count once."""

    __tablename__ = "axis_diagnosis"
    __table_args__ = (UniqueConstraint("diagnosis_id", "joint"),)
    diagnosis_id: Mapped[int] = mapped_column(ForeignKey("diagnosis.id"))
    joint: Mapped[str]
    verdict: Mapped[str] = mapped_column(String(16))
    document: Mapped[dict[str, JsonValue]] = mapped_column(deferred=True)


class ModelRow(NumberedRow):
    """Append-only; a diagnosis becomes one model at most."""

    __tablename__ = "model"
    __table_args__ = (UniqueConstraint("robot_id", "revision"),)
    robot_id: Mapped[int] = mapped_column(ForeignKey("robot.id"))
    revision: Mapped[int]
    parent: Mapped[int | None] = mapped_column("parent_id", ForeignKey("model.id"))
    diagnosis_id: Mapped[int] = mapped_column(ForeignKey("diagnosis.id"), unique=True)
    accepted_by: Mapped[str]
    at: Mapped[datetime] = mapped_column(default=now)
    document: Mapped[dict[str, JsonValue]]


class DataCheckRow(NumberedRow):
    """What the check of the data found. The unique campaign makes a result that comes twice count once."""

    __tablename__ = "data_check"
    campaign_id: Mapped[int] = mapped_column(ForeignKey("campaign.id"), unique=True)
    document: Mapped[dict[str, JsonValue]]
    at: Mapped[datetime] = mapped_column(default=now)


class HoldRow(StoredRow):
    """A campaign of which the retention rule removes nothing."""

    __tablename__ = "hold"
    campaign_id: Mapped[int] = mapped_column(ForeignKey("campaign.id"), primary_key=True, autoincrement=False)
    by: Mapped[str]
    why: Mapped[str]
    at: Mapped[datetime] = mapped_column(default=now)


class BatchRow(OfMachine, NumberedRow):
    """A computation over stored campaigns; what of `campaigns` has no result yet is still to do."""

    __tablename__ = "batch"
    kind: Mapped[str] = mapped_column(String(16))
    campaigns: Mapped[list[int]]
    asked_by: Mapped[str]
    state: Mapped[BatchState]
    created_at: Mapped[datetime] = mapped_column(default=now)
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]


class BatchResultRow(NumberedRow):
    """Of one campaign. The unique pair makes a result that comes twice count once. `document`: None for a `cause`."""

    __tablename__ = "batch_result"
    __table_args__ = (UniqueConstraint("batch_id", "campaign_id"),)
    batch_id: Mapped[int] = mapped_column(ForeignKey("batch.id"))
    campaign_id: Mapped[int] = mapped_column(ForeignKey("campaign.id"))
    sweeps: Mapped[int]
    cause: Mapped[str]
    change_percent: Mapped[float | None]
    document: Mapped[dict[str, JsonValue] | None] = mapped_column(deferred=True)
    at: Mapped[datetime] = mapped_column(default=now)


class EventRow(NumberedRow):
    """The outbox. AUTOINCREMENT: an id is never given twice, even after the newest row went."""

    __tablename__ = "event"
    __table_args__ = ({"sqlite_autoincrement": True},)
    machine_id: Mapped[int]
    campaign_id: Mapped[int | None] = mapped_column(ForeignKey("campaign.id"), index=True)
    kind: Mapped[EventKind]
    data: Mapped[dict[str, JsonValue]]
    at: Mapped[datetime] = mapped_column(default=now)


class IdempotencyRow(StoredRow):
    __tablename__ = "idempotency_key"
    machine_id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    key: Mapped[str] = mapped_column(String(255), primary_key=True)
    fingerprint: Mapped[str] = mapped_column(String(64))
    status: Mapped[int | None]  # None: the work is under way
    body: Mapped[str] = mapped_column(default="")
    created_at: Mapped[datetime] = mapped_column(default=now)


class LeaseRow(StoredRow):
    """One row a resource. Who waits for it watches `renewals` on its own monotonic clock; no wall clock is compared."""

    __tablename__ = "lease"
    resource: Mapped[str] = mapped_column(String(64), primary_key=True)
    owner: Mapped[str]
    renewals: Mapped[int]


class StopRow(NumberedRow):
    """Every stop there was; its machine is latched while one has no `reset_at`."""

    __tablename__ = "stop"
    machine_id: Mapped[int]
    by: Mapped[str]
    why: Mapped[str]
    cause: Mapped[dict[str, JsonValue] | None]  # None: a person
    at: Mapped[datetime] = mapped_column(default=now)
    reset_by: Mapped[str | None]
    reset_at: Mapped[datetime | None]


class ApiKeyRow(NumberedRow):
    """A name is given once, so that the audit tells who it was."""

    __tablename__ = "api_key"
    name: Mapped[str] = mapped_column(String(100), unique=True)
    role: Mapped[Role]
    scopes: Mapped[list[str] | None] = mapped_column(JSON(none_as_null=True))
    sha256: Mapped[str] = mapped_column(String(64), unique=True)
    created_at: Mapped[datetime] = mapped_column(default=now)
    expires_at: Mapped[datetime]
    revoked_at: Mapped[datetime | None]


class UserRow(NumberedRow):
    """A person. `password`: argon2's hash; None where a provider says who it is, by `issuer` and `subject`."""

    __tablename__ = "user_account"
    __table_args__ = (Index("ix_user_account_external", "issuer", "subject", unique=True),)
    name: Mapped[str] = mapped_column(String(100), unique=True)
    role: Mapped[Role]
    password: Mapped[str | None] = mapped_column(String(255))
    issuer: Mapped[str | None] = mapped_column(String(500))
    subject: Mapped[str | None] = mapped_column(String(255))
    created_at: Mapped[datetime] = mapped_column(default=now)
    disabled_at: Mapped[datetime | None]


class SessionRow(NumberedRow):
    """A browser in which a person is logged in. `sha256`: of what its cookie has."""

    __tablename__ = "user_session"
    user_id: Mapped[int] = mapped_column(ForeignKey("user_account.id"))
    sha256: Mapped[str] = mapped_column(String(64), unique=True)
    address: Mapped[str] = mapped_column(String(100))
    created_at: Mapped[datetime] = mapped_column(default=now)
    seen_at: Mapped[datetime] = mapped_column(default=now)
    ended_at: Mapped[datetime | None]


class SteadyTimeRow(StoredRow):
    """One row: the latest time of sessions and keys, see `service.store.database`."""

    __tablename__ = "steady_time"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    at: Mapped[datetime]


class AuditRow(StoredRow):
    """Append-only, by a trigger. `entry` is canonical JSON; `sha256`: see `service.store.people.audit`."""

    __tablename__ = "audit"
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    entry: Mapped[str]
    sha256: Mapped[str] = mapped_column(String(64))


def _protect_audit() -> None:
    """A database refuses every change of the audit but the next entry."""
    only_added = "the audit is only ever added to"
    # INSERT OR REPLACE removes the row that is in the way without firing a trigger of DELETE
    follows = "(SELECT coalesce(max(number), 0) + 1 FROM audit)"
    refuse = f"RAISE EXCEPTION '{only_added}' USING ERRCODE = 'integrity_constraint_violation';"
    function = "CREATE FUNCTION {}() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN {} END $$".format
    statements = {
        "sqlite": (
            *(
                f"CREATE TRIGGER audit_no_{change.lower()} BEFORE {change} ON audit "
                f"BEGIN SELECT RAISE(ABORT, '{only_added}'); END"
                for change in ("UPDATE", "DELETE")
            ),
            f"CREATE TRIGGER audit_no_replace BEFORE INSERT ON audit WHEN NEW.number <> {follows} "
            f"BEGIN SELECT RAISE(ABORT, '{only_added}'); END",
        ),
        "postgresql": (
            function("audit_only_added", refuse),
            function("audit_follows", f"IF NEW.number <> {follows} THEN {refuse} END IF; RETURN NEW;"),
            *(
                f"CREATE TRIGGER audit_no_{change.lower()} BEFORE {change} ON audit "
                "FOR EACH STATEMENT EXECUTE FUNCTION audit_only_added()"
                for change in ("UPDATE", "DELETE", "TRUNCATE")
            ),
            "CREATE TRIGGER audit_no_replace BEFORE INSERT ON audit FOR EACH ROW EXECUTE FUNCTION audit_follows()",
        ),
    }
    for dialect, each in statements.items():
        for statement in each:
            event.listen(AuditRow.__table__, "after_create", DDL(statement).execute_if(dialect=dialect))


_protect_audit()
