"""The fixtures of the suite's classes. The user provides the fixture `virtual`, a `Machine`."""

import asyncio
import threading
from collections.abc import AsyncGenerator

import pytest

from drivers.contract.bench import Machine
from drivers.contract.requirements import lacking
from drivers.ports import DrivePort, SweepMode


class Suite:
    """A test with the fixture `mode` runs once for every sweep mode."""

    @pytest.fixture(params=list(SweepMode), ids=lambda mode: mode.value)
    def mode(self, request: pytest.FixtureRequest) -> SweepMode:
        return request.param

    @pytest.fixture(autouse=True)
    def fitting(self, request: pytest.FixtureRequest, virtual: Machine) -> None:
        """Skips tests of functions that the bench lacks."""
        mode = request.getfixturevalue("mode") if "mode" in request.fixturenames else None
        if reason := lacking(request.function, virtual.bench, mode):
            pytest.skip(reason)

    @pytest.fixture
    def axis(self, virtual: Machine) -> str:
        return virtual.bench.axis

    @pytest.fixture
    def other(self, virtual: Machine, fitting: None) -> str:
        assert virtual.bench.other is not None
        return virtual.bench.other

    @pytest.fixture
    async def port(self, virtual: Machine, fitting: None) -> AsyncGenerator[DrivePort]:
        """Connected, with every fault acknowledged. Closed afterwards, and the disturbances of the machine are
        removed.
        """
        async for connected in connected_port(virtual):
            yield connected


async def connected_port(virtual: Machine) -> AsyncGenerator[DrivePort]:
    """Implementation of the fixture `port`."""
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
