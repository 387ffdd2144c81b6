"""Tasks of the event loop and their ends (docs/explanation/concurrency.md), and processes that work for this one."""

import asyncio
import os
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncGenerator, Awaitable, Coroutine, Mapping
from contextlib import asynccontextmanager, suppress
from typing import TypeVar

import structlog

_log = structlog.get_logger(__name__)


class Background:
    """The tasks of one owner. The owner must close or settle them: no task continues after its owner."""

    def __init__(self) -> None:
        self._tasks: set[asyncio.Task[None]] = set()

    def begin(self, name: str, work: Coroutine[object, object, None]) -> None:
        """Run `work` in a task with this name; an error that ends it is logged."""
        task = asyncio.create_task(work, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    async def settle(self) -> None:
        """Wait for all of them."""
        if self._tasks:
            await asyncio.wait(tuple(self._tasks))

    async def close(self) -> None:
        """Cancel all of them and wait for their ends."""
        for task in tuple(self._tasks):
            task.cancel()
        await self.settle()

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("task_failed", task=task.get_name(), exc_info=error)


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


ONE_THREAD: Mapping[str, str] = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment of a process whose linear algebra takes one core."""


@asynccontextmanager
async def child_process(
    module: str, *arguments: str, environment: Mapping[str, str] | None = None, patience: float = 0.0
) -> AsyncGenerator[tuple[Process, asyncio.StreamWriter, asyncio.StreamReader]]:
    """`python -m module arguments`, its standard input and its standard output; its input ends when this process dies.

    It ends with the block: its input is closed, and after `patience`, s, it is killed. It is in a session of its own:
    the signals of the terminal are for this process.
    """
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-P", "-m", module, *arguments),
        stdin=PIPE,
        stdout=PIPE,
        env={**os.environ, **(environment or {})},
        start_new_session=True,
    )
    if process.stdin is None or process.stdout is None:
        raise BrokenPipeError(module)
    try:
        yield process, process.stdin, process.stdout
    finally:
        process.stdin.close()
        with suppress(TimeoutError):
            async with asyncio.timeout(patience):
                await process.wait()
        if process.returncode is None:
            with suppress(ProcessLookupError):
                process.kill()
            await process.wait()


def give_way(process: int = 0) -> None:
    """Give a process (by its id, 0: this one) a lower priority than that of the service."""
    if sys.platform != "win32":
        present = os.getpriority(os.PRIO_PROCESS, process)  # to raise it again is not permitted
        os.setpriority(os.PRIO_PROCESS, process, max(present, 10))
