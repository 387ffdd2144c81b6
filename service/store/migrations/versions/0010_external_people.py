"""People whom an identity provider names"""

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("user_account", sa.Column("issuer", sa.String(length=500), nullable=True))
    op.add_column("user_account", sa.Column("subject", sa.String(length=255), nullable=True))
    op.create_index("ix_user_account_external", "user_account", ["issuer", "subject"], unique=True)
