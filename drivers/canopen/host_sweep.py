"""The host-streamed sweep: one thread sends set-point and SYNC by absolute deadlines and takes in the answers.

In cyclic synchronous velocity the set-point sent before SYNC k is reached one period later, so that at the instant of
SYNC k, time k T on the drive's clock, the axis is asked for w(k T). A late cycle shifts the wall clock alone: deadlines
that passed are counted and left out, never made up in a burst.
"""

import asyncio
import ctypes
import queue
import sys
import threading
import time
from collections.abc import AsyncGenerator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from drivers.canopen import frames
from drivers.canopen.bus import Bus
from drivers.canopen.ladder import Ladder, Rung
from drivers.canopen.samples import Pairing, Sample
from drivers.canopen.units import Codec
from drivers.cia402 import states
from drivers.cia402.checks import Envelope
from drivers.canopen.profile import BusProfile
from drivers.canopen.profile import CanopenAxis as AxisProfile
from drivers.cia402.states import State
from drivers.cia402.waveform import set_point
from drivers.ports import SampleBlock, SweepCommand

BLOCK_TIME = 0.1  # s of samples handed over at a time
STANDING_SAMPLES = 5  # in a row below the standstill velocity
STANDSTILL_TIMEOUT = 3.0  # s after the waveform's end
HOLD_TIMEOUT = 5.0  # s of waiting at standstill for the mode to be left


class Ending(Enum):
    """Why the stream ended."""

    COMPLETED = "completed"
    STOPPED = "stopped"
    LEFT_ENVELOPE = "left its envelope"
    LEFT_STATE = "left 'operation enabled'"
    SILENT = "fell silent"
    NO_STANDSTILL = "did not come to standstill"


@dataclass(slots=True)
class Timing:
    """How punctual the cycles were: lateness of each cycle, s, and deadlines left out."""

    lateness: list[float] = field(default_factory=list)
    missed: int = 0


