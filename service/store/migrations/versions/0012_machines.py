"""Machines of several cells in one database; robots by serial number. What there was belongs to machine 1"""

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

_OF_A_MACHINE = ("campaign", "approval", "diagnosis", "event", "stop")


def upgrade() -> None:
    machine = op.create_table(
        "machine",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.PrimaryKeyConstraint("id"),
        sa.UniqueConstraint("name"),
    )
    # not by an explicit id: the sequence of a server would not know of it
    op.execute(sa.insert(machine).values(name="machine", created_at=sa.func.current_timestamp()))
    for table in _OF_A_MACHINE:
        # no foreign key: SQLite would want the table to be made anew, with all that refers to it
        op.add_column(table, sa.Column("machine_id", sa.Integer(), nullable=False, server_default="1"))
    op.create_index("ix_campaign_machine_id", "campaign", ["machine_id"])
    op.add_column("robot", sa.Column("serial", sa.String(length=100), nullable=True))
    op.add_column("robot", sa.Column("revision", sa.String(length=100), nullable=True))
    op.create_index("ix_robot_name_serial", "robot", ["name", "serial"])
    # answers to requests that are sent again: those of before are of machine 1
    op.rename_table("idempotency_key", "idempotency_key_before")
    op.create_table(
        "idempotency_key",
        sa.Column("machine_id", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("key", sa.String(length=255), nullable=False),
        sa.Column("fingerprint", sa.String(length=64), nullable=False),
        sa.Column("status", sa.Integer(), nullable=True),
        sa.Column("body", sa.String(), nullable=False),
        sa.Column("created_at", sa.DateTime(), nullable=False),
        sa.PrimaryKeyConstraint("machine_id", "key", name="idempotency_key_of_machine"),
    )
    op.execute(
        "INSERT INTO idempotency_key (machine_id, key, fingerprint, status, body, created_at) "
        "SELECT 1, key, fingerprint, status, body, created_at FROM idempotency_key_before"
    )
    op.drop_table("idempotency_key_before")
