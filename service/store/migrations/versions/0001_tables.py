"""All tables, and the triggers of the audit"""

from typing import Any
from uuid import uuid4

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

_ONLY_ADDED = "the audit is only ever added to"
# INSERT OR REPLACE removes the row that is in the way without firing a trigger of DELETE
_AUDIT = {
    "sqlite": (
        *(
            f"CREATE TRIGGER audit_no_{change.lower()} BEFORE {change} ON audit "
            f"BEGIN SELECT RAISE(ABORT, '{_ONLY_ADDED}'); END"
            for change in ("UPDATE", "DELETE")
        ),
        "CREATE TRIGGER audit_no_replace BEFORE INSERT ON audit "
        "WHEN NEW.number <> (SELECT coalesce(max(number), 0) + 1 FROM audit) "
        f"BEGIN SELECT RAISE(ABORT, '{_ONLY_ADDED}'); END",
    ),
    "postgresql": (
        "CREATE FUNCTION audit_only_added() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN "
        f"RAISE EXCEPTION '{_ONLY_ADDED}' USING ERRCODE = 'integrity_constraint_violation'; END $$",
        "CREATE FUNCTION audit_follows() RETURNS trigger LANGUAGE plpgsql AS $$ BEGIN "
        "IF NEW.number <> (SELECT coalesce(max(number), 0) + 1 FROM audit) THEN "
        f"RAISE EXCEPTION '{_ONLY_ADDED}' USING ERRCODE = 'integrity_constraint_violation'; "
        "END IF; RETURN NEW; END $$",
        *(
            f"CREATE TRIGGER audit_no_{change.lower()} BEFORE {change} ON audit "
            "FOR EACH STATEMENT EXECUTE FUNCTION audit_only_added()"
            for change in ("UPDATE", "DELETE", "TRUNCATE")
        ),
        "CREATE TRIGGER audit_no_replace BEFORE INSERT ON audit FOR EACH ROW EXECUTE FUNCTION audit_follows()",
    ),
}


def _needed(name: str, of: Any, *references: sa.ForeignKey, **options: Any) -> sa.Column[Any]:
    return sa.Column(name, of, *references, nullable=False, **options)


