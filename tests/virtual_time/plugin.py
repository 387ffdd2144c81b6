"""pytest: the fixtures `clock`, `machine` and `service`, and the option `--seed` (docs/explanation/virtual-time.md).

A test that asks for one of them runs in a copy of the pytest process, which lives in virtual time; the others run in
the original, in real time.
"""

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from _pytest.runner import runtestprotocol

from tests.virtual_time import primitives, world
from tests.virtual_time.clock import Clock
from tests.virtual_time.explore import Explorer

if TYPE_CHECKING:  # the product, which a process that runs no test in virtual time does not load
    from tests.virtual_time.factory import Factory
    from tests.virtual_time.machine import VirtualMachine
    from tests.virtual_time.service import VirtualService

_COPY = pytest.StashKey[bool]()


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--seed", type=int, default=0, help="the interleaving of tests in virtual time; 0: in order")
    parser.addoption("--explore", type=float, default=1.0, help="so many times as many seeds; failing ones are stored")
    parser.addoption("--explore-log", default="", help="file that gets a line for each interleaving as soon as it ends")


def in_virtual_time(item: pytest.Item) -> bool:
    return "clock" in getattr(item, "fixturenames", ())


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """In a copy; what it reports is reported here."""
    if not in_virtual_time(item):
        return None
    import_module("tests.virtual_time.factory")  # a copy must not load for itself
    config = item.config
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)

    def run() -> list[dict[str, object]]:
        seed = int(config.getoption("seed"))  # pyright: ignore[reportArgumentType]
        scheduler = world.enter(0 if "explore" in item.fixturenames else seed)  # pyright: ignore[reportAttributeAccessIssue]
        reports = runtestprotocol(item, log=False, nextitem=item.parent)  # pyright: ignore[reportArgumentType]
        for report in reports:
            report.user_properties += [("seed", seed), ("interleaving", scheduler.digest.hexdigest())]
            if report.failed:
                again = f"{item.nodeid} --seed {scheduler.seed}"
                last = "\n".join(scheduler.history)
                report.sections.append(("virtual time", f"again: {again}\nlast switches and frames:\n{last}"))
        return [config.hook.pytest_report_to_serializable(config=config, report=report) for report in reports]

    try:
        reports = [
            config.hook.pytest_report_from_serializable(config=config, data=data) for data in world.in_a_copy(run)
        ]
    except world.CopyFailed as failed:
        reports = [pytest.TestReport(item.nodeid, item.location, {}, "failed", str(failed), "call")]
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    session: Any = item.session
    session._setupstate.teardown_exact(
        nextitem
    )  # what earlier tests in real time share with this one, and no later one
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


@pytest.fixture
def clock() -> Clock:
    """The virtual time in which this test runs."""
    return Clock(primitives.world)


@pytest.fixture
def explore(clock: Clock, request: pytest.FixtureRequest) -> Explorer:
    """Many interleavings of a test, from a snapshot."""
    config: Any = request.config
    return Explorer(
        request.node.nodeid,
        int(config.getoption("seed")),
        float(config.getoption("explore")),
        str(config.getoption("explore_log")),
    )


@pytest.fixture
def machine(clock: Clock, tmp_path: Path, request: pytest.FixtureRequest) -> "VirtualMachine":
    """The virtual machine of the house, its power on; with an indirect parameter on "modbus"."""
    from tests.virtual_time.machine import VirtualMachine

    del clock
    return VirtualMachine(tmp_path, getattr(request, "param", "canopen"))


@pytest.fixture
def factory(clock: Clock, tmp_path: Path) -> "Iterator[Factory]":
    """Where random sequences begin."""
    from tests.virtual_time.factory import open_factory

    factory, close = open_factory(tmp_path, clock)
    yield factory
    close()


@pytest.fixture
def service(machine: "VirtualMachine", clock: Clock, tmp_path: Path) -> "Iterator[VirtualService]":
    """A service that owns the machine, ready."""
    from tests.virtual_time.service import VirtualService

    service = VirtualService(tmp_path, machine, clock)
    service.start()
    yield service
    service.close()
