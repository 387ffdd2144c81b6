"""The head of the audit outside of the database: a line of the log and of a file, so that a chain that was cut off or
made anew is noticed although it fits in itself.
"""

import os
import time
from collections.abc import Callable
from pathlib import Path

import structlog

from service.store.access.audit_chain import FIRST, Head
from service.store.database import Database
from service.store.people.audit import AuditStore
from service.store.people.time import keep_time

_log = structlog.get_logger(__name__)

EVERY = 600.0  # s between two heads, if entries were added


class AuditHeads:
    """Used by one thread."""

    def __init__(self, store: AuditStore, file: Path, monotonic: Callable[[], float] = time.monotonic) -> None:
        """`file`: only ever added to; may be on another computer."""
        self._store, self._file, self._monotonic = store, file, monotonic
        self._last: Head = (0, FIRST)
        self._noted = monotonic() - EVERY

    def note(self, at_end: bool = False) -> None:
        """Write the head if it is new and the last one is `EVERY` s old, or at the end. Blocks. Raises
        AuditUnreadable; a file that cannot be written is only logged, with the head.
        """
        if not at_end and self._monotonic() - self._noted < EVERY:
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


def keeping_time_and_head(database: Database, heads_file: Path) -> Callable[[bool], None]:
    """What a service does each minute, and at its end (True): stores the time of sessions and keys, notes the head."""
    heads = AuditHeads(AuditStore(database), heads_file)

    def each_minute(ended: bool) -> None:
        keep_time(database)
        heads.note(at_end=ended)

    return each_minute
