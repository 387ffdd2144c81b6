"""The fixtures of the contract suite: every adapter on every bus. What a bench lacks is no test of it, and no skip.

There is one mark, ``adapter(name)``: a test of this adapter alone. The rest is in `drivers.contract.requirements`.
"""

from collections.abc import AsyncIterator, Iterator
from typing import Any, cast

import pytest

from drivers.contract import lacking
from drivers.contract.suite import connected_port
from drivers.ports import DrivePort, SweepMode
from tests.contract.bench import BENCHES, Virtual


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "adapter(name): see tests/contract/conftest.py")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    vcan, every = bool(config.getoption("vcan")), bool(config.getoption("every_drive"))
    items[:] = [item for item in items if _exists(item, vcan, every)]


def _exists(item: pytest.Item, vcan: bool, every: bool) -> bool:
    given: dict[str, Any] = (
        item.callspec.params if isinstance(item, pytest.Function) and hasattr(item, "callspec") else {}
    )
    name = given.get("virtual", given.get("mortal"))
    if name is None:
        return not vcan or "vcan" in item.path.parts
    bench, adapter = BENCHES[name], item.get_closest_marker("adapter")
    return (
        bench.vcan is vcan
        and (every or not bench.alike)
        and (bench.own_process or "mortal" not in given)
        and (adapter is None or adapter.args == (bench.adapter,))
        and not lacking(cast("pytest.Function", item).function, bench, given.get("mode"))
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
    async for connected in connected_port(virtual):
        yield connected
