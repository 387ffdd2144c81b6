"""Stops from beside the event loop: the machine is held at once, they are confirmed and latched when the loop has time.

They come by the stop process, or from the drives' side: the host was suspended, another host is there, an axis gained
or lost its energy by nobody here.
"""

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager

import structlog

from drivers.errors import DriveError
from service.execution.machine import Hold, Machine
from service.stop_process.handle import StopProcess
from service.tasks.background import Background

_log = structlog.get_logger(__name__)

WATCH = "host watch"  # who stops, where it is no person


@asynccontextmanager
async def listening(
    process: StopProcess, machine: Machine, told: Callable[[str, str, str], None]
) -> AsyncGenerator[None]:
    """To the stop process, while the block runs, and for the stops that came before it.

    `told` is given by, why and address of each once the machine is held; it waits for nothing.
    """
    async with _holding(machine) as hold:

        def word(by: str, why: str, press: str, address: str) -> None:
            hold(by, why, press)
            process.taken_over()
            told(by, why, address)

        process.attach(word)
        try:
            yield
        finally:
            process.attach(None)


@asynccontextmanager
async def watching(machine: Machine, told: Callable[[str, str], None]) -> AsyncGenerator[None]:
    """To what the drives' side finds, while the block runs. `told`: by and why, as of `listening`."""
    async with _holding(machine) as hold:

        def found(why: str) -> None:
            hold(WATCH, f"{why}; a person must look, release this stop and resume", "")
            told(WATCH, why)

        machine.watch(found)
        try:
            yield
        finally:
            machine.watch(None)


@asynccontextmanager
async def _holding(machine: Machine) -> AsyncGenerator[Callable[[str, str, str], None]]:
    """What holds the machine, given by, why and press; from any thread."""
    loop, confirming = asyncio.get_running_loop(), Background()

    def follow(hold: Hold) -> None:
        confirming.begin("confirm a stop", _confirm(machine, hold))

    def hold_at_once(by: str, why: str, press: str) -> None:
        loop.call_soon_threadsafe(follow, machine.seize(by, why, press))

    try:
        yield hold_at_once
    finally:
        await asyncio.sleep(0)  # what was called soon
        await confirming.settle()


async def _confirm(machine: Machine, hold: Hold) -> None:
    """What goes wrong is told where the stop was asked for by the service's own way; here it is logged."""
    try:
        await machine.confirm(hold)
    except DriveError as error:
        _log.error("stop_not_confirmed", by=hold.document.by, reason=str(error))
