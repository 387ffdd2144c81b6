"""The motions of one axis that the host follows by reading it: its stop sequence, a move, a drive-side sweep or noise
run. A host-streamed sweep is the fieldbus' own (`drivers.cia402.connection.RunningSweep`).
"""

import asyncio
import logging
import threading
import time
from collections.abc import AsyncGenerator, Awaitable, Callable, Iterable
from contextlib import asynccontextmanager, suppress

from drivers.cia402 import checks, states
from drivers.cia402.axis import Cia402Axis
from drivers.cia402.checks import DriveEnvelope
from drivers.cia402.connection import DriveThread
from drivers.cia402.device import MeasuringState
from drivers.cia402.states import PowerState, Statusword
from drivers.errors import (
    CommunicationLost,
    DriveError,
    DriveFault,
    EnvelopeLeft,
    Measured,
    MotionForbidden,
    NotReady,
    SweepInterrupted,
    TargetNotReached,
    WrongConfiguration,
    distinct,
)
from drivers.ports import NoiseCommand, SampleBlock, SweepCommand

logger = logging.getLogger(__name__)

POLL = 0.01  # s
REST = 5  # polls: where a controller overshoots, the speed passes through zero before the axis stands


async def bring_down(thread: DriveThread, axis: Cia402Axis) -> None:
    """Brings the axis to standstill and de-energises it, whatever it does now: decelerate, quick stop, disable voltage,
    each with a deadline, 0.5 s after the time of its ramp.

    Raises CommunicationLost if the drive does not answer and WrongConfiguration if it refuses. In both cases a stop
    that needs no answer was sent before.
    """
    try:
        await _stop_sequence(thread, axis)
    except DriveError:
        with suppress(DriveError):
            await thread.run(axis.device.stop_unheard)
        raise


async def _stop_sequence(thread: DriveThread, axis: Cia402Axis) -> None:
    try:
        await _come_to_rest(thread, axis)
    except WrongConfiguration as error:  # after a refused stage the next ones must still run
        logger.error("stop sequence, next stage: %s", error)
        await _quick_stop(thread, axis)
    await thread.run(axis.disable)
    await _confirm_rest(thread, axis)


async def _quick_stop(thread: DriveThread, axis: Cia402Axis) -> None:
    """Quick stop for a drive that does not report its motion: the command and the time of its ramp."""
    try:
        await thread.run(axis.quick_stop)
    except WrongConfiguration as error:
        logger.error("stop sequence, next stage: %s", error)
    else:
        await asyncio.sleep(axis.profile.velocity_limit / axis.profile.quick_stop_deceleration)


async def _come_to_rest(thread: DriveThread, axis: Cia402Axis) -> None:
    profile = axis.profile
    reading = await thread.run(axis.read)
    if reading.state in states.ENERGISED and not axis.stands(reading):
        await thread.run(axis.slow_down)
        if not await _stands(thread, axis, profile.velocity_limit / profile.acceleration + 0.5):
            await thread.run(axis.quick_stop)
            await _stands(thread, axis, profile.velocity_limit / profile.quick_stop_deceleration + 0.5)
    elif reading.state in states.ENERGISED:
        await thread.run(axis.slow_down)  # a sweep's first instants look like standstill


async def _confirm_rest(thread: DriveThread, axis: Cia402Axis) -> None:
    """WrongConfiguration if the axis still turns without energy, e.g. under its weight or with an open brake."""
    profile = axis.profile
    deadline = time.monotonic() + profile.velocity_limit / profile.quick_stop_deceleration + 0.5
    while True:
        reading = await thread.run(axis.read)
        if axis.stands(reading) and reading.state in states.WITHOUT_ENERGY:
            return
        if time.monotonic() > deadline:
            speed, limit = distinct(abs(reading.velocity), profile.standstill_velocity, digits=4)
            raise WrongConfiguration(
                axis.place,
                f"is '{reading.state.value}' and turns at {speed} {profile.unit}/s, "
                f"standstill is at most {limit} {profile.unit}/s",
            )
        await asyncio.sleep(POLL)


async def _stands(thread: DriveThread, axis: Cia402Axis, within: float) -> bool:
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        reading = await thread.run(axis.read)
        if axis.stands(reading) or reading.state not in states.ENERGISED:
            return True
        await asyncio.sleep(POLL)
    return False


