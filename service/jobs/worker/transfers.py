"""Transfers recordings to and from the object store, in a separate process.

Encryption and waiting for a network must not delay the thread that streams set-points.
"""

import asyncio
from concurrent.futures import CancelledError as Cancelled
from dataclasses import dataclass

from service.jobs.worker.process import WorkerProcess
from service.jobs.worker.worker import JobFailed
from service.model.errors import BadInput, NotNow
from service.store.files.recordings import RecordingFile


@dataclass(frozen=True, slots=True)
class Refused:
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

    def __call__(self) -> Refused | None:
        from service.store.objects import ObjectStore, bring

        try:
            if not self.outward:
                bring(self.file)
            elif self.file.store is None:
                return Refused("recordings_url", "is not set")
            else:
                ObjectStore(self.file.store).put(self.file.path, self.file.sha256)
        except BadInput as error:
            return Refused(error.place, error.reason)
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

    async def move(self, file: RecordingFile) -> Refused | None:
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
