"""The samples of a running sweep, or of those of a trajectory, as they arrive: monitored, published, written."""

import asyncio
from collections import deque
from collections.abc import AsyncIterable, Awaitable, Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import SweepInterrupted
from drivers.ports import SampleBlock, SweepCommand
from service.machine.execution.motion import Command
from service.machine.execution.recording import Gapless, Recorder
from service.model.errors import EnvelopeViolation
from service.model.results.spectrum import Facts
from service.planning.campaigns.live import LiveHub
from service.planning.compiled_plan import CompiledPlan
from service.process.logs import in_executor
from service.process.tasks import run_to_end
from service.store.documents import SweepDocument
from service.store.files.recordings import RecordingFiles, SweepAttempt


@dataclass(frozen=True, slots=True)
class BegunSweep:
    """A sweep in progress."""

    sweep: SweepDocument
    run: SweepAttempt
    command: Command
    facts: Facts


class Incoming:
    """Samples of sweeps that run together.

    They are monitored as they arrive, independent of the disk: blocks wait in memory, at most all samples of these
    sweeps. `stop` stops the machine; `disk` is the one thread that writes.
    """

    def __init__(
        self,
        together: Sequence[BegunSweep],
        compiled: CompiledPlan,
        stop: Callable[[], Awaitable[None]],
        hub: LiveHub,
        disk: ThreadPoolExecutor,
    ) -> None:
        self._together, self._compiled, self._stop, self._hub, self._disk = together, compiled, stop, hub, disk
        self._by_joint = {each.command.joint: each for each in together}
        self._came = {joint: Gapless() for joint in self._by_joint}
        self._recorders: dict[str, Recorder] = {}
        self._streams = ExitStack()  # of the disk's thread alone: an opening may end after its waiter was cancelled
        self._writes: deque[Future[None]] = deque()
        self._off_path: EnvelopeViolation | None = None  # how an axis left its path in a trajectory

    @property
    def waiting(self) -> int:
        """Number of blocks that are not yet on disk."""
        return len(self._writes)

    async def open(self, files: RecordingFiles) -> None:
        """Create a stream for each sweep. Raises OSError."""
        for joint, each in self._by_joint.items():
            stream = files.stream(each.run)
            self._recorders[joint] = await in_executor(self._disk, self._open, stream, each.command)

    async def take(self, blocks: AsyncIterable[SampleBlock]) -> None:
        """Take all blocks, to the end of the sweep.

        Raises EnvelopeViolation if an axis leaves its envelope or its path; the machine is then stopped. An axis that
        already brakes leaves its path as well: then the error is the cause of the braking.
        """
        try:
            async for block in blocks:
                await self._take(block)
        except SweepInterrupted as stopped:  # any other error came before: braking axes leave their path
            raise self._off_path or stopped from None
        if self._off_path is not None:
            raise self._off_path

    async def written(self) -> None:
        """Wait until all is on disk. Raises SamplesMissing if the samples end before the measured window."""
        for write in self._writes:
            await run_to_end(asyncio.wrap_future(write))
        for recorder in self._recorders.values():
            recorder.check_complete()

    def close(self) -> None:
        """Close the streams. Does not wait for the disk: after an error the axes have priority."""
        self._disk.submit(self._streams.close)

    def _open(self, stream: Path, command: Command) -> Recorder:
        recorder = Recorder(stream, command)
        self._streams.callback(recorder.close)
        return recorder

    async def _take(self, block: SampleBlock) -> None:
        each = self._by_joint.get(block.joint, self._together[0])
        joint = each.command.joint
        self._writes.append(self._disk.submit(self._recorders[joint].write, block))
        if self._off_path is None:
            await self._watch(each, block)
        self._hub.publish(each.run.campaign_id, each.run.number, block)
        if self._off_path is None:
            self._came[joint].check(block)
        self._came[joint].add(block)
        while self._writes and self._writes[0].done():
            self._writes.popleft().result()  # a write error ends the sweep

    async def _watch(self, each: BegunSweep, block: SampleBlock) -> None:
        """Stop the machine if the axis left its envelope, with EnvelopeViolation, or its path in a trajectory."""
        try:
            self._compiled.envelope.watch(each.command, block)
        except EnvelopeViolation:
            await self._stop()
            raise
        if len(self._together) == 1 or not isinstance(each.command, SweepCommand):
            return
        start = each.sweep.spec.pose[self._compiled.joints.index(block.joint)]
        try:
            self._compiled.envelope.watch_path(each.command, start, block)
        except EnvelopeViolation as left:
            await self._stop()
            self._off_path = left
