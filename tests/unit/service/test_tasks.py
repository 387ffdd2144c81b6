"""Tasks that nobody waits for, and work that ends although its caller is cancelled."""

import asyncio

import pytest
from structlog.testing import capture_logs

from service.process.tasks import Background, run_to_end


async def fails() -> None:
    raise LookupError("no such thing")


async def test_an_error_that_ends_a_task_is_logged() -> None:
    background = Background()
    with capture_logs() as logs:
        background.begin("loop of the diagnoses", fails())
        await background.settle()
        await asyncio.sleep(0)
    assert [(log["event"], log["task"]) for log in logs] == [("task_failed", "loop of the diagnoses")]


async def test_no_task_outlives_its_owner() -> None:
    background, ends = Background(), list[str]()

    async def waits(name: str) -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0)
            ends.append(name)

    with capture_logs() as logs:
        background.begin("a", waits("a"))
        background.begin("b", waits("b"))
        await asyncio.sleep(0)
        await background.close()
    assert sorted(ends) == ["a", "b"]
    assert logs == []
    await background.close()


async def test_what_must_end_gives_its_result_or_error() -> None:
    assert await run_to_end(asyncio.sleep(0, "done")) == "done"
    with pytest.raises(LookupError):
        await run_to_end(fails())


@pytest.mark.parametrize("times", [1, 3])
async def test_a_cancelled_caller_hears_of_it_after_the_work(times: int) -> None:
    go, ended = asyncio.Event(), asyncio.Event()

    async def work() -> None:
        await go.wait()
        ended.set()

    caller = asyncio.create_task(run_to_end(work()))
    for _ in range(times):
        await asyncio.sleep(0)
        caller.cancel()
        await asyncio.sleep(0)
    assert not caller.done()
    go.set()
    with pytest.raises(asyncio.CancelledError):
        await caller
    assert ended.is_set()


async def test_an_error_of_the_work_of_a_cancelled_caller_is_logged() -> None:
    go = asyncio.Event()

    async def work() -> None:
        await go.wait()
        raise OSError("disk full")

    caller = asyncio.create_task(run_to_end(work()))
    await asyncio.sleep(0)
    caller.cancel()
    with capture_logs() as logs:
        go.set()
        with pytest.raises(asyncio.CancelledError):
            await caller
    assert [(log["event"], log["reason"]) for log in logs] == [("failed_while_cancelled", "disk full")]
