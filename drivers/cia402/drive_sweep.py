"""The drive-side sweep or noise run: a task starts the measuring function, watches it, and pages its trace out as it
grows.

The task runs whether or not the samples are being consumed, so that the live checks never wait for a slow consumer.
"""

import asyncio
import threading
import time
from collections.abc import AsyncGenerator, Awaitable, Callable

from drivers.cia402.axis import Axis
from drivers.cia402.checks import Envelope
from drivers.cia402.device import MeasuringState
from drivers.cia402.preparation import prepared
from drivers.cia402.thread import DriveThread
from drivers.errors import CommunicationLost, DriveError, DriveFault, EnvelopeLeft, MotionForbidden, SweepInterrupted
from drivers.ports import NoiseCommand, SampleBlock, SweepCommand

LIVE_TIME = 0.1  # s of samples that make a page worth while during the run
POLL = 0.01  # s
STALLED = 5.0  # s without a new sample
REST = 2.0  # s from the end of a run to standstill
OVERLONG = 1.6  # of the samples that the run should have: a trace cycle in whole ms may be finer than asked for


class DriveSweep:
    """One run. `stop` (a threading.Event) may be set from any thread; the task then brings the axis down and ends."""

    def __init__(
        self,
        thread: DriveThread,
        axis: Axis,
        command: SweepCommand | NoiseCommand,
        envelope: Envelope,
        stop: threading.Event,
        bring_down: Callable[[], Awaitable[None]],
    ) -> None:
        """`bring_down` is the stop sequence of the axis."""
        self._thread, self._axis, self._command = thread, axis, command
        self._envelope, self._stop, self._bring_down = envelope, stop, bring_down
        self._largest = axis.device.page_size
        self._live = max(1, min(self._largest, round(LIVE_TIME * command.sample_rate)))
        self._most = round(OVERLONG * (command.duration + 1.0) * command.sample_rate)
        self._done = 0  # samples handed over
        self._blocks: asyncio.Queue[SampleBlock | None] = asyncio.Queue()
        self._task = asyncio.create_task(self._run(), name="drive-side sweep")

    async def blocks(self) -> AsyncGenerator[SampleBlock, None]:
        """The samples as they come; raises what ended the run early."""
        while (block := await self._blocks.get()) is not None:
            yield block
        await asyncio.shield(self._task)

    def timing(self) -> None:
        """The drive makes the set-points."""

    streams = False

    def halt(self) -> None:
        """The drive has its word already; the stop event ends the run."""

    async def interrupted(self) -> None:
        """The stop sequence may begin: this run only reads."""

    async def over(self) -> None:
        """Until the run has ended, however it did: that is the consumer's matter."""
        await asyncio.wait([self._task])
        if not self._task.cancelled():
            self._task.exception()  # noted: asyncio does not tell of it once more

    async def _run(self) -> None:
        try:
            async with prepared(self._thread, self._axis, self._command):
                await self._thread.run(self._start)
                await self._follow_down()
        finally:
            self._blocks.put_nowait(None)

    async def _follow_down(self) -> None:
        """To the run's end, or to standstill by the stop sequence with what ended it."""
        try:
            await self._follow()
        except DriveError as error:  # nobody watches the axis from here on: it must not wait for the consumer
            await self._bring_down()
            if isinstance(error, DriveFault | EnvelopeLeft | SweepInterrupted | MotionForbidden):
                await self._hand_over(await self._thread.run(self._axis.device.samples_recorded))
            else:
                await self._thread.run(self._look_for_cause)
            raise

    def _start(self) -> None:
        """On the machine's thread, so that no stop can come between the question and the start."""
        if self._stop.is_set():
            raise SweepInterrupted(f"{self._axis.place}: sweep was stopped before it started")
        self._axis.start_measuring()

    async def _follow(self) -> None:
        grown = time.monotonic()
        while True:
            if self._stop.is_set():
                raise SweepInterrupted(f"{self._axis.place}: sweep was stopped")
            state, recorded = await self._thread.run(self._watch)
            if state is MeasuringState.DONE:
                await self._hand_over(recorded)
                await self._come_to_rest()
                return
            if state is not MeasuringState.RUNNING:
                await self._thread.run(self._ended, state)
            if recorded > self._most:  # by the drive's own clock; a run without offset would never leave its window
                raise EnvelopeLeft(f"{self._axis.place}: runs on after {recorded} samples, {self._most} are the limit")
            if recorded - self._done >= self._live:
                grown = time.monotonic()
                await self._hand_over(min(recorded, self._done + self._largest))
                continue
            if time.monotonic() - grown > STALLED:
                raise CommunicationLost(f"{self._axis.place}: no new sample of the measuring function for {STALLED} s")
            await asyncio.sleep(POLL)

    async def _come_to_rest(self) -> None:
        """A softly controlled axis swings on for a moment after torque noise."""
        deadline = time.monotonic() + REST
        while True:
            reading = await self._thread.run(self._axis.read)
            self._axis.check(reading.state)
            if self._axis.stands(reading):
                return
            if self._stop.is_set() or time.monotonic() > deadline:
                raise SweepInterrupted(
                    f"{self._axis.place}: after its run still moves at {reading.velocity:.4g} "
                    f"{self._axis.profile.unit}/s"
                )
            await asyncio.sleep(POLL)

    def _watch(self) -> tuple[MeasuringState, int]:
        """State first, then the count: after DONE the count is final."""
        reading = self._axis.read()
        self._axis.check(reading.state)
        violation = self._envelope.violation(reading.position, reading.velocity, reading.effort)
        if violation is not None:
            raise EnvelopeLeft(f"{self._axis.place}: {violation}")
        return self._axis.device.measuring_state(), self._axis.device.samples_recorded()

    def _look_for_cause(self) -> None:
        """What was refused or not understood may come of a fault or a restart; raises that."""
        self._axis.device.measuring_state()
        self._axis.check_standing()

    def _ended(self, state: MeasuringState) -> None:
        """Raises what ended it: a fault may have come after `_watch` had asked for the statusword."""
        self._axis.check(self._axis.state())
        raise SweepInterrupted(f"{self._axis.place}: the drive ended the sweep: {state.name.lower()}")

    async def _hand_over(self, recorded: int) -> None:
        while self._done < recorded:
            count = min(self._largest, recorded - self._done)
            self._blocks.put_nowait(await self._thread.run(self._axis.device.page, self._done, count))
            self._done += count
