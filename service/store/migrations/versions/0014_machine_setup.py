"""The robot and the cell of each machine, as its service has them configured"""

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    # no foreign key: SQLite would want the table to be made anew, with all that refers to it
    op.add_column("machine", sa.Column("robot_id", sa.Integer(), nullable=True))
    op.add_column("machine", sa.Column("cell", sa.String(), nullable=True))
