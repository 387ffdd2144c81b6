"""Writes the audit from a thread of its own: who asks waits, if at all, without holding the event loop or a thread.

One writer, one transaction for all that waits: a flood of requests is no flood of transactions beside the lease.
Whose key it was that came with a stop is looked up here: the stop itself waits for no database.
"""

import queue
import threading
from concurrent.futures import Future, wait
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


class NotAudited(SweepidError):
    """The audit cannot be written, so nothing is done either (API: 503)."""


_Item = tuple[Entry | None, str, "Future[int]"]  # with a key; None: only waits for those before it


class AuditWriter:
    """A context."""

    def __init__(self, store: AuditStore, *callers: Callers) -> None:
        """`callers`: where whose key it was is looked up."""
        self.store = store
        self._callers = callers
        self._waiting: queue.Queue[_Item | None] = queue.Queue()
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
        future: Future[int] = Future()
        if self._waiting.qsize() >= _MOST_WAITING or not self._thread.is_alive():
            future.set_exception(NotAudited("more waits for the audit than it takes"))
            _log.error("not_audited", entry=None if entry is None else dict(entry), reason="too much waits")
        else:
            self._waiting.put((entry, key, future))
        return future

    def _write(self) -> None:
        while (first := self._waiting.get()) is not None:
            items, ended = [first], False
            while len(items) < _AT_ONCE and not self._waiting.empty():
                item = self._waiting.get()
                if item is None:
                    ended = True
                    break
                items.append(item)
            self._append([item for item in items if item[2].set_running_or_notify_cancel()])
            if ended:
                return

    def _append(self, items: list[_Item]) -> None:
        if not items:
            return
        try:
            number = self.store.append([self._named(entry, key) for entry, key, _ in items if entry is not None])
        except SQLAlchemyError as error:
            for entry, _, future in items:
                _log.error("not_audited", entry=None if entry is None else dict(entry), reason=type(error).__name__)
                future.set_exception(NotAudited(f"the audit cannot be written: {type(error).__name__}"))
            return
        for entry, _, future in items:
            future.set_result(number)
            number += entry is not None

    def _named(self, entry: Entry, key: str) -> Entry:
        for callers in self._callers if key else ():
            found = callers.find(key)
            if found is not None and not found.trouble(now()):
                return {**entry, "actor": found.name, "role": found.role.word}
        return entry
