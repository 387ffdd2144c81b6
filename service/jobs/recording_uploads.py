"""Moves recordings to the object store after their sweep is stored, and frees local disk space.

The store's rows are the outbox: recordings not marked as moved are found again after a restart. A recording is marked
after all of it was read back, and its file is removed only after that. Only the free disk space depends on it.
Encryption and waiting for a network must not delay the thread that streams set-points: a process of its own does it.
"""

import asyncio
import time
from concurrent.futures import CancelledError as Cancelled
from dataclasses import dataclass, replace

import structlog
from sqlalchemy.exc import SQLAlchemyError
from structlog.contextvars import bound_contextvars

from service import BadInput, NotNow
from service.jobs.work import JobFailed
from service.jobs.worker import WorkerProcess
from service.process.settings import Settings
from service.store.database import refusal
from service.store.documents import RecordingDocument
from service.store.files.recordings import RecordingFile, RecordingFiles
from service.store.retention import Backlog, MoveStore, make_room


@dataclass(frozen=True, slots=True)
class TransferRefused:
    """Why a file cannot be transferred now or later without a correction by a person."""

    place: str
    reason: str


@dataclass(frozen=True, slots=True)
class TransferJob:
    """Copy a recording to the store and read it back (`outward`), or fetch it to its path: None if it is there, with
    identical content. NotNow.
    """

    file: RecordingFile
    outward: bool

    @property
    def key(self) -> str:
        return f"{'move' if self.outward else 'fetch'}-{self.file.sha256}"

    @property
    def priority(self) -> int:
        return 0 if self.outward else 1  # a caller waits for what is fetched

    def __call__(self) -> TransferRefused | None:
        from service.store.objects import ObjectStore, bring

        try:
            if not self.outward:
                bring(self.file)
            elif self.file.store is None:
                return TransferRefused("recordings_url", "is not set")
            else:
                ObjectStore(self.file.store).put(self.file.path, self.file.sha256)
        except BadInput as error:
            return TransferRefused(error.place, error.reason)
        return None


class Transfers:
    """The process for both directions, one file at a time. Create it in the event loop."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._process = WorkerProcess()
        self._closed = False

    @property
    def trouble(self) -> str:
        """Why no file can be transferred now on this computer; empty if no reason is known."""
        return self._process.trouble

    async def move(self, file: RecordingFile) -> TransferRefused | None:
        """NotNow while the store is not reachable."""
        try:
            return await self._process.run(TransferJob(file, outward=True))
        except JobFailed as error:
            raise NotNow(str(error)) from None

    def fetch(self, file: RecordingFile) -> None:
        """Blocks; for any thread but that of the event loop. BadInput; NotNow while the store is not reachable."""
        if self._closed:
            raise NotNow("the service ends")
        try:
            refused = asyncio.run_coroutine_threadsafe(
                self._process.run(TransferJob(file, outward=False)), self._loop
            ).result()
        except JobFailed as error:
            raise NotNow(str(error)) from None
        except Cancelled:
            raise NotNow("the service ends") from None
        if refused is not None:
            raise BadInput(refused.place, refused.reason)

    async def close(self) -> None:
        """Cancel all transfers; their callers get an exception."""
        self._closed = True
        await self._process.close()


_log = structlog.get_logger(__name__)


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
        self._look = min(2.0, self._longest)  # s between searches for new recordings
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
        while found := await asyncio.to_thread(self._moves.waiting, last, 50):
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
