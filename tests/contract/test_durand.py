"""Nodes of durand, a CANopen stack that shares nothing with ours or python-canopen, before a plant of their own."""

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
from service.identification import identify, spectrum
from tests.benchmarks.sweeps import POSE, move, robot, run, wide
from tests.contract.bench import AXIS, BENCHES, SYNC_PERIOD
from tests.durand_nodes.bench import DurandMachine, machine

WAYS = {"csv": "cyclic_velocity (60FFh)", "pv": "velocity_offset (60B1h)"}


@asynccontextmanager
async def connected(durand: DurandMachine) -> AsyncIterator[DrivePort]:
    async with closing(open_drive(durand.profile, Path())) as port:
        await port.connect()
        yield port


@pytest.mark.parametrize("modes", list(WAYS))
async def test_the_way_is_the_best_that_the_drive_has(modes: str) -> None:
    with machine(modes) as durand:
        async with connected(durand) as port:
            assert port.capabilities.set_points == WAYS[modes]


async def test_a_streamed_sweep_gives_the_inertia_of_the_plant() -> None:
    with machine() as durand:
        async with connected(durand) as port:
            await move(port, {AXIS: POSE[AXIS]})
            command = wide(robot(), AXIS, POSE[AXIS], SweepMode.HOST_STREAMED, 1 / SYNC_PERIOD)
            found = await run(port, robot(), [command], POSE)
    assert found.indices[AXIS].gapless
    (axis,) = identify(robot(), [spectrum(robot(), found.sweeps[AXIS])]).axes
    value, std, truth = axis.sweeps[0].value, float(np.sqrt(axis.covariance[0, 0])), durand.inertias[AXIS]
    print(f"J {value:.3f} +- {std:.3f}, the plant's {truth:.3f} kg m2, z {(value - truth) / std:+.1f}")
    assert std < 0.01 * truth
    assert abs(value - truth) <= 3 * std


async def test_a_velocity_offset_that_another_host_left_is_not_added() -> None:
    bench = BENCHES["durand-csv"]
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


def test_the_check_of_the_wiring_finds_nothing_wrong_with_the_eds_that_durand_writes() -> None:
    with machine() as durand:
        sheet = survey(parse_profile(durand.profile, Path()), "durand.yaml")
    assert sheet.mismatches == (), sheet.text()
    assert sheet.excitation == dict.fromkeys(durand.inertias, WAYS["csv"])
