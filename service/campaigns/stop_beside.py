"""Stops that come by the stop process: held at once, on its thread; confirmed and latched when the loop has time."""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

import structlog
from sqlalchemy.exc import SQLAlchemyError

from drivers.errors import DriveError
from service.campaigns.machine import Hold, Machine
from service.stop_process.handle import StopProcess

_log = structlog.get_logger(__name__)


@asynccontextmanager
async def listening(process: StopProcess, machine: Machine) -> AsyncGenerator[None]:
    """While the block runs, and for the stops that came before it."""
    loop, confirming = asyncio.get_running_loop(), set[asyncio.Task[None]]()

    def follow(hold: Hold) -> None:
        task = asyncio.create_task(_confirm(machine, hold), name="confirm a stop")
        confirming.add(task)
        task.add_done_callback(confirming.discard)

    def word(by: str, why: str, press: str) -> None:
        hold = machine.seize(by, why, press)
        process.taken_over()
        loop.call_soon_threadsafe(follow, hold)

    process.attach(word)
    try:
        yield
    finally:
        process.attach(None)
        await asyncio.sleep(0)  # what was called soon
        if confirming:
            await asyncio.wait(tuple(confirming))


async def _confirm(machine: Machine, hold: Hold) -> None:
    """What goes wrong is told where the stop was asked for by the service's own way; here it is logged."""
    try:
        await machine.confirm(hold)
    except (DriveError, SQLAlchemyError) as error:
        _log.error("stop_not_confirmed", by=hold.document.by, reason=str(error))
