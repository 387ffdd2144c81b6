"""The renewal of the machine's lease. While it cannot be renewed, the machine stands: another service may take it."""

import asyncio
import time
from collections.abc import Awaitable, Callable

import structlog
from sqlalchemy.exc import SQLAlchemyError

from drivers.errors import Cause, CauseCode
from service.machine.execution.state.latched_stops import apart
from service.store.database import refusal
from service.store.guards import MachineLease

_log = structlog.get_logger(__name__)


async def renew(
    lease: MachineLease, lease_time: float, renewed: Callable[[], None], late: Callable[[Cause], Awaitable[None]]
) -> None:
    """Renew it until another service has it (LeaseLost). `renewed` is called after each success.

    `late` gets the cause once, when half of the lease time, s, has passed without a renewal.
    """
    last, delayed, told = time.monotonic(), 0.0, False  # delayed: s since then by which this computer was delayed

    async def check() -> None:
        """Whatever the cause, `late` is called; `delayed` distinguishes the cause."""
        nonlocal told
        passed = time.monotonic() - last
        if passed > lease_time / 2 and not told:
            told = True
            why = (
                f"this computer was delayed by {delayed:.1f} s"
                if delayed > passed / 2
                else "the database does not answer"
            )
            reason = f"the machine's lease could not be renewed: {why}"
            _log.error("lease_not_renewed", reason=reason)
            await late(Cause(CauseCode.LEASE_NOT_RENEWED, detail=reason))

    while True:
        delayed += await _wait(lease_time / 5)
        begun = time.monotonic()
        # one attempt at a time, however long it takes: waiting threads must not accumulate
        attempt = asyncio.create_task(apart(lease.renew), name="renew lease")
        try:
            while True:
                delayed += await _wait(lease_time / 5, attempt)
                if attempt.done():
                    break
                await check()
        finally:
            await asyncio.wait([attempt])
        try:
            attempt.result()
        except SQLAlchemyError as error:  # also a full pool or a broken file: it must not end this task
            _log.warning("lease_not_renewed", reason=refusal(error))
            await check()
        else:
            last, delayed, told = begun, 0.0, False
            renewed()


async def _wait(within: float, work: "asyncio.Task[None] | None" = None) -> float:
    """Wait `within` s, or until `work` is done; returns by how many s this computer was delayed."""
    due = time.monotonic() + within
    if work is None:
        await asyncio.sleep(within)
    else:
        await asyncio.wait([work], timeout=within)
    return max(0.0, time.monotonic() - due)