class HostSweep:
    """One run. `stop` (a threading.Event) may be set from any thread and starts the ladder."""

    def __init__(
        self,
        bus: Bus,
        axis: AxisProfile,
        settings: BusProfile,
        codec: Codec,
        command: SweepCommand,
        envelope: Envelope,
        counter: int,
        stop: threading.Event,
    ) -> None:
        """`counter` is 2120h:01 as read at standstill, before the first SYNC."""
        period = settings.sync_period
        self.timing = Timing()
        self.ending = Ending.COMPLETED
        self.reason = ""
        self._bus, self._axis, self._codec, self._command = bus, axis, codec, command
        self._envelope, self._stop, self._period = envelope, stop, period
        self._last = round(command.duration / period)  # index of the last sample
        self._wave = set_point(command, np.arange(self._last + 1, dtype=float) * period)
        self._targets = [codec.raw_velocity(velocity) for velocity in (*self._wave[1:], 0.0)]
        self._ladder = Ladder(
            ramp_step=max(1, round(codec.raw_speed(axis.acceleration) * period)),
            ramp_time=axis.velocity_limit / axis.acceleration + 1.0,
            quick_stop_time=axis.velocity_limit / axis.quick_stop_deceleration + 1.0,
            disable_time=1.0,
        )
        self._silent_cycles = max(3, round(settings.silence / period))
        self._pairing = Pairing(counter)
        self._state = State.OPERATION_ENABLED
        self._standing = 0
        self._since_sample = 0
        self._fresh: list[Sample] = []
        self._released = threading.Event()
        self._loop = asyncio.get_running_loop()
        self._blocks: asyncio.Queue[SampleBlock | None] = asyncio.Queue()
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="can-stream")
        self._thread = self._loop.run_in_executor(self._executor, self._run)
        self._executor.shutdown(wait=False)  # the thread ends with its one task

    async def blocks(self) -> AsyncGenerator[SampleBlock, None]:
        """The samples as they come. Ends when the axis stands: still held (COMPLETED), otherwise disabled."""
        while (block := await self._blocks.get()) is not None:
            yield block
        if self._thread.done():
            self._thread.result()

    def release(self) -> None:
        """End SYNC after COMPLETED, once the axis has left the cyclic mode."""
        self._released.set()

    async def finished(self) -> None:
        """Until the thread has ended; raises what ended it."""
        await asyncio.shield(self._thread)

    async def over(self) -> None:
        """Until the thread has ended, however it did: that is the consumer's matter."""
        await asyncio.wait([self._thread])
        if not self._thread.cancelled():
            self._thread.exception()  # noted: asyncio does not tell of it once more

    # -- the thread ----------------------------------------------------------------------------------------------

    def _run(self) -> None:
        _sharpen_timer()
        events = self._bus.open_stream(self._axis.node)
        try:
            self._cycle(events)
        finally:
            self._bus.close_stream(self._axis.node)
            self._hand_over()
            self._post(None)

    def _cycle(self, events: queue.SimpleQueue[frames.Event]) -> None:
        identifier = frames.RPDO1 + self._axis.node
        number = 0
        target = 0
        deadline = time.monotonic()
        standstill_by = hold_until = float("inf")
        while True:
            now = time.monotonic()
            if self._stop.is_set():
                self._abandon(Ending.STOPPED, "", Rung.RAMP, now, target)
            if self._ladder.rung is Rung.RUN:
                controlword, target = states.ENABLE_OPERATION, self._targets[min(number, self._last)]
            else:
                standing = self._standing >= STANDING_SAMPLES
                controlword, target = self._ladder.command(now, standing, self._state)
            self._bus.send(identifier, frames.rpdo1(controlword, target))
            self._bus.send(frames.SYNC, b"")
            if self._ladder.rung is Rung.DONE:
                return
            self.timing.lateness.append(now - deadline)
            number += 1
            self._since_sample += 1
            deadline += self._period
            late = time.monotonic() - deadline
            if late > 0:
                missed = int(late / self._period) + 1
                self.timing.missed += missed
                deadline += missed * self._period
            self._listen(events, deadline, target)
            if self._since_sample > self._silent_cycles:
                text = f"no sample for {self._since_sample} cycles of {self._period * 1e3:g} ms"
                self._abandon(Ending.SILENT, text, Rung.QUICK_STOP, time.monotonic(), target)
            if number <= self._last or self._ladder.rung is not Rung.RUN:
                continue
            now = time.monotonic()
            if hold_until < float("inf"):  # at standstill, handed over
                if self._released.is_set():
                    return
                if now > hold_until:
                    self._ladder.climb(Rung.QUICK_STOP, now, 0)
            elif self._standing >= STANDING_SAMPLES and number > self._last + STANDING_SAMPLES:
                hold_until = now + HOLD_TIMEOUT
                self._hand_over()
                self._post(None)
            else:
                standstill_by = min(standstill_by, now + STANDSTILL_TIMEOUT)
                if now > standstill_by:
                    self._abandon(Ending.NO_STANDSTILL, "", Rung.QUICK_STOP, now, target)

    def _listen(self, events: queue.SimpleQueue[frames.Event], deadline: float, target: int) -> None:
        """Take events until the deadline; what already waits is taken even if it has passed."""
        while True:
            left = deadline - time.monotonic()
            try:
                event = events.get(timeout=left) if left > 0 else events.get_nowait()
            except queue.Empty:
                return
            if isinstance(event, frames.Motion):
                self._pairing.motion(event)
            elif isinstance(event, frames.Place):
                sample = self._pairing.place(event)
                if sample is not None:
                    self._take(sample, target)
            elif isinstance(event, frames.Emergency) and event.code:
                text = f"error {event.code:04X}h"
                self._abandon(Ending.LEFT_STATE, text, Rung.QUICK_STOP, time.monotonic(), target)

    def _take(self, sample: Sample, target: int) -> None:
        self._since_sample = 0
        self._state = states.decode(sample.statusword)
        velocity = float(self._codec.velocity(sample.velocity))
        self._standing = self._standing + 1 if abs(velocity) <= self._axis.standstill_velocity else 0
        if self._ladder.rung is Rung.RUN:
            if self._state is not State.OPERATION_ENABLED:
                text = f"is '{self._state.value}'"
                self._abandon(Ending.LEFT_STATE, text, Rung.QUICK_STOP, time.monotonic(), target)
            violation = self._envelope.violation(
                float(self._codec.position(sample.position)), velocity, float(self._codec.effort(sample.torque))
            )
            if violation is not None:
                self._abandon(Ending.LEFT_ENVELOPE, violation, Rung.QUICK_STOP, time.monotonic(), target)
        if sample.index <= self._last:
            self._fresh.append(sample)
            if len(self._fresh) * self._period >= BLOCK_TIME:
                self._hand_over()

    def _abandon(self, ending: Ending, reason: str, rung: Rung, now: float, target: int) -> None:
        if self.ending is Ending.COMPLETED:
            self.ending, self.reason = ending, reason
        self._ladder.climb(rung, now, target)

    def _hand_over(self) -> None:
        fresh, self._fresh = self._fresh, []
        if not fresh:
            return
        index = np.array([sample.index for sample in fresh], dtype=np.int64)
        self._post(
            SampleBlock(
                joint=self._axis.joint,
                index=index,
                time=index.astype(float) * self._period,
                effort=self._codec.effort(np.array([sample.torque for sample in fresh], dtype=float)),
                velocity=self._codec.velocity(np.array([sample.velocity for sample in fresh], dtype=float)),
                position=self._codec.position(np.array([sample.position for sample in fresh], dtype=float)),
                velocity_setpoint=self._wave[index],
            )
        )

    def _post(self, item: SampleBlock | None) -> None:
        self._loop.call_soon_threadsafe(self._blocks.put_nowait, item)


def _sharpen_timer() -> None:
    """Timer slack of this thread to 1 ns (Linux): waking up then is some 50 us less late."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(29, 1)  # PR_SET_TIMERSLACK