def upgrade() -> None:
    op.create_table(
        "api_key",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("name", sa.String(100), unique=True),
        _needed("role", sa.String(16)),
        _needed("sha256", sa.String(64), unique=True),
        _needed("created_at", sa.DateTime),
        _needed("expires_at", sa.DateTime),
        sa.Column("revoked_at", sa.DateTime),
        sa.Column("scopes", sa.JSON),
    )
    op.create_table(
        "audit",
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
        _needed("entry", sa.String),
        _needed("sha256", sa.String(64)),
    )
    op.create_table(
        "batch",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("machine_id", sa.Integer),
        _needed("kind", sa.String(16)),
        _needed("campaigns", sa.JSON),
        _needed("asked_by", sa.String),
        _needed("state", sa.String(16)),
        _needed("created_at", sa.DateTime),
        sa.Column("started_at", sa.DateTime),
        sa.Column("finished_at", sa.DateTime),
    )
    op.create_table(
        "idempotency_key",
        _needed("machine_id", sa.Integer, autoincrement=False),
        _needed("key", sa.String(255)),
        _needed("fingerprint", sa.String(64)),
        sa.Column("status", sa.Integer),
        _needed("body", sa.String),
        _needed("created_at", sa.DateTime),
        sa.PrimaryKeyConstraint("machine_id", "key", name="idempotency_key_of_machine"),
    )
    identity = op.create_table(
        "identity",
        sa.Column("id", sa.String(32), primary_key=True),
    )
    op.create_table(
        "lease",
        sa.Column("resource", sa.String(64), primary_key=True),
        _needed("owner", sa.String),
        _needed("renewals", sa.Integer),
    )
    machine = op.create_table(
        "machine",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("name", sa.String(64), unique=True),
        _needed("created_at", sa.DateTime),
        sa.Column("robot_id", sa.Integer),
        sa.Column("cell", sa.String),
    )
    op.create_table(
        "robot",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("sha256", sa.String(64), unique=True),
        _needed("name", sa.String),
        _needed("description", sa.JSON),
        _needed("urdf_text", sa.String),
        _needed("created_at", sa.DateTime),
        sa.Column("serial", sa.String(100)),
        sa.Column("revision", sa.String(100)),
        sa.Index("ix_robot_name_serial", "name", "serial"),
    )
    op.create_table(
        "steady_time",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
        _needed("at", sa.DateTime),
    )
    op.create_table(
        "stop",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("by", sa.String),
        _needed("why", sa.String),
        _needed("at", sa.DateTime),
        sa.Column("reset_by", sa.String),
        sa.Column("reset_at", sa.DateTime),
        _needed("machine_id", sa.Integer),
        sa.Column("cause", sa.JSON),
    )
    op.create_table(
        "user_account",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("name", sa.String(100), unique=True),
        _needed("role", sa.String(16)),
        sa.Column("password", sa.String(255)),
        _needed("created_at", sa.DateTime),
        sa.Column("disabled_at", sa.DateTime),
        sa.Column("issuer", sa.String(500)),
        sa.Column("subject", sa.String(255)),
        sa.Index("ix_user_account_external", "issuer", "subject", unique=True),
    )
    op.create_table(
        "plan",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("robot_id", sa.Integer, sa.ForeignKey("robot.id")),
        _needed("document", sa.JSON),
        _needed("created_at", sa.DateTime),
    )
    op.create_table(
        "user_session",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("user_id", sa.Integer, sa.ForeignKey("user_account.id")),
        _needed("sha256", sa.String(64), unique=True),
        _needed("address", sa.String(100)),
        _needed("created_at", sa.DateTime),
        _needed("seen_at", sa.DateTime),
        sa.Column("ended_at", sa.DateTime),
    )
    op.create_table(
        "approval",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("plan_id", sa.Integer, sa.ForeignKey("plan.id"), index=True),
        _needed("sha256", sa.String(64)),
        _needed("approved_by", sa.String),
        _needed("at", sa.DateTime),
        _needed("expires_at", sa.DateTime),
        _needed("machine_id", sa.Integer),
        _needed("last_stop", sa.Integer),
    )
    op.create_table(
        "campaign",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("robot_id", sa.Integer, sa.ForeignKey("robot.id")),
        sa.Column("plan_id", sa.Integer, sa.ForeignKey("plan.id")),
        _needed("state", sa.String(16)),
        _needed("cause", sa.String),
        _needed("version", sa.Integer),
        _needed("created_at", sa.DateTime),
        sa.Column("started_at", sa.DateTime),
        _needed("machine_id", sa.Integer, index=True),
        sa.Column("structured_cause", sa.JSON),
    )
    op.create_table(
        "batch_result",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("batch_id", sa.Integer, sa.ForeignKey("batch.id")),
        _needed("campaign_id", sa.Integer, sa.ForeignKey("campaign.id")),
        _needed("sweeps", sa.Integer),
        _needed("cause", sa.String),
        sa.Column("change_percent", sa.Double[float]()),
        sa.Column("document", sa.JSON),
        _needed("at", sa.DateTime),
        sa.UniqueConstraint("batch_id", "campaign_id"),
    )
    op.create_table(
        "data_check",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("campaign_id", sa.Integer, sa.ForeignKey("campaign.id"), unique=True),
        _needed("document", sa.JSON),
        _needed("at", sa.DateTime),
    )
    op.create_table(
        "diagnosis",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("robot_id", sa.Integer, sa.ForeignKey("robot.id")),
        sa.Column("parent_id", sa.Integer, sa.ForeignKey("diagnosis.id"), unique=True),
        sa.Column("model_id", sa.Integer),
        _needed("campaigns", sa.JSON),
        _needed("axes", sa.JSON),
        sa.Column("weighed", sa.JSON),
        _needed("unattended", sa.Boolean),
        _needed("state", sa.String(16)),
        _needed("cause", sa.String),
        sa.Column("document", sa.JSON),
        sa.Column("experiment", sa.JSON),
        sa.Column("experiment_campaign_id", sa.Integer, sa.ForeignKey("campaign.id"), unique=True),
        _needed("created_at", sa.DateTime),
        sa.Column("finished_at", sa.DateTime),
        sa.Column("estimate", sa.JSON),
        _needed("machine_id", sa.Integer),
    )
    op.create_table(
        "event",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("campaign_id", sa.Integer, sa.ForeignKey("campaign.id"), index=True),
        _needed("kind", sa.String(16)),
        _needed("data", sa.JSON),
        _needed("at", sa.DateTime),
        _needed("machine_id", sa.Integer),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "hold",
        sa.Column("campaign_id", sa.Integer, sa.ForeignKey("campaign.id"), primary_key=True, autoincrement=False),
        _needed("by", sa.String),
        _needed("why", sa.String),
        _needed("at", sa.DateTime),
    )
    op.create_table(
        "sweep",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("campaign_id", sa.Integer, sa.ForeignKey("campaign.id")),
        _needed("number", sa.Integer),
        _needed("spec", sa.JSON),
        sa.Column("mode", sa.String(16)),
        _needed("state", sa.String(16), index=True),
        _needed("cause", sa.String),
        _needed("attempt", sa.Integer),
        sa.Column("structured_cause", sa.JSON),
        sa.UniqueConstraint("campaign_id", "number"),
    )
    op.create_table(
        "axis_diagnosis",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("diagnosis_id", sa.Integer, sa.ForeignKey("diagnosis.id")),
        _needed("joint", sa.String),
        _needed("verdict", sa.String(16)),
        _needed("document", sa.JSON),
        sa.UniqueConstraint("diagnosis_id", "joint"),
    )
    op.create_table(
        "estimate",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("campaign_id", sa.Integer, sa.ForeignKey("campaign.id")),
        _needed("revision", sa.Integer),
        _needed("sweep_id", sa.Integer, sa.ForeignKey("sweep.id"), unique=True),
        _needed("document", sa.JSON),
        _needed("created_at", sa.DateTime),
        sa.UniqueConstraint("campaign_id", "revision"),
    )
    op.create_table(
        "model",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("robot_id", sa.Integer, sa.ForeignKey("robot.id")),
        _needed("revision", sa.Integer),
        sa.Column("parent_id", sa.Integer, sa.ForeignKey("model.id")),
        _needed("diagnosis_id", sa.Integer, sa.ForeignKey("diagnosis.id"), unique=True),
        _needed("accepted_by", sa.String),
        _needed("at", sa.DateTime),
        _needed("document", sa.JSON),
        sa.UniqueConstraint("robot_id", "revision"),
    )
    op.create_table(
        "recording",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("sweep_id", sa.Integer, sa.ForeignKey("sweep.id")),
        _needed("attempt", sa.Integer),
        _needed("state", sa.String(16)),
        _needed("path", sa.String),
        _needed("sha256", sa.String(64)),
        _needed("samples", sa.Integer),
        _needed("created_at", sa.DateTime),
        sa.Column("moved_at", sa.DateTime, index=True),
        sa.Column("pruned_at", sa.DateTime),
        sa.UniqueConstraint("sweep_id", "attempt"),
    )
    op.create_table(
        "spectrum_file",
        sa.Column("id", sa.Integer, primary_key=True),
        _needed("sweep_id", sa.Integer, sa.ForeignKey("sweep.id"), unique=True),
        _needed("path", sa.String),
        _needed("sha256", sa.String(64)),
    )
    with op.batch_alter_table("diagnosis") as diagnosis:  # each of the two tables refers to the other
        diagnosis.create_foreign_key("diagnosis_model", "model", ["model_id"], ["id"])
    op.bulk_insert(identity, [{"id": uuid4().hex}])
    # not by an explicit id: the sequence of a server would not know of it
    op.execute(sa.insert(machine).values(name="machine", created_at=sa.func.current_timestamp()))
    for statement in _AUDIT[op.get_bind().dialect.name]:
        op.execute(statement)
