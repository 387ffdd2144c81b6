"""The fixtures of the contract suite: every adapter on every bus. What a bench lacks is no test of it, and no skip.

There is one mark, ``adapter(name)``: a test of this adapter alone. The rest is in `drivers.contract.bench`.
"""

from collections.abc import AsyncIterator, Iterator

import pytest

from drivers.contract.bench import connected_port
from drivers.ports import DrivePort, SweepMode
from tests.contract.bench import BENCHES, Virtual, leave_out


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "adapter(name): see tests/contract/conftest.py")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    leave_out(config, items)


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
