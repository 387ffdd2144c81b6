"""Writes the audit in a separate thread: a caller can wait without blocking the event loop or a thread.

Once a minute, and at the end, it also stores what must survive a restart or a change of the database (`each_minute`):
the time of sessions and keys, and the head of the audit.

One writer and one transaction for all waiting entries: a flood of requests is not a flood of transactions. A stop is
executed whether or not the database accepts its entry; the entry is kept and written later. The user of the key that
came with a stop is looked up here, because the stop itself does not wait for the database.
"""

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

import structlog
from sqlalchemy.exc import SQLAlchemyError

from service.model.errors import SweepidError
from service.store.access.audit_chain import Entry
from service.store.access.callers import Callers
from service.store.people.audit import AuditStore, AuditUnreadable
from service.store.tables import now

_log = structlog.get_logger(__name__)

_MOST_WAITING = 2000
_AT_ONCE = 100
_MINUTE = 60.0  # s
_AGAIN = 1.0  # s until a refused entry is written again


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
    """Used as a context manager."""

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
        if waiting >= _MOST_WAITING or not self._thread.is_alive():
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
                due = time.monotonic() + _MINUTE
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
            found = self._waiting.get(timeout=min(within, _AGAIN) if self._refused else within)
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
            if found is not None and not found.trouble(callers.now()):
                return {**entry, "actor": found.name, "role": found.role.word}
        return entry
