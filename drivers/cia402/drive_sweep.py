"""The drive-side sweep or noise run: a task starts the measuring function, monitors it, and reads its trace in pages.

The task runs whether or not the samples are consumed, so that the live checks do not depend on a slow consumer.
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

LIVE_TIME = 0.1  # s; shortest page that is read during the run
POLL = 0.01  # s
STALLED = 5.0  # s without a new sample
REST = 2.0  # s from the end of a run to standstill
OVERLONG = 1.6  # times the expected samples: a trace cycle in whole ms may be shorter than requested


class DriveSweep:
    """One run. `stop` (a threading.Event) may be set from any thread; the task then stops the axis and ends."""

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
        """The samples as they arrive; raises the error that ended the run early."""
        while (block := await self._blocks.get()) is not None:
            yield block
        await asyncio.shield(self._task)

    def timing(self) -> None:
        """None: the drive generates the set-points."""

    streams = False

    def halt(self) -> None:
        """Nothing to do: the drive already has its stop command, and the stop event ends the run."""

    async def interrupted(self) -> None:
        """Nothing to do: the stop sequence may begin, because this run only reads."""

    async def over(self) -> None:
        """Wait until the run has ended, in whatever way. Its error is raised to the consumer, not here."""
        await asyncio.wait([self._task])
        if not self._task.cancelled():
            self._task.exception()  # retrieved, so that asyncio does not log it

    async def _run(self) -> None:
        try:
            async with prepared(self._thread, self._axis, self._command):
                await self._thread.run(self._start)
                await self._follow_down()
        finally:
            self._blocks.put_nowait(None)

    async def _follow_down(self) -> None:
        """Follow the run to its end. After an error, run the stop sequence to standstill and raise the error."""
        try:
            await self._follow()
        except DriveError as error:  # the axis is no longer monitored: stop it without waiting for the consumer
            await self._bring_down()
            if isinstance(error, DriveFault | EnvelopeLeft | SweepInterrupted | MotionForbidden):
                await self._hand_over(await self._thread.run(self._axis.device.samples_recorded))
            else:
                await self._thread.run(self._look_for_cause)
            raise

    def _start(self) -> None:
        """On the machine's thread, so that no stop can come between the check and the start."""
        if self._stop.is_set():
            raise SweepInterrupted(self._axis.place, "sweep was stopped before it started")
        self._axis.start_measuring()

    async def _follow(self) -> None:
        grown = time.monotonic()
        while True:
            if self._stop.is_set():
                raise SweepInterrupted(self._axis.place, "sweep was stopped")
            state, recorded = await self._thread.run(self._watch)
            if state is MeasuringState.DONE:
                await self._hand_over(recorded)
                await self._come_to_rest()
                return
            if state is not MeasuringState.RUNNING:
                await self._thread.run(self._ended, state)
            if recorded > self._most:  # on the drive's clock; a run without offset would never leave its window
                raise EnvelopeLeft(self._axis.place, f"still runs after {recorded} samples, limit {self._most}")
            if recorded - self._done >= self._live:
                grown = time.monotonic()
                await self._hand_over(min(recorded, self._done + self._largest))
                continue
            if time.monotonic() - grown > STALLED:
                raise CommunicationLost(self._axis.place, f"no new sample of the measuring function for {STALLED} s")
            await asyncio.sleep(POLL)

    async def _come_to_rest(self) -> None:
        """After torque noise an axis with softened control oscillates for a moment."""
        deadline = time.monotonic() + REST
        while True:
            reading = await self._thread.run(self._axis.read)
            self._axis.check(reading.state)
            if self._axis.stands(reading):
                return
            if self._stop.is_set() or time.monotonic() > deadline:
                raise SweepInterrupted(
                    self._axis.place,
                    f"still moves after its sweep, at {reading.velocity:.4g} {self._axis.profile.unit}/s",
                )
            await asyncio.sleep(POLL)

    def _watch(self) -> tuple[MeasuringState, int]:
        """State first, then the count: after DONE the count is final."""
        reading = self._axis.read()
        self._axis.check(reading.state)
        violation = self._envelope.violation(reading.position, reading.velocity, reading.effort)
        if violation is not None:
            text, measured = violation
            raise EnvelopeLeft(self._axis.place, text, measured=measured)
        return self._axis.device.measuring_state(), self._axis.device.samples_recorded()

    def _look_for_cause(self) -> None:
        """A refused or invalid answer may be caused by a fault or a restart; raises that one."""
        self._axis.device.measuring_state()
        self._axis.check_standing()

    def _ended(self, state: MeasuringState) -> None:
        """Raises the error that ended the run: a fault may have occurred after `_watch` read the statusword."""
        self._axis.check(self._axis.state())
        raise SweepInterrupted(self._axis.place, f"the drive ended the sweep: {state.name.lower()}")

    async def _hand_over(self, recorded: int) -> None:
        while self._done < recorded:
            count = min(self._largest, recorded - self._done)
            self._blocks.put_nowait(await self._thread.run(self._axis.device.page, self._done, count))
            self._done += count
