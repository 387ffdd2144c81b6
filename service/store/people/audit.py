"""The audit: entries with caller, request, address and outcome; its head outside of the database; its writer.

The audit as a chain: the SHA-256 of an entry covers the previous SHA-256 and its own canonical JSON. Pure.

A changed, removed or inserted entry breaks the chain at this position. Removed entries at the end, and a chain that was
made anew, are not detected by the chain alone; heads (number and hash) that were stored elsewhere detect them.
"""

import hashlib
import json
import os
import queue
import re
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self, cast

import structlog
from pydantic import BaseModel, ConfigDict, JsonValue
from sqlalchemy import func, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from service import BadInput, SweepidError
from service.store import table_rows as rows, tables as t
from service.store.access import Callers, masked
from service.store.tables import now

FIRST = "0" * 64
"""The hash before the first entry."""

Fact = str | int | float | list[int] | list[str] | None
Entry = Mapping[str, Fact]  # flat: caller, action, address and outcome
Link = tuple[int, str, str]  # number, canonical JSON, SHA-256
Head = tuple[int, str]  # number and SHA-256 of the last link


class AuditBroken(SweepidError):
    """The audit was changed; `number` is the first entry that does not match."""

    def __init__(self, number: int, reason: str) -> None:
        super().__init__(f"audit entry {number}: {reason}")
        self.number = number


def canonical(entry: Entry) -> str:
    """JSON with sorted keys, without spaces, in ASCII. The API keys of people are not in it."""
    return masked(json.dumps(dict(entry), sort_keys=True, separators=(",", ":"), allow_nan=False))


def sha256(previous: str, entry: str) -> str:
    """Hash of the entry (canonical JSON) that follows the entry with hash `previous`."""
    return hashlib.sha256(f"{previous}\n{entry}".encode()).hexdigest()


def verify(links: Iterable[Link], expected: Sequence[Head] = ()) -> Head:
    """The head of a valid chain, (0, FIRST) for an empty one. AuditBroken if an entry does not match.

    `expected`: heads that were stored elsewhere; the chain must contain each.
    """
    number, previous = 0, FIRST
    wanted: dict[int, set[str]] = {}
    for at, value in expected:
        wanted.setdefault(at, set()).add(value)
    for number_here, entry, hash_here in links:
        if number_here != number + 1:
            raise AuditBroken(number + 1, f"is missing; {number_here} follows {number}")
        number = number_here
        if sha256(previous, entry) != hash_here:
            raise AuditBroken(number, "its hash does not match its content and the entry before it")
        if other := wanted.get(number, set()) - {hash_here}:
            raise AuditBroken(number, f"its hash is {hash_here}, not {min(other)}")
        previous = hash_here
    if wanted and max(wanted) > number:
        raise AuditBroken(number + 1, f"is missing; the audit continued to {max(wanted)}")
    return number, previous


_HEAD = re.compile(r"(?<![0-9a-f:])([0-9]{1,10}):([0-9a-f]{64})(?![0-9a-f])", re.ASCII)


def read_head(text: str) -> Head:
    """Reads ``NUMBER:SHA256``, as the command `verify` prints it."""
    found = _HEAD.fullmatch(text)
    if found is None:
        raise BadInput("--head", f"{text!r} is neither NUMBER:SHA256 nor a file with such heads")
    return int(found[1]), found[2]


def heads_in(text: str, place: str) -> tuple[Head, ...]:
    """All heads in a text, for example in a file of heads or a log. BadInput if there is none."""
    heads = tuple((int(one[1]), one[2]) for one in _HEAD.finditer(text))
    if not heads:
        raise BadInput(place, "contains no NUMBER:SHA256")
    return heads


class AuditUnreadable(SweepidError):
    """The table is damaged or missing, or the database does not answer (API: 503)."""


class AuditDocument(BaseModel):
    """One entry. `sha256` is computed over that of the previous entry and the canonical JSON of this one's `entry`."""

    model_config = ConfigDict(frozen=True)
    number: int
    entry: dict[str, JsonValue]
    sha256: str


