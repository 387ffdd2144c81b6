"""Nodes of two CANopen stacks, durand and node-canopen, that share nothing with ours or python-canopen, with plants of
their own."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import numpy as np
import pytest

from drivers.canopen.profile import parse_profile
from drivers.commission.survey import survey
from drivers.contract.bench import closing, column
from drivers.ports import AxisState, DrivePort, SweepMode
from drivers.registry import open_drive
from service.identification.estimates.estimate import identify
from service.identification.spectra.frequency_response import spectrum
from tests.contract.bench import AXIS, BENCHES, SYNC_PERIOD
from tests.contract.sweeps import POSE, move, robot, run, wide
from tests.independent_bench import STACKS, IndependentMachine, machine

WAYS = {
    ("durand", "csv"): "cyclic_velocity (60FFh)",
    ("durand", "pv"): "velocity_offset (60B1h)",
    ("node-canopen", "csv"): "cyclic_velocity (60FFh)",
    ("node-canopen", "csp"): "cyclic_position (607Ah)",
}
PERIODS = {"csv": SYNC_PERIOD, "csp": 0.004}  # s; positions bias J at 8 ms


@asynccontextmanager
async def connected(independent: IndependentMachine) -> AsyncIterator[DrivePort]:
    async with closing(open_drive(independent.profile, Path())) as port:
        await port.connect()
        yield port


@pytest.mark.parametrize(("stack", "modes"), list(WAYS))
async def test_the_way_is_the_best_that_the_drive_has(stack: str, modes: str) -> None:
    with machine(stack, modes) as independent:
        async with connected(independent) as port:
            assert port.capabilities.set_points == WAYS[stack, modes]


@pytest.mark.parametrize(("stack", "modes"), [each for each in WAYS if each[1] in PERIODS])
async def test_a_streamed_sweep_gives_the_inertia_of_the_plant(stack: str, modes: str) -> None:
    """The median of three: the first, of a drive that never moved, was 3.2 std off in 3 of 8 runs, others below 1."""
    period, axes = PERIODS[modes], []
    with machine(stack, modes, sync_period=period) as independent:
        async with connected(independent) as port:
            for _ in range(3):
                await move(port, {AXIS: POSE[AXIS]})
                command = wide(robot(), AXIS, POSE[AXIS], SweepMode.HOST_STREAMED, 1 / period)
                found = await run(port, robot(), [command], POSE)
                assert found.gapless
                axes += identify(robot(), [spectrum(robot(), found.sweeps[AXIS])]).axes
    axis = sorted(axes, key=lambda each: each.sweeps[0].value)[1]
    value, std, truth = axis.sweeps[0].value, float(np.sqrt(axis.covariance[0, 0])), independent.inertias[AXIS]
    print(f"{stack} {modes}: J {value:.3f} +- {std:.3f}, the plant's {truth:.3f} kg m2, z {(value - truth) / std:+.1f}")
    assert std < 0.01 * truth
    assert abs(value - truth) <= 3 * std


async def test_a_velocity_offset_that_another_host_left_is_not_added() -> None:
    bench = BENCHES["durand-socketcand"]
    with bench.machine(bench) as virtual:
        async with closing(virtual.open()) as port:
            await port.connect()
            virtual.order("velocity_offset", joint=AXIS, raw=20_000)  # 0.02 rad/s
            await port.enable(AXIS)
            blocks = [block async for block in port.run_sweep(await bench.sweep(port, SweepMode.HOST_STREAMED))]
            assert (await port.status())[AXIS].state is AxisState.ENABLED
    velocity = column(blocks, "velocity")
    assert abs(velocity[0]) < 1e-3
    assert np.mean(velocity[50:175]) == pytest.approx(0.0105, rel=0.05)


async def test_a_sync_counter_that_another_host_left_on_is_switched_off() -> None:
    """The drive refuses SYNC without a counter byte while 1019h is not 0: error 8240h."""
    bench = BENCHES["node-socketcand"]
    with bench.machine(bench) as virtual:
        virtual.order("sync_counter", joint=AXIS, raw=240)
        async with closing(virtual.open()) as port:
            await port.connect()
            await port.enable(AXIS)
            blocks = [block async for block in port.run_sweep(await bench.sweep(port, SweepMode.HOST_STREAMED))]
    index = column(blocks, "index")
    assert index.tolist() == list(range(len(index)))
    assert len(index) > 100


@pytest.mark.parametrize("stack", list(STACKS))
def test_the_check_of_the_wiring_finds_nothing_wrong_with_the_eds_that_the_stack_writes(stack: str) -> None:
    with machine(stack) as independent:
        sheet = survey(parse_profile(independent.profile, Path()), f"{stack}.yaml")
    assert sheet.mismatches == (), sheet.text()
    assert sheet.excitation == dict.fromkeys(independent.inertias, WAYS[stack, "csv"])
