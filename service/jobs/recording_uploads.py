"""Moves recordings to the object store after their sweep is stored, and frees local disk space.

The store's rows are the outbox: recordings not marked as moved are found again after a restart. A recording is marked
after all of it was read back, and its file is removed only after that. Only the free disk space depends on it.
"""

import asyncio
import time
from dataclasses import dataclass, replace

import structlog
from sqlalchemy.exc import SQLAlchemyError
from structlog.contextvars import bound_contextvars

from service.jobs.worker.transfers import Transfers
from service.model.errors import NotNow
from service.process.settings import Settings
from service.store.database import refusal
from service.store.documents import RecordingDocument
from service.store.files.recordings import RecordingFiles
from service.store.retention import Backlog, MoveStore, make_room

_log = structlog.get_logger(__name__)

LOOK = 2.0  # s between searches for new recordings
_AT_ONCE = 50  # rows


@dataclass(frozen=True, slots=True)
class _Refusal:
    why: str
    until: float  # monotonic clock, s: no attempt before


class RecordingUploads:
    """Uses the settings `data_dir`, `recordings_cache` and `recordings_retry`."""

    def __init__(self, moves: MoveStore, files: RecordingFiles, settings: Settings, transfers: Transfers) -> None:
        self._moves, self._files, self._transfers = moves, files, transfers
        self._data_dir, self._cache = settings.data_dir, settings.recordings_cache
        self._longest = settings.recordings_retry
        self._look = min(LOOK, self._longest)
        self._away = ""
        self._refused: dict[int, _Refusal] = {}  # by the recording's row

    def backlog(self) -> Backlog:
        """The waiting recordings. Blocks."""
        backlog = self._moves.backlog()
        refused = [each.why for each in self._refused.values()]
        lines = [line for line in (self._away, self._transfers.trouble, *refused[:3]) if line]
        return replace(backlog, trouble="; ".join(lines))

    async def follow(self) -> None:
        """Move recordings until cancelled."""
        pause = self._look
        while True:
            try:
                await self._move_all()
                await asyncio.to_thread(make_room, self._data_dir, self._cache, self._moves.moved)
                self._away, pause = "", self._look
            except (NotNow, SQLAlchemyError, OSError) as error:
                reason = refusal(error) if isinstance(error, SQLAlchemyError) else str(error)
                pause = min(2 * pause, self._longest)
                _log.warning("recordings_wait", reason=reason, again_in=pause)
                self._away = reason
            await asyncio.sleep(pause)

    async def _move_all(self) -> None:
        """Move each waiting recording, oldest first. NotNow at the first one that the store does not accept now."""
        last = 0
        while found := await asyncio.to_thread(self._moves.waiting, last, _AT_ONCE):
            for number, document in found.items():
                last = number
                if number in self._refused and time.monotonic() < self._refused[number].until:
                    continue
                with bound_contextvars(campaign=document.campaign_id, sweep=document.number):
                    await self._move(number, document)

    async def _move(self, number: int, document: RecordingDocument) -> None:
        """NotNow if the store does not accept it now."""
        refused = await self._transfers.move(self._files.reference(document))
        if refused is None:
            await asyncio.to_thread(self._moves.mark, number)
            self._away = ""
            self._refused.pop(number, None)
            _log.info("moved", recording=document.path, sha256=document.sha256)
        else:
            why = f"{refused.place}: {refused.reason}"
            self._refused[number] = _Refusal(why, time.monotonic() + self._longest)
            _log.error("not_moved", recording=document.path, place=refused.place, reason=refused.reason)
