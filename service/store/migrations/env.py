"""Entry point of Alembic: runs the revisions in the transaction of the given connection."""

from alembic import context
from sqlalchemy import Connection

from service.store.tables import StoredRow

connection = context.config.attributes["connection"]
if not isinstance(connection, Connection):
    raise TypeError("migrations run on the connection that service.store.database gives")
context.configure(connection=connection, target_metadata=StoredRow.metadata, render_as_batch=True, compare_type=True)
context.run_migrations()