class AuditStore(rows.Transactions):
    """Every method is one transaction and blocks. Reading methods raise AuditUnreadable."""

    def append(self, entries: Sequence[Entry]) -> int:
        """Add entries in this order. Returns the number of the first."""
        with self._database.write(quiet=True) as session:
            return append(session, entries)

    def documents(self, after: int = 0, limit: int = 100) -> tuple[AuditDocument, ...]:
        return tuple(
            AuditDocument(number=number, entry=_content(number, entry), sha256=value)
            for number, entry, value in self._piece(after, limit)
        )

    def newest(self, limit: int) -> tuple[AuditDocument, ...]:
        """The last entries, in their order."""
        with self._read() as session:
            last = session.scalar(select(func.max(t.AuditRow.number))) or 0
        return self.documents(max(0, last - limit), limit)

    def head(self) -> Head:
        """Number and hash of the last entry; (0, FIRST) if there is none."""
        with self._read() as session:
            return _last(session)

    def links(self) -> Iterator[Link]:
        """The whole chain, in batches."""
        after = 0
        while piece := self._piece(after, 1000):  # entries read per query
            yield from piece
            after = piece[-1][0]

    def _piece(self, after: int, limit: int) -> tuple[Link, ...]:
        query = select(t.AuditRow).where(t.AuditRow.number > after).order_by(t.AuditRow.number).limit(limit)
        with self._read() as session:
            return tuple((row.number, row.entry, row.sha256) for row in session.scalars(query))

    @contextmanager
    def _read(self) -> Generator[Session]:
        try:
            with self._database.read() as session:
                yield session
        except SQLAlchemyError as error:
            reason = " ".join(str(getattr(error, "orig", None) or type(error).__name__).split())
            advice = "check it with `sweepid data doctor`, restore a backup if it is damaged"
            raise AuditUnreadable(f"the audit cannot be read: {reason}; {advice}") from error


def _last(session: Session) -> Head:
    last = session.scalar(select(t.AuditRow).order_by(t.AuditRow.number.desc()).limit(1))
    return (0, FIRST) if last is None else (last.number, last.sha256)


def _content(number: int, entry: str) -> dict[str, JsonValue]:
    """Content of what should be the canonical JSON of an entry."""
    try:
        found: object = json.loads(entry)
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise AuditUnreadable(
            f"audit entry {number} is not a JSON object: it was changed; `sweepid audit verify` shows where"
        )
    return cast("dict[str, JsonValue]", found)


def append(session: Session, entries: Iterable[Entry]) -> int:
    """Add entries in the caller's transaction, each with the service's machine, if any. Returns the first's number."""
    owned = rows.owned(session)
    where: Entry = {} if owned is None else {"machine": owned.name}
    number, previous = _last(session)
    first = number + 1
    for entry in entries:
        number += 1
        text = canonical({**where, **entry, "number": number, "at": t.now().isoformat()})
        previous = sha256(previous, text)
        session.add(t.AuditRow(number=number, entry=text, sha256=previous))
    return first


_log = structlog.get_logger(__name__)


