"""Work that is completed even if its caller is cancelled."""

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

import structlog

_log = structlog.get_logger(__name__)

Result = TypeVar("Result")


async def run_to_end(work: Awaitable[Result]) -> Result:
    """The result of `work`, which is completed in any case; CancelledError of the caller is raised afterwards.

    An error of `work` is then logged, because the caller gets the cancellation.
    """
    task = asyncio.ensure_future(work)
    cancelled: asyncio.CancelledError | None = None
    while not task.done():
        try:
            await asyncio.wait([task])
        except asyncio.CancelledError as error:
            cancelled = error
    if cancelled is None:
        return task.result()
    if not task.cancelled() and (error := task.exception()) is not None:
        _log.error("failed_while_cancelled", reason=str(error), exc_info=error)
    raise cancelled
