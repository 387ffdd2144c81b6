"""The stop sequence, executed step by step: decelerate, quick stop, disable voltage; each stage has a deadline."""

import asyncio
import logging
import time
from contextlib import suppress

from drivers.cia402 import states
from drivers.cia402.axis import Axis
from drivers.cia402.thread import DriveThread
from drivers.errors import DriveError, WrongConfiguration, distinct

logger = logging.getLogger(__name__)

POLL = 0.01  # s
MARGIN = 0.5  # s added to the ramp time of a stage


async def bring_down(thread: DriveThread, axis: Axis) -> None:
    """Brings the axis to standstill and de-energises it, whatever it does now.

    Raises CommunicationLost if the drive does not answer and WrongConfiguration if it refuses. In both cases a stop
    that needs no answer was sent before.
    """
    try:
        await _stop_sequence(thread, axis)
    except DriveError:
        with suppress(DriveError):
            await thread.run(axis.device.stop_unheard)
        raise


async def _stop_sequence(thread: DriveThread, axis: Axis) -> None:
    try:
        await _come_to_rest(thread, axis)
    except WrongConfiguration as error:  # after a refused stage the next ones must still run
        logger.error("stop sequence, next stage: %s", error)
        await _quick_stop(thread, axis)
    await thread.run(axis.disable)
    await _confirm_rest(thread, axis)


async def _quick_stop(thread: DriveThread, axis: Axis) -> None:
    """Quick stop for a drive that does not report its motion: the command and the time of its ramp."""
    try:
        await thread.run(axis.quick_stop)
    except WrongConfiguration as error:
        logger.error("stop sequence, next stage: %s", error)
    else:
        await asyncio.sleep(axis.profile.velocity_limit / axis.profile.quick_stop_deceleration)


async def _come_to_rest(thread: DriveThread, axis: Axis) -> None:
    profile = axis.profile
    reading = await thread.run(axis.read)
    if reading.state in states.ENERGISED and not axis.stands(reading):
        await thread.run(axis.slow_down)
        if not await _stands(thread, axis, profile.velocity_limit / profile.acceleration + MARGIN):
            await thread.run(axis.quick_stop)
            await _stands(thread, axis, profile.velocity_limit / profile.quick_stop_deceleration + MARGIN)
    elif reading.state in states.ENERGISED:
        await thread.run(axis.slow_down)  # a sweep's first instants look like standstill


async def _confirm_rest(thread: DriveThread, axis: Axis) -> None:
    """WrongConfiguration if the axis still turns without energy, e.g. under its weight or with an open brake."""
    profile = axis.profile
    deadline = time.monotonic() + profile.velocity_limit / profile.quick_stop_deceleration + MARGIN
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


async def _stands(thread: DriveThread, axis: Axis, within: float) -> bool:
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        reading = await thread.run(axis.read)
        if axis.stands(reading) or reading.state not in states.ENERGISED:
            return True
        await asyncio.sleep(POLL)
    return False
