"""What only a real SocketCAN bus shows; the contract suite runs on it as well (`make test-vcan`)."""

import subprocess
from collections.abc import Iterator

import pytest

from drivers.contract.bench import column, consume, eventually
from drivers.errors import CommunicationLost
from drivers.ports import SweepMode
from tests.contract.bench import AXIS, BENCHES, Virtual, sweep
from tests.contract.sweeps import POSE, command, compare, move, robot, run


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


async def test_a_streamed_run_loses_nothing_and_agrees_with_the_drives_own_sweeps(virtual: Virtual) -> None:
    port = virtual.open()
    await port.connect()
    await move(port, POSE)
    runs = []
    for mode in (SweepMode.DRIVE_SIDE, SweepMode.HOST_STREAMED, SweepMode.DRIVE_SIDE):
        for forward in (True, False) * 2:
            start = (await port.status())[AXIS].position
            swept = command(robot(), AXIS, start, forward, mode, 1 / virtual.bench.sync_period)
            runs.append(await run(port, robot(), [swept], POSE))
    await port.close()
    assert all(each.gapless for each in runs)
    found = compare(robot(), runs, AXIS)
    assert abs(found.z) < 3, f"J {found.streamed:.2f} streamed, {found.drive_side:.2f} drive-side, z {found.z:+.1f}"
