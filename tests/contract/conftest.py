"""The fixtures of the contract suite: every adapter on every bus."""

import asyncio
import threading
from collections.abc import AsyncIterator, Iterator

import pytest

from drivers.ports import DrivePort
from tests.contract.bench import AXIS, BENCHES, OTHER, Virtual


@pytest.fixture(scope="module", params=list(BENCHES))
def virtual(request: pytest.FixtureRequest) -> Iterator[Virtual]:
    """One virtual machine for a module's tests."""
    with BENCHES[request.param]() as machine:
        yield machine


@pytest.fixture
async def port(virtual: Virtual) -> AsyncIterator[DrivePort]:
    """Connected, every fault acknowledged; closed afterwards with the machine's disturbances taken back."""
    connected = virtual.open()
    await connected.connect()
    for joint in connected.joints:
        await connected.acknowledge(joint)
    yield connected
    for joint in (AXIS, OTHER):
        virtual.order("silence", joint=joint, on=False)
        virtual.order("freeze_counter", joint=joint, on=False)
        virtual.order("drop_tpdos", joint=joint, count=0)
    virtual.order("emergency_stop", on=False)
    await connected.close()
    assert virtual.energised() == []
    left = {thread.name for thread in threading.enumerate() if thread.name.startswith("can-")}
    assert not left
    assert len(asyncio.all_tasks()) == 1