class AuditHeads:
    """The head outside of the database: a line of the log and of a file, so that a chain that was cut off or made anew
    is noticed although it fits in itself. Used by one thread.
    """

    def __init__(
        self, store: AuditStore, file: Path, monotonic: Callable[[], float] = time.monotonic, every: float = 600.0
    ) -> None:
        """`file`: only ever added to; may be on another computer. `every`: s between two heads, if entries came."""
        self._store, self._file, self._monotonic = store, file, monotonic
        self._last: Head = (0, FIRST)
        self._every = every
        self._noted = monotonic() - every

    def note(self, at_end: bool = False) -> None:
        """Write the head if it is new and the last one is `every` s old, or at the end. Blocks. Raises
        AuditUnreadable; a file that cannot be written is only logged, with the head.
        """
        if not at_end and self._monotonic() - self._noted < self._every:
            return
        self._noted = self._monotonic()
        head = self._store.head()
        if head == self._last or head[0] == 0:
            return
        self._last = head
        line = f"{head[0]}:{head[1]}"
        _log.info("audit_head", head=line)
        try:
            with self._file.open("a", encoding="utf-8") as file:
                file.write(f"{line}\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            _log.error("audit_head_not_written", file=str(self._file), head=line, reason=error.strerror or str(error))


class NotAudited(SweepidError):
    """The audit cannot be written, so the request is not executed (API: 503)."""


@dataclass(frozen=True, eq=False)
class _Item:
    """An entry with the key that came with it (see `put`); None only waits for the earlier ones. `kept`: see `keep`."""

    entry: Entry | None
    key: str
    kept: bool = False
    future: "Future[int]" = field(default_factory=lambda: Future[int]())


class AuditWriter:
    """Writes the audit in a thread, as a context manager: a caller can wait without blocking the event loop.

    One writer and one transaction for all waiting entries: a flood of requests is not a flood of transactions. A stop
    is executed whether or not the database accepts its entry; the entry is kept and written later. The user of the key
    that came with a stop is looked up here, because the stop itself does not wait for the database.
    """

    def __init__(self, store: AuditStore, *callers: Callers, each_minute: Callable[[bool], None] | None = None) -> None:
        """`callers`: where the user of a key is looked up. `each_minute`: called in the thread of the writer, with
        whether it is the last time; may raise SQLAlchemyError, AuditUnreadable.
        """
        self.store = store
        self._callers, self._each_minute = callers, each_minute
        self._waiting: queue.Queue[_Item | None] = queue.Queue()
        self._refused: list[_Item] = []  # kept entries that the database refused, oldest first
        self._thread = threading.Thread(target=self._write, name="audit", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Waiting entries are written first."""
        self._waiting.put(None)
        self._thread.join()

    def settle(self, within: float) -> None:
        """Block until the entries so far are written or refused, for at most `within` s."""
        wait([self.put(None)], within)

    def put(self, entry: Entry | None, key: str = "") -> "Future[int]":
        """From any thread, without waiting. Result: the number of the entry once it is on disk, or NotAudited.

        `key`: its user becomes the actor of the entry, with the role.
        """
        return self._queue(_Item(entry, key))

    def keep(self, entry: Entry, key: str = "") -> "Future[int]":
        """As `put`, for actions that do not wait for the audit: a refused entry is written later.

        `happened` of the entry is now, `at` is the time of writing.
        """
        return self._queue(_Item({"happened": now().isoformat(), **entry}, key, kept=True))

    def _queue(self, item: _Item) -> "Future[int]":
        waiting = self._waiting.qsize() + len(self._refused)
        if waiting >= 2000 or not self._thread.is_alive():
            self._give_up(item, "the queue of the audit is full")
        else:
            self._waiting.put(item)
        return item.future

    def _write(self) -> None:
        ended, due = False, time.monotonic()
        while not ended:
            items, ended = self._next(max(0.0, due - time.monotonic()))
            self._append([*self._refused, *(item for item in items if item.future.set_running_or_notify_cancel())])
            if ended or time.monotonic() >= due:
                self._keep(ended)
                due = time.monotonic() + 60.0  # s
        for item in self._refused:
            self._give_up(item, "the service ended before the database stored the entry")

    def _keep(self, ended: bool) -> None:
        if self._each_minute is None:
            return
        try:
            self._each_minute(ended)
        except (SQLAlchemyError, AuditUnreadable) as error:
            _log.warning("time_or_head_not_stored", reason=str(error).partition("\n")[0])

    def _next(self, within: float) -> tuple[list[_Item], bool]:
        """Waiting entries, and whether the end is reached. Empty after `within` s, earlier if refused entries wait."""
        items: list[_Item] = []
        try:
            # s until a refused entry is written again
            found = self._waiting.get(timeout=min(within, 1.0) if self._refused else within)
        except queue.Empty:
            return items, False
        while found is not None:
            items.append(found)
            if len(items) >= 100 or self._waiting.empty():
                return items, False
            found = self._waiting.get()
        return items, True

    def _append(self, items: list[_Item]) -> None:
        if not items:
            return
        try:
            number = self.store.append([self._named(each.entry, each.key) for each in items if each.entry is not None])
        except SQLAlchemyError as error:
            self._refused = [item for item in items if item.kept]
            for item in items:
                if not item.kept:
                    self._give_up(item, f"the audit cannot be written: {type(error).__name__}")
            return
        self._refused = []
        for item in items:
            item.future.set_result(number)
            number += item.entry is not None

    @staticmethod
    def _give_up(item: _Item, why: str) -> None:
        _log.error("not_audited", entry=None if item.entry is None else dict(item.entry), reason=why)
        item.future.set_exception(NotAudited(why))

    def _named(self, entry: Entry, key: str) -> Entry:
        for callers in self._callers if key else ():
            found = callers.find(key)
            if found is not None and not found.trouble(callers.now()):
                return {**entry, "actor": found.name, "role": found.role.word}
        return entry
