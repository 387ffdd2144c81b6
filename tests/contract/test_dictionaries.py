"""Drives of several makers: one adapter on dictionaries that lack objects, offer other options, count otherwise."""

import asyncio
import threading
from collections.abc import AsyncIterator, Iterator
from typing import Any, cast

import numpy as np
import pytest

from drivers.contract.bench import column, consume
from drivers.errors import DriveFault, EnvelopeLeft, LimitExceeded, NotReady
from drivers.ports import AxisState, DrivePort, SampleBlock, SweepMode
from drivers.registry import open_drive
from tests.contract.bench import AXIS, BENCHES, DRIVES, EDS, Virtual, in_one_process, noise, sweep

FULL, BARE, RPM = EDS, EDS.with_stem("virtual-axis-no-limits"), EDS.with_stem("virtual-axis-rpm")


def fitted(virtual: Virtual, eds: str, product: int = 0x0402, **changes: Any) -> dict[str, object]:
    """The machine's profile with another EDS, for drives of another product."""
    axes = [
        {**axis, "load_encoder": "rpm" not in eds, "identity": {**axis["identity"], "product": product}}
        for axis in cast("list[dict[str, Any]]", virtual.profile["axes"])
    ]
    return {**virtual.profile, "eds": eds, "axes": axes, **changes}


async def connected(profile: dict[str, object]) -> AsyncIterator[DrivePort]:
    port = open_drive(profile, DRIVES)
    await port.connect()
    yield port
    await port.close()
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("can-")]
    assert len(asyncio.all_tasks()) == 1


@pytest.fixture(scope="module")
def bare() -> Iterator[Virtual]:
    with in_one_process(BENCHES["canopen-virtual"], BARE) as virtual:
        yield virtual


@pytest.fixture(scope="module")
def rpm() -> Iterator[Virtual]:
    with in_one_process(BENCHES["canopen-virtual"], RPM) as virtual:
        yield virtual


@pytest.fixture
async def bare_port(bare: Virtual) -> AsyncIterator[DrivePort]:
    async for port in connected(fitted(bare, str(BARE))):
        yield port


@pytest.fixture
async def rpm_port(rpm: Virtual) -> AsyncIterator[DrivePort]:
    async for port in connected(fitted(rpm, str(RPM), 0x0403, stop_options={"quick_stop": 6})):
        yield port


async def test_what_the_drive_cannot_limit_is_told(bare_port: DrivePort) -> None:
    can = bare_port.capabilities
    assert (can.velocity_limit_in_drive, can.effort_limit_in_drive, can.position_limits_in_drive) == (False,) * 3
    assert can.host_watchdog_in_drive
    assert can.sweep_modes == frozenset(SweepMode)


@pytest.mark.parametrize("mode", list(SweepMode), ids=lambda mode: mode.value)
async def test_the_host_enforces_the_effort_that_the_drive_does_not(
    bare_port: DrivePort, bare: Virtual, mode: SweepMode
) -> None:
    await bare_port.enable(AXIS)
    with pytest.raises(EnvelopeLeft, match=f"{AXIS} .*effort .* is beyond 100 N m"):
        await consume(bare_port, await sweep(bare_port, mode, effort_limit=100.0, periods=20))
    assert bare.energised() == []
    assert (await bare_port.status())[AXIS].state is AxisState.DISABLED


async def test_the_host_enforces_the_effort_of_a_noise_run_and_restores_the_control(
    bare_port: DrivePort, bare: Virtual
) -> None:
    assert bare_port.capabilities.torque_injection
    await bare_port.enable(AXIS)
    with pytest.raises(EnvelopeLeft, match=f"{AXIS} .*effort .* is beyond 100 N m"):
        await consume(bare_port, await noise(bare_port, effort_limit=100.0, periods=80))
    assert bare.energised() == []
    assert bare.truth()["softened"] is False


async def test_a_drive_without_torque_noise_is_told_and_sweeps_all_the_same(rpm_port: DrivePort) -> None:
    assert not rpm_port.capabilities.torque_injection
    await rpm_port.enable(AXIS)
    with pytest.raises(NotReady, match=r"joint_1 \(node 1\): torque noise is not supported by this drive"):
        await consume(rpm_port, await noise(rpm_port))
    await consume(rpm_port, await sweep(rpm_port, SweepMode.DRIVE_SIDE, periods=1))


async def test_a_drive_that_counts_in_whole_rev_per_min_measures_by_itself(rpm_port: DrivePort, rpm: Virtual) -> None:
    assert not rpm_port.capabilities.load_encoder
    await rpm_port.enable(AXIS)
    blocks: list[SampleBlock] = []
    await consume(rpm_port, await sweep(rpm_port, SweepMode.DRIVE_SIDE), blocks.append)
    position, velocity, time = (column(blocks, name) for name in ("position", "velocity", "time"))
    travelled = np.sum((velocity[1:] + velocity[:-1]) / 2 * np.diff(time))
    assert position[-1] - position[0] == pytest.approx(travelled, rel=1e-2)
    assert 0.01 < travelled < 0.02
    with pytest.raises(LimitExceeded, match="fewer than 20 steps of the drive's velocity unit"):
        await consume(rpm_port, await sweep(rpm_port, SweepMode.HOST_STREAMED))
    assert rpm.energised() == []


async def test_a_drive_that_stays_in_quick_stop_loses_its_energy_all_the_same(
    rpm_port: DrivePort, rpm: Virtual
) -> None:
    await rpm_port.enable(AXIS)
    running = rpm_port.run_sweep(
        await sweep(rpm_port, SweepMode.DRIVE_SIDE, periods=200, offset_velocity=0.002, sines=())
    )
    await anext(running)
    await rpm_port.stop()
    assert rpm.energised() == []
    await running.aclose()
    rpm.order("fault", joint=AXIS, code=0x7305)
    with pytest.raises(DriveFault, match="7305h"):
        await rpm_port.enable(AXIS)
    await rpm_port.acknowledge(AXIS)
