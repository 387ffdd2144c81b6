"""Tables of `service.store.tables`, which `service.store.database.migrate` creates in a new database: see there."""

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """No database is older."""
