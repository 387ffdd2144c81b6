"""For all tests: where things lie, and no thread or task of ours outlives the test that started it."""

import asyncio
import functools
import gc
import inspect
import os
import threading
from collections import Counter
from collections.abc import Awaitable, Callable, Generator, Iterator
from pathlib import Path
from time import monotonic
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from tests.tiers import PARTS, part_of

# before NumPy is imported, as the product does: with another number of threads a sum may end in another last digit
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# a busy computer must not fail a property: no time limit for one example, nor for making it
settings.register_profile("sweepid", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("sweepid")

pytest_plugins = ("tests.virtual_time.plugin",)

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("sweepid", "service", "drivers", "simulator")
PATIENCE = 30.0  # s that a thread or task may take to end after its test: a failing test alone waits for so long
NO_DATA = "no measured data"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--every-drive", action="store_true", help="the contract suite on every bench, see `make test-drives`"
    )
    parser.addoption("--tier", type=int, choices=(1, 2), help="the tests of this tier, see tests/tiers.py")
    parser.addoption("--part", type=int, choices=range(1, PARTS + 1), help="this part of the second tier")
    parser.addoption("--vcan", action="store_true", help="test what needs the kernel's vcan0, instead of what does not")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """tests/vcan is for `make test-vcan` alone."""
    return True if collection_path == ROOT / "tests" / "vcan" and not config.getoption("vcan") else None


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """What is loaded by now stays until the end: a full garbage collection of it would stop all threads for 0.6 s."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what neither --tier nor --part asks for; without them all tests run."""
    tier, part = config.getoption("tier"), config.getoption("part")
    if tier is None and part is None:
        return
    left: list[pytest.Item] = []
    chosen: list[pytest.Item] = []
    for item in items:
        of = part_of(item.nodeid)
        asked_for = tier == (1 if of is None else 2) or (of is not None and of == part)
        (chosen if asked_for else left).append(item)
    config.hook.pytest_deselected(items=left)
    items[:] = chosen


def _skips(config: pytest.Config) -> Counter[str]:
    """How many tests were skipped, by reason."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    reports = reporter.stats.get("skipped", []) if reporter is not None else []
    return Counter(str(report.longrepr[2]).removeprefix("Skipped: ") for report in reports)


def _skips_that_fail(config: pytest.Config) -> int:
    """What a computer lacks must not look green in CI, nor what the kernel lacks with --vcan.

    Measured data are no package: they are not everybody's.
    """
    if not config.getoption("vcan") and "CI" not in os.environ:
        return 0
    return sum(count for reason, count in _skips(config).items() if not reason.startswith(NO_DATA))


def pytest_sessionfinish(session: pytest.Session) -> None:
    if _skips_that_fail(session.config):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    if skips := _skips(config):
        terminalreporter.section(f"{skips.total()} skipped")
        for reason, count in skips.most_common():
            terminalreporter.line(f"{count:5} {reason}")
    if failing := _skips_that_fail(config):
        terminalreporter.line(f"FAILED: {failing} skipped tests, which CI and --vcan do not permit", red=True)


@pytest.fixture(scope="session")
def root() -> Path:
    """The checkout."""
    return ROOT


def shared_folder() -> Path:
    """Measured data beside the checkout, or where SWEEPID_SHARED says; the test is skipped without."""
    folder = Path(os.environ.get("SWEEPID_SHARED", ROOT.parent / "shared"))
    if not (folder / "data").is_dir():
        pytest.skip(f"{NO_DATA} in {folder.name}/data beside the checkout; SWEEPID_SHARED names another place")
    return folder


@pytest.fixture(scope="session")
def shared() -> Path:
    """`shared_folder`, for a test that reads it."""
    return shared_folder()


@pytest.fixture(autouse=True)
def no_leaked_threads() -> Iterator[None]:
    """Fail a test after which a thread runs that would keep the process alive or that runs our code."""
    before = set(threading.enumerate())
    yield
    deadline = monotonic() + PATIENCE
    leaked = [thread for thread in threading.enumerate() if thread not in before and _ours(thread)]
    for thread in leaked:
        thread.join(max(0.0, deadline - monotonic()))
    left = [thread for thread in leaked if thread.is_alive()]
    if left:
        pytest.fail(f"threads left running: {', '.join(thread.name for thread in left)}")


def pytest_itemcollected(item: pytest.Item) -> None:
    """Async tests are checked for tasks, inside of their own loop."""
    if isinstance(item, pytest.Function) and inspect.iscoroutinefunction(item.obj):
        item.obj = _without_leaked_tasks(item.obj)


def _without_leaked_tasks(test: Callable[..., Awaitable[None]]) -> Callable[..., Awaitable[None]]:
    @functools.wraps(test)
    async def checked(*args: Any, **kwargs: Any) -> None:
        before = asyncio.all_tasks()
        await test(*args, **kwargs)
        leaked = {task for task in asyncio.all_tasks() - before if _in_a_room(task)}
        if leaked:
            _, left = await asyncio.wait(leaked, timeout=PATIENCE)
            if left:
                pytest.fail(f"tasks left running: {', '.join(sorted(repr(task.get_coro()) for task in left))}")

    return checked


def _ours(thread: threading.Thread) -> bool:
    """Pools and helpers of libraries are daemons or end with the process; ours must end with the test."""
    target = getattr(thread, "_target", None)
    module = getattr(target, "__module__", None) or type(thread).__module__
    return module.split(".")[0] in ROOMS or not (thread.daemon or module.startswith(("anyio", "concurrent.futures")))


def _in_a_room(task: asyncio.Task[Any]) -> bool:
    code = getattr(task.get_coro(), "cr_code", None)
    return code is not None and any(Path(code.co_filename).is_relative_to(ROOT / room) for room in ROOMS)
