"""The stop ladder over SDO: slow down, quick stop, disable voltage; each rung has its deadline."""

import asyncio
import logging
import time
from contextlib import suppress

from drivers.canopen.axis import Axis
from drivers.canopen.measuring import abort_running
from drivers.canopen.sdo_thread import SdoThread
from drivers.cia402 import states
from drivers.errors import CommunicationLost, WrongConfiguration

logger = logging.getLogger(__name__)

POLL = 0.01  # s
MARGIN = 0.5  # s that a rung gets above its ramp


async def bring_down(sdo: SdoThread, axis: Axis) -> None:
    """Axis to standstill and de-energised, whatever it does now.

    CommunicationLost if the drive does not answer; it was then told to stop by what needs no answer.
    """
    try:
        await _ladder(sdo, axis)
    except CommunicationLost:
        with suppress(CommunicationLost):
            await sdo.run(axis.stop_unheard)
        raise


async def _ladder(sdo: SdoThread, axis: Axis) -> None:
    try:
        await _come_to_rest(sdo, axis)
    except WrongConfiguration as error:  # a refused rung must not keep the drive from the next ones
        logger.error("stop ladder, next rung: %s", error)
        await sdo.run(axis.quick_stop)
        await asyncio.sleep(axis.profile.velocity_limit / axis.profile.quick_stop_deceleration)
    await sdo.run(axis.disable)


async def _come_to_rest(sdo: SdoThread, axis: Axis) -> None:
    profile = axis.profile
    reading = await sdo.run(axis.read)
    if reading.state in states.ENERGISED and not axis.stands(reading):
        await sdo.run(_slow_down, axis)
        if not await _stands(sdo, axis, profile.velocity_limit / profile.acceleration + MARGIN):
            await sdo.run(axis.quick_stop)
            await _stands(sdo, axis, profile.velocity_limit / profile.quick_stop_deceleration + MARGIN)
    elif reading.state in states.ENERGISED:
        await sdo.run(_slow_down, axis)  # a sweep's first instants look like standstill


def _slow_down(axis: Axis) -> None:
    if not (axis.measures and abort_running(axis)):
        axis.halt()


async def _stands(sdo: SdoThread, axis: Axis, within: float) -> bool:
    deadline = time.monotonic() + within
    while time.monotonic() < deadline:
        reading = await sdo.run(axis.read)
        if axis.stands(reading) or reading.state not in states.ENERGISED:
            return True
        await asyncio.sleep(POLL)
    return False
