"""Requirements of the store on any database."""

from collections.abc import Sequence
from typing import Protocol

from sqlalchemy import Connection, Engine, Table
from sqlalchemy.exc import OperationalError

BUSY_TIMEOUT = 30.0  # s to wait for another writer, or for an unavailable server
WRITE = "write"  # execution option of an engine: its transactions write
PATIENCE = "patience"  # the same: s that such a transaction waits for another writer


class Kind(Protocol):
    """Common requirements for every database.

    A writing transaction is exclusive: it waits at its begin, and sees everything committed before it. A reading
    transaction sees one consistent state and blocks no other. Committed data is on disk.
    """

    def engine(self) -> Engine:
        """Connections with these properties. Raises BadInput if their driver is not installed."""
        ...

    def check(self, engine: Engine) -> None:
        """Raises NotReached or BadInput if the database cannot be used; called once, before the migrations."""
        ...

    def is_away(self, error: OperationalError) -> bool:
        """Whether the database is unavailable: a transaction without changes so far may begin again."""
        ...

    def continue_ids(self, connection: Connection, tables: Sequence[Table]) -> None:
        """After rows were inserted with their ids: the next row of each table gets an unused id."""
        ...

    def token(self, connection: Connection) -> str:
        """Token of the transaction that writes on this connection, for `was_committed`."""
        ...

    def was_committed(self, engine: Engine, token: str) -> bool | None:
        """Whether the transaction without answer to its COMMIT was committed; None: not decided yet."""
        ...
