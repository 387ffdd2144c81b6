"""What only a real SocketCAN bus shows; the contract suite runs on it as well (`make test-vcan`)."""

import subprocess
from collections.abc import Iterator

import pytest

from drivers.contract.bench import column, consume, eventually
from drivers.errors import CommunicationLost
from drivers.ports import SweepMode
from tests.benchmarks.streamed_run import stream, summary
from tests.contract.bench import AXIS, BENCHES, Virtual, sweep


@pytest.fixture
def virtual() -> Iterator[Virtual]:
    bench = BENCHES["canopen-vcan"]
    with bench.machine(bench) as machine:
        yield machine


def link(state: str) -> None:
    subprocess.run(["ip", "link", "set", "vcan0", state], check=True)


async def test_the_kernel_times_the_set_points(virtual: Virtual) -> None:
    port = virtual.open()
    await port.connect()
    assert port.capabilities.set_point_timing == "bcm"
    await port.enable(AXIS)
    blocks = [block async for block in port.run_sweep(await sweep(port, SweepMode.HOST_STREAMED))]
    assert column(blocks, "index").tolist() == list(range(sum(len(block.index) for block in blocks)))
    assert port.set_point_timing is not None
    assert port.set_point_timing.source == "bcm"
    await port.close()


@pytest.mark.parametrize("mode", list(SweepMode), ids=lambda mode: mode.value)
async def test_an_interface_that_goes_down_in_a_sweep_is_lost_communication(virtual: Virtual, mode: SweepMode) -> None:
    port = virtual.open()
    await port.connect()
    await port.enable(AXIS)
    try:
        with pytest.raises(CommunicationLost):
            await consume(port, await sweep(port, mode, periods=20), lambda _: link("down"))
        await eventually(lambda: virtual.energised() == [], within=60.0)
    finally:
        link("up")
    with pytest.raises(CommunicationLost):
        await port.enable(AXIS)
    await port.close()


def test_a_streamed_run_loses_nothing_and_agrees_with_the_drives_own_sweeps() -> None:
    result = stream("vcan", ["joint_1"], 10.0, 100.0, 0, thread=False)
    assert result["set_points"]["source"] == "bcm"
    assert result["passed"], summary(result)
