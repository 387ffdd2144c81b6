"""For all tests: where things lie, and no thread or task of ours outlives the test that started it."""

import asyncio
import functools
import inspect
import os
import sys
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import Any

import pytest
from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

# before NumPy is imported, as the product does: with another number of threads a sum may end in another last digit
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[1]
KEEP_TIME = {
    "contract": "drives",
    "browser": "machines",
    "system": "machines",
}  # folders that mostly wait for a machine
BESIDE = {  # files that go with the drives, for the machines take long enough
    "tests/system/test_demo.py",
    "tests/system/test_fault_table.py",
    "tests/unit/drivers/test_commission_command.py",
    "tests/unit/drivers/test_host_sweep.py",
    "tests/unit/drivers/test_host_sweep_ends.py",
    "tests/unit/drivers/test_wiring_check.py",
}
TIMED = ("machines", "drives")
RECKONING = 10  # nicer than a test that waits for a machine
REAL_TIME = -15  # machine, service and host of a test come before all else on the computer, as a drive's own processor
NICENESS = 0 if sys.platform == "win32" else os.getpriority(os.PRIO_PROCESS, 0)
SESSION = Path("/proc/self/autogroup")  # Linux shares the processors out by session first, then by niceness within
ROOMS = ("service", "drivers", "simulator")
PATIENCE = 2.0  # s that a thread or task may take to end after its test


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--every-drive", action="store_true", help="the contract suite on every bench, see `make test-drives`"
    )
    parser.addoption("--vcan", action="store_true", help="test what needs the kernel's vcan0, instead of what does not")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """tests/vcan is for `make test-vcan` alone."""
    return True if collection_path == ROOT / "tests" / "vcan" and not config.getoption("vcan") else None


def group_of(nodeid: str) -> str:
    """What the processes of `make test` must not tear apart: tests of one file, and the two groups that keep to time.

    Each of the two moves one machine at a time: more than two machines are too much for two processors.
    """
    path = nodeid.partition("::")[0]
    if path in BESIDE:
        return "drives"
    return next((group for folder, group in KEEP_TIME.items() if folder in path.split("/")), path)


def keeps_time(nodeid: str) -> bool:
    return group_of(nodeid) in TIMED


class Apart(LoadScopeScheduling):
    """One group of tests after the other to whichever process is free: those that keep to time, then the largest."""

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid)

    def _assign_work_unit(self, node: WorkerController) -> None:
        for group in reversed(TIMED):
            if group in self.workqueue:
                self.workqueue.move_to_end(group, last=False)
        super()._assign_work_unit(node)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Apart:
    """The groups by name: pytest 9.2 no longer shows the marks of items to xdist 3.8."""
    return Apart(config, log)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """What keeps to real time comes first, where that is permitted (to root); tests that reckon give way to it."""
    if sys.platform == "win32":
        return
    beside_others = hasattr(item.config, "workerinput")
    niceness = REAL_TIME if keeps_time(item.nodeid) else RECKONING * beside_others
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS + niceness)


def session_comes_first(niceness: int) -> None:
    """The same for all of this terminal session against others on the computer, where there is such a thing."""
    with suppress(OSError):
        SESSION.write_text(str(niceness))


def pytest_sessionstart(session: pytest.Session) -> None:
    if not hasattr(session.config, "workerinput"):
        session_comes_first(REAL_TIME)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """With --vcan a skipped test is a failed run: what the kernel lacks must not look green."""
    if not hasattr(session.config, "workerinput"):
        session_comes_first(0)
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if session.config.getoption("vcan") and reporter is not None and reporter.stats.get("skipped"):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.fixture(scope="session")
def root() -> Path:
    """The checkout."""
    return ROOT


def shared_folder() -> Path:
    """Measured data beside the checkout, or where SWEEPID_SHARED says; the test is skipped without."""
    folder = Path(os.environ.get("SWEEPID_SHARED", ROOT.parent / "shared"))
    if not (folder / "data").is_dir():
        pytest.skip(f"no measured data in {folder.name}/data beside the checkout; SWEEPID_SHARED names another place")
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
    return module.split(".")[0] in ROOMS or not (thread.daemon or module.startswith("concurrent.futures"))


def _in_a_room(task: asyncio.Task[Any]) -> bool:
    code = getattr(task.get_coro(), "cr_code", None)
    return code is not None and any(Path(code.co_filename).is_relative_to(ROOT / room) for room in ROOMS)
