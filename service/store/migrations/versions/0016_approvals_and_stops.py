"""The last stop before each approval: a later one ends it"""

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # 0: an approval from before this version is ended by any stop that there was
    op.add_column("approval", sa.Column("last_stop", sa.Integer(), nullable=False, server_default="0"))
