"""Recordings that are in an object store"""

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("recording", sa.Column("moved_at", sa.DateTime(), nullable=True))
    op.create_index("ix_recording_moved_at", "recording", ["moved_at"])
