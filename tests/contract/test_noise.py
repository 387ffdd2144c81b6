"""Torque noise: what every `DrivePort` that injects it must do; its numbers are those of the virtual machine's axis."""

import asyncio
from contextlib import suppress
from typing import Any, cast

import numpy as np
import pytest

from drivers.contract.bench import column, consume, eventually, needs
from drivers.errors import DriveFault, EnvelopeLeft, SweepInterrupted, SweepRejected
from drivers.ports import AxisState, DrivePort, SampleBlock, SweepMode
from tests.contract.bench import AXIS, Virtual, noise, sweep

# interrupted on its way: 80 s of a slow turn, 4 s of a machine at 20 times real time
LONG: dict[str, Any] = {"periods": 160, "offset_velocity": 0.005}

injecting = needs(injects=True)


def excitation(blocks: list[SampleBlock]) -> np.ndarray:
    return np.concatenate([block.excitation_effort for block in blocks if block.excitation_effort is not None])


@injecting
async def test_noise_is_injected_and_recorded_and_the_control_restored(port: DrivePort, virtual: Virtual) -> None:
    await port.enable(AXIS)
    command = await noise(port)
    blocks: list[SampleBlock] = []
    await consume(port, command, blocks.append)
    assert virtual.truth()["softened"] is False
    index, injected = column(blocks, "index"), excitation(blocks)
    assert np.array_equal(index, np.arange(round(command.duration * 250)))
    assert len(injected) == len(index)
    # the injected torque: silent at both ends, equal lines of the wanted RMS, the same in every period
    assert np.abs(injected[[0, -1]]).max() < 0.5
    window = injected[round(command.measure_from * 250) :][: 4 * 125].reshape(4, 125)
    assert np.abs(window - window[0]).max() < 1e-3  # of 60 N m
    lines = 2 * np.abs(np.fft.rfft(window[0])) / 125
    assert lines[1:21] == pytest.approx(np.full(20, 60 * np.sqrt(2 / 20)), rel=0.06)  # 4 ms means: -4 % at 40 Hz
    assert max(lines[0], *lines[21:]) < 0.2
    # it is in the torque, and it moves the axis on top of the slow turn
    effort, velocity = column(blocks, "effort"), column(blocks, "velocity")
    assert np.corrcoef(effort, injected)[0, 1] > 0.4
    setpoint = column(blocks, "velocity_setpoint")[150:500]
    assert setpoint == pytest.approx(np.full(350, 0.0105), rel=1e-5)
    assert np.std(velocity[150:500]) > 5e-4
    status = (await port.status())[AXIS]
    assert status.state is AxisState.ENABLED
    assert status.velocity == pytest.approx(0.0, abs=2e-3)


@injecting
async def test_the_seed_decides_and_the_next_sweep_has_no_noise(port: DrivePort) -> None:
    await port.enable(AXIS)
    kept: list[np.ndarray] = []
    for seed in (7, 7, 8):
        blocks: list[SampleBlock] = []
        await consume(port, await noise(port, periods=1, seed=seed), blocks.append)
        kept.append(excitation(blocks))
    assert np.array_equal(kept[0], kept[1])
    assert abs(np.corrcoef(kept[0], kept[2])[0, 1]) < 0.9
    blocks = []
    await consume(port, await sweep(port, SweepMode.DRIVE_SIDE, periods=1), blocks.append)
    assert all(block.excitation_effort is None for block in blocks)
    assert np.array_equal(column(blocks, "index"), np.arange(275))


@injecting
async def test_the_drive_refuses_peaks_above_its_torque_limit(port: DrivePort, virtual: Virtual) -> None:
    await port.enable(AXIS)
    before = virtual.truth()["position"]
    with pytest.raises(SweepRejected, match=r"joint_1 .*rejected: torque"):
        await consume(port, await noise(port, effort=140.0, effort_limit=150.0))
    assert virtual.truth()["position"] == pytest.approx(before, abs=1e-4)
    assert virtual.energised() == []
    assert virtual.truth()["softened"] is False


@injecting
@pytest.mark.parametrize("way", ["closed", "cancelled", "stopped", "disabled", "port closed"])
async def test_every_early_end_leaves_the_axis_down_and_the_control_restored(
    port: DrivePort, virtual: Virtual, way: str
) -> None:
    await port.enable(AXIS)
    running = port.run_noise(await noise(port, **LONG))
    await anext(running)
    assert virtual.truth()["softened"] is True
    if way == "closed":
        await running.aclose()
    elif way == "cancelled":
        task = asyncio.create_task(_rest(running))
        await asyncio.sleep(0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        await eventually(lambda: virtual.energised() == [])
    else:
        await {"stopped": port.stop, "disabled": lambda: port.disable(AXIS), "port closed": port.close}[way]()
        assert virtual.energised() == []
        with pytest.raises(SweepInterrupted):
            await _rest(running)
    await eventually(lambda: virtual.truth()["softened"] is False)
    assert virtual.energised() == []
    assert virtual.truth()["velocity"] == pytest.approx(0.0, abs=1e-3)
    if way != "port closed":
        await port.enable(AXIS)


@injecting
async def test_a_fault_ends_the_noise_and_the_drive_itself_restores_its_control(
    port: DrivePort, virtual: Virtual
) -> None:
    await port.enable(AXIS)
    virtual.order("fault", joint=AXIS, code=0x7305, at_sample=200)
    blocks: list[SampleBlock] = []
    with pytest.raises(DriveFault, match="7305h"):
        await consume(port, await noise(port, **LONG), blocks.append)
    assert len(excitation(blocks)) == len(column(blocks, "index")) >= 190
    assert virtual.energised() == []
    assert virtual.truth()["softened"] is False
    await port.acknowledge(AXIS)
    await port.enable(AXIS)


@injecting
async def test_the_torque_stays_within_the_limit_under_injection(port: DrivePort, virtual: Virtual) -> None:
    """Friction takes 130 of 160 N m: the drive cuts the peaks, and the host may find even that too much."""
    await port.enable(AXIS)
    blocks: list[SampleBlock] = []
    with suppress(EnvelopeLeft, DriveFault):
        await consume(port, await noise(port, periods=20, effort=40.0, effort_limit=160.0), blocks.append)
    effort, injected = column(blocks, "effort"), excitation(blocks)
    assert injected.max() > 80.0
    assert 150.0 < effort.max() < 160.0 + 20.0  # measurement noise of 4 ms: 3 N m RMS
    assert virtual.truth()["softened"] is False


@injecting
@pytest.mark.parametrize("limit", ["velocity", "position"])
async def test_the_envelope_holds_under_injection(port: DrivePort, virtual: Virtual, limit: str) -> None:
    await port.enable(AXIS)
    here = (await port.status())[AXIS].position
    changes: dict[str, dict[str, object]] = {
        "velocity": {"velocity_limit": 0.011, "effort": 140.0},
        "position": {"offset_velocity": 0.0, "effort": 140.0, "position_window": (here - 2e-5, here + 2e-5)},
    }
    command = await noise(port, periods=80, **cast("Any", changes[limit]))
    blocks: list[SampleBlock] = []
    with pytest.raises((EnvelopeLeft, DriveFault)):  # by the host or by the drive's own limit, whichever comes first
        await consume(port, command, blocks.append)
    assert virtual.energised() == []
    assert virtual.truth()["softened"] is False
    assert (await port.status())[AXIS].state is not AxisState.ENABLED
    for joint in port.joints:
        await port.acknowledge(joint)


async def _rest(running: Any) -> None:
    async for _ in running:
        pass
