"""A drive made ready for its measuring function, and put back afterwards, however the run ended."""

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
    """The command's parameters in the drive; for torque noise also the speed control softened inside of the block.

    Whatever ends the block, the commissioned speed control is restored and read back; a failure of that is raised
    where nothing else is, else logged. (A drive that cannot be reached restores it by itself when it misses its host;
    `connect`, `enable` and every motion put right what is left.)
    """
    if isinstance(command, SweepCommand):
        await thread.run(axis.device.prepare_measuring, command)
        yield
        return
    injector = axis.device.injector
    if injector is None:
        raise NotReady(f"{axis.place}: the drive injects no torque")
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
