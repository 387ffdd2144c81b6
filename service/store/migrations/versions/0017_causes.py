"""Why a campaign, a sweep or a machine stopped, for programs and pages beside the sentence of the log"""

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None


def upgrade() -> None:
    for table, column in (("campaign", "structured_cause"), ("sweep", "structured_cause"), ("stop", "cause")):
        op.add_column(table, sa.Column(column, sa.JSON(), nullable=True))
