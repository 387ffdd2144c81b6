"""A move to a position in profile position mode: the drive generates the ramps, the host monitors."""

import asyncio
import math
import threading
import time
from collections.abc import Callable, Iterable

from drivers.cia402 import checks, states
from drivers.cia402.axis import Axis, Reading
from drivers.cia402.states import State
from drivers.cia402.thread import DriveThread
from drivers.errors import EnvelopeLeft, Measured, NotReady, SweepInterrupted, TargetNotReached

POLL = 0.01  # s
MARGIN = 5.0  # s for at least `LEAST` of the travel that a start from standstill makes in it
LEAST = 0.1
GAP = MARGIN / 10  # s, counted at most between two readings: a host that was suspended has not seen the axis stand
ARRIVAL = 2e-3  # rad (m), tolerance at the target
# s at standstill there: where a controller overshoots, the speed passes through zero before the axis stands
ARRIVAL_TIME = 0.05


async def move(
    thread: DriveThread,
    axis: Axis,
    position: float,
    velocity: float,
    stop: threading.Event,
    standing: Iterable[Axis],
    clock: Callable[[], float] = time.monotonic,
) -> None:
    """Returns at standstill at `position`, rad (m). If the axis did not arrive, the caller must stop it.

    An error of an axis that is `standing` also ends the move. The axis has to come nearer; when it arrives is the
    drive's affair, whose clock is not the host's.
    """
    profile = axis.profile
    envelope = checks.move_envelope(profile)
    start = await thread.run(axis.require_enabled)
    await thread.run(axis.device.read_back)
    await thread.run(axis.device.settle_limits, envelope.velocity_limit, envelope.effort_limit, envelope.window)
    least = LEAST * min(velocity * MARGIN, profile.acceleration * MARGIN**2 / 2)
    await thread.run(_start, axis, position, velocity, stop)
    arrived = math.inf  # since when, s on `clock`
    nearest, waited, before = abs(position - start.position), 0.0, clock()
    while True:
        reading = await thread.run(axis.read)
        if stop.is_set():
            raise SweepInterrupted(axis.place, f"move to {position:.5g} {profile.unit} was stopped")
        await thread.run(axis.check, reading.state)
        for other in standing:
            await thread.run(other.check_standing)
        if reading.state is not State.OPERATION_ENABLED:
            raise NotReady(axis.place, f"changed to state '{reading.state.value}' during the move")
        violation = envelope.violation(reading.position, reading.velocity, reading.effort)
        if violation is not None:
            text, measured = violation
            raise EnvelopeLeft(axis.place, text, measured=measured)
        now, distance = clock(), abs(position - reading.position)
        waited, before = waited + min(now - before, GAP), now
        if distance < nearest - min(least, LEAST * nearest):  # near the target a slow drive comes nearer in small steps
            nearest, waited = distance, 0.0
        arrived = min(arrived, now) if _arrived(axis, reading, position) else math.inf
        if now - arrived >= ARRIVAL_TIME:
            return
        patience = MARGIN if distance > ARRIVAL else 4 * MARGIN  # what is left is the rest at the target
        if waited > patience:
            reached = "" if reading.statusword & states.TARGET_REACHED else ", target not reported as reached"
            raise TargetNotReached(
                axis.place,
                f"{reading.position - position:+.2g} {profile.unit} from its target "
                f"{position:.5g} {profile.unit}, no nearer for {patience} s, "
                f"at {reading.velocity:.2g} {profile.unit}/s{reached}",
                measured=Measured(reading.position - position, ARRIVAL, profile.unit),
            )
        await asyncio.sleep(POLL)


def _start(axis: Axis, position: float, velocity: float, stop: threading.Event) -> None:
    """On the SDO thread, so that no stop can come between the check and the start."""
    if stop.is_set():
        raise SweepInterrupted(axis.place, "move was stopped before it started")
    axis.start_positioning(position, velocity, stop)


def _arrived(axis: Axis, reading: Reading, position: float) -> bool:
    reached = bool(reading.statusword & states.TARGET_REACHED)
    return reached and axis.stands(reading) and abs(reading.position - position) <= ARRIVAL
