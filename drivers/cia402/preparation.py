"""Prepares a drive for its measuring function, and restores it afterwards, however the run ended."""

import logging
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from drivers.cia402.axis import Axis
from drivers.cia402.thread import DriveThread
from drivers.errors import DriveError, NotReady
from drivers.ports import NoiseCommand, SweepCommand

logger = logging.getLogger(__name__)


@asynccontextmanager
async def prepared(thread: DriveThread, axis: Axis, command: SweepCommand | NoiseCommand) -> AsyncGenerator[None]:
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
