"""For all tests: where things lie, and no thread or task of ours outlives the test that started it."""

import asyncio
import functools
import gc
import inspect
import os
import sys
import threading
from collections.abc import Awaitable, Callable, Generator, Iterator
from contextlib import suppress
from pathlib import Path
from time import monotonic
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadScopeScheduling
from xdist.workermanage import WorkerController

# before NumPy is imported, as the product does: with another number of threads a sum may end in another last digit
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# a busy computer must not fail a property: no time limit for one example, nor for making it
settings.register_profile("sweepid", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("sweepid")

ROOT = Path(__file__).resolve().parents[1]
KEEP_TIME = ("contract", "browser", "system")  # folders of tests that mostly wait for a machine
KEEP_TIME_TOO = {
    "tests/unit/drivers/test_commission_command.py",
    "tests/unit/drivers/test_host_sweep.py",
    "tests/unit/drivers/test_host_sweep_ends.py",
    "tests/unit/drivers/test_wiring_check.py",
}
LONGEST = (  # files that a run should begin with, else it ends with one of them alone
    "tests/system/test_fault_table.py",
    "tests/system/test_any_order.py",
    "tests/contract/test_drive_port.py",
    "tests/contract/test_other_makers.py",
    "tests/system/test_makers_campaign.py",
    "tests/system/test_demo.py",
    "tests/system/test_backup_while_measuring.py",
    "tests/contract/test_faults.py",
    "tests/system/test_runbooks.py",
    "tests/system/test_second_host.py",
    "tests/system/test_virtual_modbus.py",
    "tests/browser/test_diagnosis_page.py",
    "tests/system/test_two_cells.py",
    "tests/system/test_suspended.py",
    "tests/contract/test_death.py",
    "tests/system/test_stop.py",
    "tests/browser/test_page_truth.py",
    "tests/numeric/blind/test_blind.py",
)
SHARED_OUT = {  # long files: how many words of a test's parameters name the tests that share a machine; 0: none do
    "tests/system/test_fault_table.py": 1,  # adapter
    "tests/contract/test_drive_port.py": 2,  # bench
    "tests/contract/test_faults.py": 2,
    "tests/system/test_virtual_modbus.py": 3,  # bus, order of words
    "tests/browser/test_login.py": 0,
    "tests/browser/test_operator_page.py": 0,
    "tests/browser/test_page_truth.py": 0,
    "tests/contract/test_death.py": 0,
    "tests/numeric/blind/test_blind.py": 0,
    "tests/system/test_any_order.py": 0,
    "tests/system/test_campaign_in_process.py": 0,
    "tests/system/test_rest_campaign.py": 0,
    "tests/system/test_stop.py": 0,
    "tests/system/test_stops_in_the_audit.py": 0,
    "tests/system/test_suspended.py": 0,
    "tests/system/test_two_cells.py": 0,
    "tests/system/test_two_steps.py": 0,
    "tests/system/test_virtual_faults.py": 0,
}
MACHINES = 2  # that are moved at once while tests are left that compute: more would starve those, who give way
RECKONING = 10  # nicer than a test that waits for a machine
REAL_TIME = -15  # machine, service and host of a test come before all else on the computer, as a drive's own processor
NICENESS = 0 if sys.platform == "win32" else os.getpriority(os.PRIO_PROCESS, 0)
SESSION = Path("/proc/self/autogroup")  # Linux shares the processors out by session first, then by niceness within
SESSION_BEFORE = pytest.StashKey[int]()  # its niceness when the tests began
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


def keeps_time(nodeid: str) -> bool:
    """Whether a test, or the tests of a file, must keep to real time."""
    path = nodeid.partition("::")[0]
    return path in KEEP_TIME_TOO or any(folder in path.split("/") for folder in KEEP_TIME)


def unit_of(nodeid: str) -> str:
    """Which tests stay in one process with this one: those of its file, or of `SHARED_OUT` fewer."""
    path = nodeid.partition("::")[0]
    words = SHARED_OUT.get(path)
    if words is None:
        return path
    parameters = nodeid.partition("[")[2].removesuffix("]").split("-")
    return nodeid if words == 0 else f"{path}::[{'-'.join(parameters[:words])}]"


def _place(unit: str) -> int:
    """In which order units begin."""
    path = unit.partition("::")[0]
    return LONGEST.index(path) if path in LONGEST else len(LONGEST)


class MachinesAtOnce(LoadScopeScheduling):
    """A unit to whichever process is free: one that keeps to time unless enough machines move; longest first.

    Once nothing else is left, each process moves a machine: they wait more than they compute. Private names of xdist
    3.8: no public one says which unit is next.
    """

    def _split_scope(self, nodeid: str) -> str:
        return unit_of(nodeid)

    def _reschedule(self, node: WorkerController) -> None:
        """A process has one test that runs and one that follows: with more a long test waits where others are free.

        It runs a test when it knows the next one, or that there is none: one that took the place of a process that died
        would wait for ever with a single one.
        """
        while self.workqueue and not node.shutting_down and self._pending_of(self.assigned_work[node]) < 2:
            self._assign_work_unit(node)
        if not self.workqueue and not node.shutting_down:
            node.shutdown()

    def remove_node(self, node: WorkerController) -> str | None:
        """What a process had done before it died is not handed on: whoever got it would wait for its end for ever.

        The test that it died of counts as done: it would end the others too.
        """
        workload = self.assigned_work[node]
        if self._pending_of(workload):
            running = next(nodeid for done in workload.values() for nodeid, it_is in done.items() if not it_is)
            workload[unit_of(running)][running] = True
        else:
            running = None
        for unit in [unit for unit, done in workload.items() if all(done.values())]:
            del workload[unit]
        super().remove_node(node)
        return running

    def _assign_work_unit(self, node: WorkerController) -> None:
        moving = sum(self._moves(other) for other in self.assigned_work if other is not node)
        waiting = sorted(self.workqueue, key=_place)
        unit = next((unit for unit in waiting if keeps_time(unit) == (moving < MACHINES)), waiting[0])
        self.workqueue.move_to_end(unit, last=False)
        super()._assign_work_unit(node)

    def _moves(self, node: WorkerController) -> bool:
        return any(keeps_time(unit) and not all(done.values()) for unit, done in self.assigned_work[node].items())


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> MachinesAtOnce:
    return MachinesAtOnce(config, log)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """What keeps to real time comes first, where that is permitted (to root); tests that reckon give way to it."""
    if sys.platform == "win32":
        return
    beside_others = hasattr(item.config, "workerinput")
    niceness = REAL_TIME if keeps_time(item.nodeid) else RECKONING * beside_others
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, NICENESS + niceness)


def session_comes_first(niceness: int) -> int:
    """The same for all of this terminal session against others on the computer, where there is such a thing.

    Returns what it was before: a pytest that a test has started leaves the session as it found it.
    """
    before = 0
    with suppress(OSError, ValueError):
        before = int(SESSION.read_text().rpartition(" ")[2])
        SESSION.write_text(str(niceness))
    return before


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


def pytest_sessionstart(session: pytest.Session) -> None:
    if not hasattr(session.config, "workerinput"):
        session.config.stash[SESSION_BEFORE] = session_comes_first(REAL_TIME)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """With --vcan a skipped test is a failed run: what the kernel lacks must not look green."""
    if not hasattr(session.config, "workerinput"):
        session_comes_first(session.config.stash.get(SESSION_BEFORE, 0))
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