async def move(
    thread: DriveThread,
    axis: Cia402Axis,
    position: float,
    velocity: float,
    stop: threading.Event,
    standing: Iterable[Cia402Axis],
    clock: Callable[[], float] = time.monotonic,
    margin: float = 5.0,
    tolerance: float = 2e-3,
) -> None:
    """Returns at standstill within `tolerance` of `position`, rad (m), in profile position mode: the drive generates
    the ramps. If the axis did not arrive, the caller must stop it.

    An error of an axis that is `standing` also ends the move. The axis has to come nearer, in `margin` s by a tenth of
    the travel that a start from standstill makes in it; when it arrives is the drive's affair, whose clock is not the
    host's.
    """
    profile = axis.profile
    envelope = checks.move_envelope(profile)
    start = await thread.run(axis.require_enabled)
    await thread.run(axis.device.read_back)
    await thread.run(axis.device.settle_limits, envelope.velocity_limit, envelope.effort_limit, envelope.window)
    least = 0.1 * min(velocity * margin, profile.acceleration * margin**2 / 2)
    await thread.run(_start, axis, position, velocity, stop)
    rested = 0  # readings in a row
    nearest, waited, before = abs(position - start.position), 0.0, clock()
    while True:
        reading = await thread.run(axis.read)
        if stop.is_set():
            raise SweepInterrupted(axis.place, f"move to {position:.5g} {profile.unit} was stopped")
        await thread.run(axis.check, reading.state)
        for other in standing:
            await thread.run(other.check_standing)
        if reading.state is not PowerState.OPERATION_ENABLED:
            raise NotReady(axis.place, f"changed to state '{reading.state.value}' during the move")
        violation = envelope.violation(reading.position, reading.velocity, reading.effort)
        if violation is not None:
            text, measured = violation
            raise EnvelopeLeft(axis.place, text, measured=measured)
        now, distance = clock(), abs(position - reading.position)
        # a host that was suspended has not seen the axis stand
        waited, before = waited + min(now - before, margin / 10), now
        if distance < nearest - min(least, nearest / 2):  # near the target, half of what is left: who creeps is stuck
            nearest, waited = distance, 0.0
        reached = bool(reading.statusword & Statusword.TARGET_REACHED)
        rested = rested + 1 if reached and axis.stands(reading) and distance <= tolerance else 0
        if rested > REST:
            return
        patience = margin if distance > tolerance else 4 * margin  # what is left is the rest at the target
        if waited > patience:
            missed = "" if reached else ", target not reported as reached"
            raise TargetNotReached(
                axis.place,
                f"{reading.position - position:+.2g} {profile.unit} from its target "
                f"{position:.5g} {profile.unit}, no nearer for {patience} s, "
                f"at {reading.velocity:.2g} {profile.unit}/s{missed}",
                measured=Measured(reading.position - position, tolerance, profile.unit),
            )
        await asyncio.sleep(POLL)


def _start(axis: Cia402Axis, position: float, velocity: float, stop: threading.Event) -> None:
    """On the SDO thread, so that no stop can come between the check and the start."""
    if stop.is_set():
        raise SweepInterrupted(axis.place, "move was stopped before it started")
    axis.start_positioning(position, velocity, stop)


@asynccontextmanager
async def prepared(thread: DriveThread, axis: Cia402Axis, command: SweepCommand | NoiseCommand) -> AsyncGenerator[None]:
    """Writes the parameters to the drive. For torque noise the speed control is also softened inside the block.

    However the block ends, the commissioned speed control is restored and read back. A failure of that is raised if
    there is no other error, otherwise logged. (A drive that cannot be reached restores it by itself when it loses
    its host; `connect`, `enable` and every motion correct what remains.)
    """
    if isinstance(command, SweepCommand):
        await thread.run(axis.device.prepare_measuring, command)
        yield
        return
    injector = axis.device.injector
    if injector is None:
        raise NotReady(axis.place, "the drive cannot inject torque noise")
    await thread.run(injector.prepare_noise, command)
    try:
        await thread.run(injector.soften, command.softening)
        yield
    except BaseException:
        try:
            await thread.run(injector.restore_control)
        except DriveError as error:
            logger.error("speed control not restored: %s", error)
        raise
    await thread.run(injector.restore_control)


class DriveSweep:
    """One run: a task starts the measuring function, monitors it, and reads its trace in pages, whether or not the
    samples are consumed. `stop` (a threading.Event) may be set from any thread; the task then stops the axis and ends.
    """

    stalled = 5.0  # s without a new sample

    def __init__(
        self,
        thread: DriveThread,
        axis: Cia402Axis,
        command: SweepCommand | NoiseCommand,
        envelope: DriveEnvelope,
        stop: threading.Event,
        bring_down: Callable[[], Awaitable[None]],
    ) -> None:
        """`bring_down` is the stop sequence of the axis."""
        self._thread, self._axis, self._command = thread, axis, command
        self._envelope, self._stop, self._bring_down = envelope, stop, bring_down
        self._largest = axis.device.page_size
        self._live = max(1, min(self._largest, round(0.1 * command.sample_rate)))
        # 1.6 times the expected samples: a trace cycle in whole ms may be shorter than requested
        self._most = round(1.6 * (command.duration + 1.0) * command.sample_rate)
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
            if time.monotonic() - grown > self.stalled:
                raise CommunicationLost(
                    self._axis.place, f"no new sample of the measuring function for {self.stalled} s"
                )
            await asyncio.sleep(POLL)

    async def _come_to_rest(self) -> None:
        """After torque noise an axis with softened control oscillates for a moment."""
        deadline = time.monotonic() + 2.0
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
