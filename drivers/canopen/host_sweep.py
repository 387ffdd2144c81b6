"""The host-streamed sweep of one or several axes on one clock: one thread sends set-points and SYNC, receives samples.

A cycle is RPDO1 of every axis, then one SYNC. The thread sends cycles by absolute deadlines, or plans them in
advance for the kernel (`bcm`); the stop sequence is always the thread's. A late cycle shifts only the wall clock,
because the drives' clock is SYNC. An error of one axis starts the stop sequence of all.
"""

import asyncio
import ctypes
import queue
import sys
import threading
import time
from array import array
from collections.abc import AsyncGenerator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import numpy as np

from drivers.canopen import frames
from drivers.canopen.bus import CanopenBus, Cycle, KernelRefused, KernelStream, set_point_source
from drivers.canopen.profile import BusProfile
from drivers.canopen.streamed_axis import Ending, StopStage, StreamedAxis, StreamRequest, Trouble, unplanned
from drivers.cia402.states import PowerState
from drivers.errors import CommunicationLost, Measured
from drivers.ports import SampleBlock, SetPointTiming


class Punctuality:
    """Missed deadlines are counted and left out, never compensated by a burst: only the wall clock shifts."""

    def __init__(self, period: float, allowed: int, limit: float) -> None:
        """`period` s; more than `allowed` missed deadlines, or one lateness above `limit` s, is an error."""
        self._period, self._allowed, self._limit = period, allowed, limit
        self._lateness = array("d")
        self._missed = 0
        self._worst = 0.0
        self.due = 0.0
        """The next deadline, s on the monotonic clock."""

    def begin(self, at: float) -> None:
        self.due = at

    def sent(self, at: float) -> float:
        """A cycle is sent at this time. Returns the lateness after the last passed deadline, s; negative: early."""
        late = at - self.due
        passed = max(0, int(late / self._period))
        self._lateness.append(late)
        self._missed += passed
        self._worst = max(self._worst, late)
        self.due += (1 + passed) * self._period
        return late - passed * self._period

    @property
    def patient(self) -> bool:
        """Whether a further deadline may be missed."""
        return self._missed < self._allowed

    @property
    def verdict(self) -> str | None:
        """Why the host is too late; None if it is not."""
        if self._worst > self._limit:
            return f"a set-point was {self._worst:.3f} s late, {self._limit:g} s are the limit"
        if self._missed > self._allowed:
            return (
                f"{self._missed} deadlines of {self._period * 1e3:g} ms were missed, {self._allowed} are allowed; "
                f"the worst set-point was {self._worst * 1e3:.1f} ms late"
            )
        return None

    def timing(self, source: str) -> SetPointTiming:
        """Punctuality so far; from any thread."""
        lateness = self._lateness.tolist()  # an atomic copy: the array may grow meanwhile
        median = float(np.median(lateness)) if lateness else 0.0
        return SetPointTiming(source, len(lateness), self._missed, median, self._worst)


Events = queue.SimpleQueue[frames.Event]


