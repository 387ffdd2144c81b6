"""The fixtures of the contract suite: every adapter on every bus. What a bench lacks is no test of it, and no skip.

A test that asks for `mode` runs once for every sweep mode. Marks say what a test needs of its bench:

- ``adapter(name)``: this adapter
- ``has(mode)``: this sweep mode; ``missing``: not the mode of `mode`
- ``injects(yes)``: a drive that makes torque noise, or one that does not
- ``orders(name, ...)``: these orders of the control port
- ``exclusive(yes)``: a bus or line that takes one host at a time, or one that takes several
"""

import asyncio
import threading
from collections.abc import AsyncIterator, Iterator

import pytest

from drivers.ports import DrivePort, SweepMode
from tests.contract.bench import BENCHES, Virtual


def pytest_configure(config: pytest.Config) -> None:
    for marker in ("adapter(name)", "has(mode)", "missing", "injects(yes)", "orders(*names)", "exclusive(yes)"):
        config.addinivalue_line("markers", f"{marker}: see tests/contract/conftest.py")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    vcan, every = config.getoption("vcan"), config.getoption("every_drive")
    items[:] = [item for item in items if _exists(item, vcan, every)]


def _exists(item: pytest.Item, vcan: bool, every: bool) -> bool:
    given = item.callspec.params if isinstance(item, pytest.Function) and hasattr(item, "callspec") else {}
    name = given.get("virtual", given.get("mortal"))
    if name is None:
        return not vcan or "vcan" in item.path.parts
    bench, marks = BENCHES[name], {mark.name: mark.args for mark in reversed(list(item.iter_markers()))}
    return (
        bench.vcan is vcan
        and (every or not bench.alike)
        and (bench.own_process or "mortal" not in given)
        and ("mode" not in given or (given["mode"] in bench.modes) is ("missing" not in marks))
        and marks.get("adapter", (bench.adapter,)) == (bench.adapter,)
        and bench.modes.issuperset(marks.get("has", ()))
        and bench.orders.issuperset(marks.get("orders", ()))
        and marks.get("injects", (bench.injects,)) == (bench.injects,)
        and marks.get("exclusive", (bench.exclusive,)) == (bench.exclusive,)
    )


@pytest.fixture(params=list(SweepMode), ids=lambda mode: mode.value)
def mode(request: pytest.FixtureRequest) -> SweepMode:
    return request.param


@pytest.fixture(scope="module", params=list(BENCHES))
def virtual(request: pytest.FixtureRequest) -> Iterator[Virtual]:
    """One virtual machine for a module's tests."""
    bench = BENCHES[request.param]
    with bench.machine(bench) as machine:
        yield machine


@pytest.fixture(params=list(BENCHES))
def mortal(request: pytest.FixtureRequest) -> Iterator[Virtual]:
    """A virtual machine of one's own, in a process that may be killed."""
    bench = BENCHES[request.param]
    with bench.machine(bench) as machine:
        yield machine


@pytest.fixture
async def port(virtual: Virtual) -> AsyncIterator[DrivePort]:
    """Connected, every fault acknowledged; closed afterwards with the machine's disturbances taken back."""
    connected = virtual.open()
    await connected.connect()
    for joint in connected.joints:
        await connected.acknowledge(joint)
    yield connected
    virtual.recover()
    await connected.close()
    assert virtual.energised() == []
    left = {thread.name for thread in threading.enumerate() if thread.name.startswith("can-")}
    assert not left
    assert len(asyncio.all_tasks()) == 1
