"""Writes the audit from a thread of its own: who asks waits, if at all, without holding the event loop or a thread.

One writer, one transaction for all that waits: a flood of requests is no flood of transactions beside the lease.
A stop happens whether the database takes its entry or not, so its entry is kept and written as soon as that does.
Whose key it was that came with a stop is looked up here: the stop itself waits for no database.
"""

import queue
import threading
from concurrent.futures import Future, wait
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

import structlog
from sqlalchemy.exc import SQLAlchemyError

from service.errors import SweepidError
from service.people.callers import Callers
from service.people.chain import Entry
from service.store.people.audit import AuditStore
from service.store.tables import now

_log = structlog.get_logger(__name__)

_MOST_WAITING = 2000
_AT_ONCE = 100
_AGAIN = 1.0  # s until the database is asked again to take what it refused


class NotAudited(SweepidError):
    """The audit cannot be written, so nothing is done either (API: 503)."""


@dataclass(frozen=True, eq=False)
class _Item:
    """An entry with the key that came with it (see `put`); None only waits for those before it. `kept`: see `keep`."""

    entry: Entry | None
    key: str
    kept: bool = False
    future: "Future[int]" = field(default_factory=lambda: Future[int]())


class AuditWriter:
    """A context."""

    def __init__(self, store: AuditStore, *callers: Callers) -> None:
        """`callers`: where whose key it was is looked up."""
        self.store = store
        self._callers = callers
        self._waiting: queue.Queue[_Item | None] = queue.Queue()
        self._refused: list[_Item] = []  # kept ones that the database has not taken, oldest first
        self._thread = threading.Thread(target=self._write, name="audit", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """What waits is written first."""
        self._waiting.put(None)
        self._thread.join()

    def settle(self, within: float) -> None:
        """Blocks until what was put so far is written or refused, for `within` s at most."""
        wait([self.put(None)], within)

    def put(self, entry: Entry | None, key: str = "") -> "Future[int]":
        """From any thread, waits for nothing. The entry's number once it is on disk, or NotAudited.

        `key`: whose it is becomes the entry's actor, with the role.
        """
        return self._queue(_Item(entry, key))

    def keep(self, entry: Entry, key: str = "") -> "Future[int]":
        """As `put`, for what was done without asking: one that the database refuses is written when it takes it.

        `happened` of the entry is now, `at` is when it was written.
        """
        return self._queue(_Item({"happened": now().isoformat(), **entry}, key, kept=True))

    def _queue(self, item: _Item) -> "Future[int]":
        waiting = self._waiting.qsize() + len(self._refused)
        if waiting >= _MOST_WAITING or not self._thread.is_alive():
            self._give_up(item, "more waits for the audit than it takes")
        else:
            self._waiting.put(item)
        return item.future

    def _write(self) -> None:
        ended = False
        while not ended:
            items, ended = self._next()
            self._append([*self._refused, *(item for item in items if item.future.set_running_or_notify_cancel())])
        for item in self._refused:
            self._give_up(item, "the service ended before the database took it")

    def _next(self) -> tuple[list[_Item], bool]:
        """What waits, and whether the end is reached. Nothing after a while in which refused ones wait."""
        items: list[_Item] = []
        try:
            found = self._waiting.get(timeout=_AGAIN if self._refused else None)
        except queue.Empty:
            return items, False
        while found is not None:
            items.append(found)
            if len(items) >= _AT_ONCE or self._waiting.empty():
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
            if found is not None and not found.trouble(now()):
                return {**entry, "actor": found.name, "role": found.role.word}
        return entry
