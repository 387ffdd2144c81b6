"""From which estimate the rigid model of a diagnosis starts"""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("diagnosis") as diagnosis:
        diagnosis.add_column(sa.Column("estimate", sa.JSON(), nullable=True))
