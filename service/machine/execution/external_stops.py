"""Stops from outside the event loop: the machine is held immediately; the loop confirms and latches them later.

They come from the stop process or from the drivers: the host was suspended, another host is on the bus, an axis was
enabled or disabled by another party.
"""

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager

from drivers.errors import Cause
from service.machine.execution.machine import Hold, Machine
from service.machine.stop_process.handle import StopProcess
from service.process.tasks.background import Background

WATCH = "host watch"  # source of a stop that is not from a person


@asynccontextmanager
async def listening(
    process: StopProcess, machine: Machine, report: Callable[[str, str, str], None]
) -> AsyncGenerator[None]:
    """Receive from the stop process during the block, and handle the stops from before it.

    `report` is called with source, reason and address of each new stop after the machine is held; it does not wait.
    """
    async with _holding(machine) as hold:

        def word(by: str, why: str, press: str, address: str) -> None:
            taken = hold(by, why, press, f"{address} {by}")
            process.taken_over()
            if not taken.reported:
                taken.reported = True
                report(by, why, address)

        process.attach(word)
        try:
            yield
        finally:
            process.attach(None)


@asynccontextmanager
async def watching(machine: Machine, report: Callable[[str, Cause], None]) -> AsyncGenerator[None]:
    """Receive the findings of the host watch during the block. `report`: called with source and cause, as in
    `listening`.
    """
    async with _holding(machine) as hold:

        def found(cause: Cause) -> None:
            hold(WATCH, f"{cause}; check the machine, release this stop and resume", "", "", cause)
            report(WATCH, cause)

        machine.watch(found)
        try:
            yield
        finally:
            machine.watch(None)


@asynccontextmanager
async def _holding(machine: Machine) -> AsyncGenerator[Callable[..., Hold]]:
    """A function that holds the machine (arguments of `Machine.seize`); may be called from any thread."""
    loop, confirming = asyncio.get_running_loop(), Background()

    def follow(hold: Hold) -> None:
        confirming.begin("confirm a stop", machine.confirm_logged(hold))

    def hold_at_once(by: str, why: str, press: str, source: str, cause: Cause | None = None) -> Hold:
        hold = machine.seize(by, why, press, source, cause)
        loop.call_soon_threadsafe(follow, hold)
        return hold

    try:
        yield hold_at_once
    finally:
        await asyncio.sleep(0)  # run the pending callbacks
        await confirming.settle()
