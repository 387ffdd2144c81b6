"""Tasks that nobody waits for, work that ends although its caller is cancelled, and what log lines are about."""

import asyncio
import json
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
import structlog
from starlette.types import Message
from structlog.contextvars import bound_contextvars
from structlog.testing import LogCapture, capture_logs
from structlog.typing import EventDict

from service.jobs.jobs import OpenJobs
from service.process.logs import MachineWork, in_executor
from service.process.tasks import Background, run_to_end
from service.web.api.gate import Logged


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
async def test_a_cancelled_caller_hears_of_it_after_the_work_whose_error_is_logged(times: int) -> None:
    go = asyncio.Event()

    async def work() -> None:
        await go.wait()
        raise OSError("disk full")

    caller = asyncio.create_task(run_to_end(work()))
    for _ in range(times):
        await asyncio.sleep(0)
        caller.cancel()
        await asyncio.sleep(0)
    assert not caller.done()
    with capture_logs() as logs:
        go.set()
        with pytest.raises(asyncio.CancelledError):
            await caller
    assert [(log["event"], log["reason"]) for log in logs] == [("failed_while_cancelled", "disk full")]


@pytest.fixture
def machine() -> MachineWork:
    return MachineWork()


@pytest.fixture
def written(machine: MachineWork) -> Iterator[list[EventDict]]:
    """What is logged through structlog from here on."""
    capture = LogCapture()
    before = structlog.get_config()
    structlog.configure(processors=[structlog.contextvars.merge_contextvars, machine.add, capture])
    yield capture.entries
    structlog.configure(**before)


def about(line: EventDict) -> tuple[object, object]:
    return line.get("campaign"), line.get("sweep")


def test_another_thread_gets_what_the_machine_does(machine: MachineWork, written: list[EventDict]) -> None:
    log = structlog.get_logger()

    def elsewhere() -> None:
        thread = threading.Thread(target=lambda: log.info("received"), name="can-receive")
        thread.start()
        thread.join()

    elsewhere()
    with machine.campaign(3):
        elsewhere()
        with machine.sweeps(3, [7]):
            elsewhere()
            log.info("of the sweep itself")
        with machine.sweeps(3, [8, 9]):
            elsewhere()
        elsewhere()
    elsewhere()
    nothing, campaign = (None, None), (3, None)
    assert list(map(about, written)) == [nothing, campaign, (3, 7), (3, 7), (3, [8, 9]), campaign, nothing]


def test_a_line_of_another_campaign_or_sweep_keeps_its_own(machine: MachineWork, written: list[EventDict]) -> None:
    log = structlog.get_logger()
    with machine.sweeps(3, [7]), bound_contextvars(campaign=3, sweep=6):
        log.info("estimate")
        log.info("estimate", campaign=2)
        with bound_contextvars(campaign=1):
            log.info("recovered", sweep=5)
    structlog.contextvars.clear_contextvars()
    with machine.sweeps(3, [7]):
        structlog.contextvars.clear_contextvars()
        log.info("imported", campaign=4)
    assert list(map(about, written)) == [(3, 6), (2, 6), (1, 5), (4, None)]


async def test_work_in_an_executor_takes_the_context_along(written: list[EventDict]) -> None:
    with ThreadPoolExecutor(1) as executor, bound_contextvars(campaign=1, sweep=2):
        await in_executor(executor, structlog.get_logger().info, "on disk", path="a")
    assert written == [{"campaign": 1, "sweep": 2, "path": "a", "event": "on disk", "log_level": "info"}]


async def test_a_job_s_lines_have_what_it_is_about_also_where_it_breaks_off(written: list[EventDict]) -> None:
    async def fails() -> None:
        structlog.get_logger().info("under way")
        raise ValueError("planted")

    jobs = OpenJobs()
    jobs.begin("job", fails, campaign=4, sweep=1)
    await asyncio.wait([task for task in asyncio.all_tasks() if task.get_name() == "job"])
    assert [(line["event"], *about(line)) for line in written] == [("under way", 4, 1), ("job_broke_off", 4, 1)]


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("/api/v1/campaigns/12/sweeps/3/recording", (12, 3)),
        ("/api/v1/campaigns/12", (12, None)),
        ("/api/v1/campaigns/12/start", (12, None)),
        ("/api/v1/campaigns", (None, None)),
        ("/api/v1/campaigns/12x", (None, None)),
        ("/api/v1/robots/12", (None, None)),
    ],
)
async def test_a_request_has_those_of_its_path(
    written: list[EventDict], path: str, expected: tuple[object, object]
) -> None:
    async def app(scope: object, receive: object, send: object) -> None:
        structlog.get_logger().info("asked")

    await Logged(app)({"type": "http", "method": "GET", "path": path, "headers": []}, _never, _sent)
    assert list(map(about, written)) == [expected]


async def _never() -> Message:
    raise AssertionError


async def _sent(message: Message) -> None:
    raise AssertionError(message)


def test_lines_of_libraries_and_warnings_are_json_with_both() -> None:
    """In a process of its own: logging belongs to all of a process."""
    code = (
        "import logging, warnings\n"
        "from service.process.logs import MACHINE\n"
        "from service.process.logs import configure_logs\n"
        "configure_logs('INFO')\n"
        "with MACHINE.sweeps(1, [2]):\n"
        "    logging.getLogger('drivers.canopen').warning('node %d restarted', 3)\n"
        "    warnings.warn('old', stacklevel=1)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    lines = [json.loads(line) for line in done.stderr.splitlines()]
    assert [(line["logger"], line["campaign"], line["sweep"]) for line in lines] == [
        ("drivers.canopen", 1, 2),
        ("py.warnings", 1, 2),
    ]
