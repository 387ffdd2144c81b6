"""Copies one database to another of any kind: every row, compared after the copy, or nothing."""

import hashlib
import json
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from datetime import datetime
from enum import Enum
from typing import Any

from sqlalchemy import Column, Table, bindparam, delete, insert, select, update
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from service import BadInput, SweepidError
from service.store import tables as t
from service.store.database import Database, refusal
from service.store.lease_and_latch import MachineLease

Key = tuple[object, ...]


class RowsNotCopied(SweepidError):
    """A database refused, or the copied rows differ from the source; nothing is left in the target."""


def copy_rows(source: Database, target: Database, lease_time: float, tell: Callable[[str, int], None]) -> int:
    """Copy every row of `source` to the empty `target`. Returns the number of rows. Blocks.

    `source` is locked meanwhile, by the leases of its machines and its lock: no service can be started on it. `tell`
    is called with each table and its number of rows after they are copied and compared. Raises MachineTaken if a
    service runs on `source`, BadInput if `target` has rows, RowsNotCopied.
    """
    _check_two(source, target)
    with _leases(source, lease_time):
        return _copy_rows(source, target, tell)


def _copy_rows(source: Database, target: Database, tell: Callable[[str, int], None]) -> int:
    try:
        with source.write(quiet=True) as read, target.write(quiet=True) as written:
            _check_empty(target, written)
            written.execute(delete(t.IdentityRow))  # the data folder has the identity of the source
            written.execute(delete(t.MachineRow))
            # a lease belongs to a running service, and none runs
            tables = [table for table in t.StoredRow.metadata.sorted_tables if table.name != t.LeaseRow.__tablename__]
            read_rows = {table.name: _copy(table, read, written) for table in tables}
            for table in tables:
                _add_later_columns(table, read, written)
            target.continue_ids(written, tables)
            for table in tables:
                _compare(table, read_rows[table.name], written)
                tell(table.name, len(read_rows[table.name]))
    except SQLAlchemyError as error:
        raise RowsNotCopied(f"nothing was copied: {refusal(error)}") from error
    return sum(len(each) for each in read_rows.values())


@contextmanager
def _leases(source: Database, lease_time: float) -> Generator[None]:
    """Leases of all machines, so that none of their services can run. Raises MachineTaken."""
    with source.read() as session:
        machines = [t.OwnMachine(row.id, row.name) for row in session.scalars(select(t.MachineRow))]
    with ExitStack() as stack:
        for machine in machines:
            lease = MachineLease(source, lease_time, machine)
            lease.acquire()
            stack.callback(lease.release)
        yield


def _check_two(source: Database, target: Database) -> None:
    names: list[str] = []
    for database in (source, target):
        with database.read() as session:
            names.append(session.scalars(select(t.IdentityRow.id)).one())
    if names[0] == names[1]:
        raise BadInput("--to", f"{target.address} is the database to copy from, or a copy of it")


def _check_empty(target: Database, session: Session) -> None:
    for table in t.StoredRow.metadata.sorted_tables:
        if table.name in (t.IdentityRow.__tablename__, t.MachineRow.__tablename__):
            continue  # every new database has a row of these
        if session.execute(select(table).limit(1)).first() is not None:
            reason = f"{target.address} is not empty: there are rows in its table {table.name}; make a new database"
            raise BadInput("--to", reason)


def _copy(table: Table, read: Session, written: Session) -> dict[Key, bytes]:
    """The hash of each row by its key."""
    later = {column.name: None for column in _later(table)}
    hashes: dict[Key, bytes] = {}
    for rows in _pieces(table, read):
        hashes |= {_key(table, row): _digest(row) for row in rows}
        written.execute(insert(table), [{**row, **later} for row in rows])
    return hashes


def _add_later_columns(table: Table, read: Session, written: Session) -> None:
    """Diagnoses and models refer to each other: one direction is stored after both exist."""
    for column in _later(table):
        (key,) = table.primary_key.columns
        change = update(table).where(key == bindparam("of")).values({column.name: bindparam("to")})
        for rows in _pieces(table, read):
            referring = [{"of": row[key.name], "to": row[column.name]} for row in rows if row[column.name] is not None]
            if referring:  # on the connection: a session would treat it as an update of its own objects
                written.connection().execute(change, referring)


def _compare(table: Table, expected: Mapping[Key, bytes], written: Session) -> None:
    found = {_key(table, row): _digest(row) for rows in _pieces(table, written) for row in rows}
    if len(found) != len(expected):
        raise RowsNotCopied(f"table {table.name} has {len(found)} rows instead of {len(expected)}; nothing was copied")
    different = [key for key, digest in expected.items() if found.get(key) != digest]
    if different:
        raise RowsNotCopied(f"table {table.name}: row {different[0]} differs from the source; nothing was copied")


def _pieces(table: Table, session: Session) -> Iterator[list[dict[str, object]]]:
    """All rows, in batches."""
    query = select(table).order_by(*table.primary_key.columns).execution_options(yield_per=500)  # rows
    for rows in session.execute(query).mappings().partitions():
        yield [{column.name: row[column] for column in table.columns} for row in rows]


def _later(table: Table) -> list[Column[Any]]:
    return [column for column in table.columns if any(key.use_alter for key in column.foreign_keys)]


def _key(table: Table, row: Mapping[str, object]) -> Key:
    return tuple(row[column.name] for column in table.primary_key.columns)


def _digest(row: Mapping[str, object]) -> bytes:
    text = json.dumps([_plain(value) for value in row.values()], default=str, separators=(",", ":"))
    return hashlib.sha256(text.encode()).digest()


def _plain(value: object) -> object:
    """Value as every database returns it."""
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, datetime):
        return value.isoformat()
    # a NUL is replaced if a database does not support it in text
    return value.replace("\0", "\N{REPLACEMENT CHARACTER}") if isinstance(value, str) else value