class HostSweep:
    """One run. `stop` (a threading.Event) may be set from any thread and starts the stop sequence."""

    opening_syncs = 3  # without set-points; after more of them a drive assumes that the host is lost
    block_time = 0.1  # s of samples per block
    standstill_timeout = 3.0  # s of cycles after the end of the waveform; s without the last samples
    hold_timeout = 5.0  # s, maximum wait at standstill until the mode is left

    def __init__(
        self, bus: CanopenBus, settings: BusProfile, requests: Sequence[StreamRequest], stop: threading.Event
    ) -> None:
        """Starts at once. The axes must stand, enabled, in cyclic synchronous velocity."""
        self.ending = Ending.COMPLETED
        self.reason = ""
        self.measured: Measured | None = None
        """Reason of the end, with the name of the axis; empty for COMPLETED."""
        self.joint = ""
        """The axis that ended the sweep, empty if none did."""
        period = settings.sync_period
        self._bus, self._stop, self._period = bus, stop, period
        self._clock = Punctuality(period, settings.missed_cycles, settings.host_timeout)
        self._axes = {request.axis.node: StreamedAxis(request, period) for request in requests}
        wires = self._wires = requests[0].wires
        self._source = set_point_source(bus, waits=settings.waits(wires))
        # sent by the kernel if no further cycles are planned
        self._rest: list[tuple[int, bytes]] = [*(wires.stop_frame(node) for node in self._axes), (frames.Cob.SYNC, b"")]
        self._last = max(axis.last for axis in self._axes.values())
        self._number = 0  # cycles sent
        self._ended = False  # the stop sequence has begun
        self._block_samples = max(1, round(self.block_time / period))
        self._silence = settings.silence
        self._silent_cycles = max(3, round(settings.silence / period))
        self._kernel: KernelStream | None = None
        self._seen: dict[int, bytes] = {}  # the kernel's set-points since its last SYNC, by node
        self._released = threading.Event()
        self._halted = threading.Event()
        self._forbidden = False  # by the host watch; then the stop sequence has begun
        self._held = False  # all axes stand and wait for `release`; the thread continues
        self._loop = asyncio.get_running_loop()
        self._blocks: asyncio.Queue[SampleBlock | None] = asyncio.Queue()
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="can-stream")
        self._thread = self._loop.run_in_executor(self._executor, self._run)
        self._executor.shutdown(wait=False)  # the thread ends with its only task

    async def blocks(self) -> AsyncGenerator[SampleBlock, None]:
        """The samples as they arrive, in order for each axis, until all stand: enabled if COMPLETED, else disabled."""
        while (block := await self._blocks.get()) is not None:
            yield block
        if not self._held:
            await self.finished()

    def release(self) -> None:
        """Stop SYNC after COMPLETED, once the axes have left the cyclic mode."""
        self._released.set()

    def halt(self) -> None:
        """Begin the stop sequence at its quick stop, because another process has sent one: a ramp would cancel it."""
        self._halted.set()

    async def finished(self) -> None:
        """Wait until the thread has ended; raises the error that ended it."""
        await self.over()
        self._thread.result()

    async def over(self) -> None:
        """Wait until the thread has ended, in whatever way. Its error is raised to the consumer, not here."""
        await asyncio.wait([self._thread])
        self._executor.shutdown()  # the only task of the thread is finished, so the thread ends
        if not self._thread.cancelled():
            self._thread.exception()  # retrieved, so that asyncio does not log it

    def timing(self) -> SetPointTiming:
        """Punctuality of the cycles so far."""
        return self._clock.timing(self._source)

    # -- the thread ----------------------------------------------------------------------------------------------

    def _run(self) -> None:
        _sharpen_timer()
        events = self._bus.open_stream(*self._axes)
        try:
            self._meet(events)
            if self._source == "bcm" and not self._ended:
                self._by_kernel(events)
            self._by_thread(events)
        except BaseException:  # planning and monitoring have ended, and the consumer may notice it late
            self._last_word()
            raise
        finally:
            self._bus.close_stream(*self._axes)
            self._hand_over(at_least=1)
            self._post(None)

    def _last_word(self) -> None:
        """Send quick stop to every axis, as far as the bus still accepts it."""
        with suppress(CommunicationLost):
            for identifier, data in self._rest:
                self._bus.send(identifier, data)

    def _meet(self, events: Events) -> None:
        """SYNC without set-points until every drive has reported that it is enabled."""
        self._check()  # report a stop that came first as a stop, not as a silent drive
        for _ in range(self.opening_syncs):
            self._bus.send(frames.Cob.SYNC, b"")
            self._count_sync()
            sent = time.monotonic()
            answer_by = sent + max(self._period, self._silence / self.opening_syncs)
            while self._unknown() and (event := _next(events, answer_by - time.monotonic())) is not None:
                self._take(event)
            self._listen(events, sent + self._period)
            for axis in self._axes.values():
                axis.settle()
            if not self._unknown():
                break
        for axis in self._unknown():
            self._end(Trouble(Ending.SILENT, f"does not answer SYNC within {self._silence:g} s"), axis)
        self._check()
        if not self._ended:
            for axis in self._axes.values():
                axis.begin()

    def _unknown(self) -> list[StreamedAxis]:
        return [axis for axis in self._axes.values() if axis.state is PowerState.UNKNOWN]

    def _by_kernel(self, events: Events) -> None:
        """The cycles of the sweep, planned in advance. Returns at its end, or once the stop sequence has begun."""
        interface = self._bus.kernel_interface or ""
        self._kernel = kernel = KernelStream(interface, self._period, self._plan, self._rest)
        self._bus.kernel_sends(sending=True)
        try:
            if not self._is_forbidden():
                kernel.begin()
            heard = time.monotonic()
            while self._number <= self._last and not self._ended:
                event = _next(events, 0.0)
                if event is None and not self._is_forbidden():  # no event is waiting: all sent cycles were seen
                    kernel.top_up(self._number)
                    event = _next(events, self._period)
                if event is not None:
                    self._take(event)
                if isinstance(event, frames.Sync):
                    heard = time.monotonic()
                elif event is None and time.monotonic() - heard > max(self._silence, 3 * self._period):
                    self._end(Trouble(Ending.NOT_SENT, f"the kernel sent no SYNC for {self._silence:g} s"))
                self._check()
        except KernelRefused as error:  # the bus may still work: the thread runs the stop sequence
            self._end(Trouble(Ending.NOT_SENT, str(error)))
        finally:
            kernel.close()
            self._bus.kernel_sends(sending=False)

    def _by_thread(self, events: Events) -> None:
        counted_by = hold_until = float("inf")
        standstill_by = self._last + round(
            self.standstill_timeout / self._period
        )  # a cycle: an axis is slow, not the host
        self._clock.begin(time.monotonic())
        while True:
            now = time.monotonic()
            self._clock.sent(now)
            self._check()
            if not self._send_set_points(now):
                continue  # without SYNC the drives do not take over the set-points sent to some of them
            self._bus.send(frames.Cob.SYNC, b"")
            if all(axis.stop_sequence.stage is StopStage.DONE for axis in self._axes.values()):
                return
            self._number += 1
            self._count_sync()
            self._listen(events, self._clock.due)
            self._wait_for_answers(events, now)
            if self._number <= self._last or self._ended:
                continue
            unfinished = self._unfinished()
            if unfinished is not None and self._number > self._last + StreamedAxis.standing_samples:
                self._wait_for_the_count(events)
                unfinished = self._unfinished()
            now = time.monotonic()
            if hold_until < float("inf"):  # at standstill, handed over to the consumer
                if self._released.is_set():
                    return
                if now > hold_until:
                    self._stop_all(StopStage.QUICK_STOP)
            elif unfinished is not None:
                behind = any(axis.behind for axis in self._axes.values())
                counted_by = min(counted_by, now + self.standstill_timeout) if behind else float("inf")
                if self._number > standstill_by or now > counted_by:
                    self._end(*unfinished)
            elif self._number > self._last + StreamedAxis.standing_samples:
                hold_until = now + self.hold_timeout
                self._hand_over(at_least=1)
                self._held = True
                self._post(None)

    # -- one cycle -----------------------------------------------------------------------------------------------

    def _plan(self, number: int) -> Cycle:
        """For the kernel: content of a future cycle if nothing happens before it."""
        wires = self._wires
        set_points = [(wires.set_point_id(node), axis.planned(number)) for node, axis in self._axes.items()]
        return [*set_points, (frames.Cob.SYNC, b"")]

    def _send_set_points(self, now: float) -> bool:
        """Send the set-point of every axis. False if the host was suspended meanwhile: then quick stops follow."""
        for node, axis in self._axes.items():
            word = axis.command(self._number, now)
            if self._is_forbidden():
                return False
            self._bus.send(self._wires.set_point_id(node), word)
        return not self._is_forbidden()

    def _is_forbidden(self) -> bool:
        """Whether the host watch forbids motion. The first time, the stop sequences begin at their quick stop."""
        reason = "" if self._forbidden else self._bus.watch.reason
        if reason:
            self._forbidden = True
            self._end(Trouble(Ending.FORBIDDEN, reason))
        return bool(reason)

    def _count_sync(self) -> None:
        for axis in self._axes.values():
            trouble = axis.sync()
            if trouble is not None:
                self._end(trouble, axis)

    def _wait_for_answers(self, events: Events, sent: float) -> None:
        """Delay the next SYNC for drives that have not answered, as far as the profile allows missed deadlines.

        A later answer of a drive that counts no samples then cannot be assigned to another SYNC; after its last sample
        one SYNC is left out (`windows`). A drive that counts and is slow (a virtual one on a busy computer) gets no
        more SYNCs than it can process: those that wait for it would delay its heartbeats, and a stop.
        """
        if self._ended:
            return
        axes = list(self._axes.values())
        if self._number == self._last + StreamedAxis.standing_samples and not all(axis.counts for axis in axes):
            self._listen(events, self._clock.due + self._period)
            self._clock.begin(self._clock.due + self._period)
        until = sent + self._silence / self.opening_syncs
        while self._clock.patient and not all(axis.answered for axis in axes) and not self._ended:
            left = until - time.monotonic()
            if left <= 0:
                break
            event = _next(events, min(left, self._period))
            if event is not None:
                self._take(event)
            for axis in axes if event is None else ():
                axis.silent += axis.counts and not axis.answered  # a cycle without SYNC is one without a sample as well
            self._check()
        for axis in axes if self._clock.patient else ():
            axis.silent += 0 if axis.counts or axis.answered else round((until - sent) / self._period)
            axis.settle()

    def _wait_for_the_count(self, events: Events) -> None:
        """Delay the next SYNC until all samples are counted: answers may be delayed (gateway), or one is lost."""
        until = time.monotonic() + self._silence
        while any(axis.behind for axis in self._axes.values()) and not self._ended:
            event = _next(events, until - time.monotonic())
            if event is None:
                break
            self._take(event)
            self._check()
        self._clock.begin(max(self._clock.due, time.monotonic()))  # not a missed deadline, because none was set

    def _listen(self, events: Events, deadline: float) -> None:
        """Process events until the deadline. Waiting events are processed even if the deadline has passed."""
        while (event := _next(events, deadline - time.monotonic())) is not None:
            self._take(event)

    def _take(self, event: frames.Event) -> None:
        match event:
            case frames.Lost():
                raise CommunicationLost(event.reason)
            case frames.SetPoint():
                self._seen[event.node] = event.data
            case frames.Sync():
                self._take_sync(event.at)
            case frames.Controller():
                pass  # handled by `Bus`
            case _:
                axis = self._axes[event.node]
                trouble = axis.take(event)
                if trouble is not None:
                    self._end(trouble, axis)
                self._hand_over(at_least=self._block_samples)

    def _take_sync(self, at: float) -> None:
        """SYNC of the kernel, seen when it was sent."""
        kernel = self._kernel
        if kernel is None:
            return  # our own through a gateway; one of another host is detected by the sample counters
        if self._number == 0:
            self._clock.begin(at)
        seen, self._seen = self._seen, {}
        for node, axis in self._axes.items():
            if seen.get(node) == axis.planned(self._number):
                axis.was_sent(self._number)
            elif not self._ended:
                self._end(unplanned(seen.get(node), self._wires.stop_frame(node)[1]), axis)
        self._number += 1
        self._count_sync()
        kernel.note(self._clock.sent(at))

    def _check(self) -> None:
        """Checks that are not triggered by an event."""
        self._is_forbidden()
        if self._halted.is_set():
            if self.ending in (Ending.MISCOUNTED, Ending.NOT_SENT):  # a SYNC of the stop process came before its report
                self.ending = Ending.COMPLETED
            self._end(Trouble(Ending.STOPPED, "sweep was stopped"))
        if self._stop.is_set():
            self._end(Trouble(Ending.STOPPED, "sweep was stopped", StopStage.RAMP))
        if self._ended:
            return
        if self._number <= self._last and (verdict := self._clock.verdict) is not None:
            self._end(Trouble(Ending.LATE, verdict))
        for axis in self._axes.values():
            if axis.silent > self._silent_cycles:
                text = f"no sample for {axis.silent} cycles of {self._period * 1e3:g} ms"
                self._end(Trouble(Ending.SILENT, text), axis)

    def _unfinished(self) -> tuple[Trouble, StreamedAxis] | None:
        """An axis that does not stand yet, or whose last samples are missing."""
        for axis in self._axes.values():
            if not axis.standing:
                return Trouble(
                    Ending.NO_STANDSTILL, f"is not at standstill {self.standstill_timeout:g} s after its sweep"
                ), axis
            if not axis.complete:
                return Trouble(Ending.MISCOUNTED, f"its sample counter is {axis.behind} behind SYNC"), axis
        return None

    def _end(self, trouble: Trouble, axis: StreamedAxis | None = None) -> None:
        if self.ending is Ending.COMPLETED:
            self.ending = trouble.ending
            self.joint = "" if axis is None else axis.joint
            self.measured = trouble.measured
            self.reason = f"{', '.join(self._places(axis))}: {trouble.reason}"
        self._stop_all(trouble.stage)

    def _places(self, axis: StreamedAxis | None) -> list[str]:
        return [each.place for each in self._axes.values() if axis in (None, each)]

    def _stop_all(self, stage: StopStage) -> None:
        self._ended = True
        now = time.monotonic()
        for axis in self._axes.values():
            axis.stop_sequence.advance(stage, now, axis.velocity)

    def _hand_over(self, at_least: int) -> None:
        for axis in self._axes.values():
            block = axis.block(at_least)
            if block is not None:
                self._post(block)

    def _post(self, item: SampleBlock | None) -> None:
        self._loop.call_soon_threadsafe(self._blocks.put_nowait, item)


def _next(events: Events, within: float) -> frames.Event | None:
    """The next event, None if there is none within `within` s."""
    try:
        return events.get(timeout=within) if within > 0 else events.get_nowait()
    except queue.Empty:
        return None


def _sharpen_timer() -> None:
    """Set the timer slack of this thread to 1 ns (Linux): wake-ups are then about 50 us less late."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(29, 1)  # PR_SET_TIMERSLACK
