"""Drives of other makers swept and stopped: J against that of the virtual drive's own sweep, same plant, same poses.

The makers' dictionaries are read from ../shared; without that folder their tests are skipped.
"""

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from drivers.contract.bench import closing, column, consume
from drivers.errors import LimitExceeded, SweepInterrupted
from drivers.ports import AxisState, DrivePort, SampleBlock, SweepCommand, SweepMode
from drivers.registry import open_drive
from service.model import Robot
from tests.contract.bench import AXIS, BENCHES, DRIVES, SYNC_PERIOD, in_one_process
from tests.contract.makers import profile
from tests.contract.sweeps import LINES, POSE, Run, command, compare, move, robot, run, wide
from tests.foreign_bench import bench

STEP = float(np.radians(1e-3))  # rad, of a Powerball's position
WAYS = {
    "plain": "cyclic_velocity (60FFh)",
    "epos4": "cyclic_velocity (60FFh)",
    "gold": "cyclic_velocity (60FFh)",
    "simpliq": "interpolated_position (60C1h)",
    "powerball": "interpolated_position (60C1h)",
}


async def swept(port: DrivePort, robot: Robot, mode: SweepMode, rate: float) -> list[Run]:
    """One sweep of each axis."""
    runs: list[Run] = []
    for joint in LINES:
        await move(port, POSE)
        runs.append(await run(port, robot, [wide(robot, joint, POSE[joint], mode, rate)], POSE))
    return runs


@pytest.fixture(scope="module")
def own() -> Sequence[Run]:
    """The virtual drive's own sweeps, two of each axis."""

    async def measure() -> list[Run]:
        with in_one_process(BENCHES["canopen-virtual"]) as virtual:
            async with closing(virtual.open()) as port:
                await port.connect()
                return [each for _ in range(2) for each in await swept(port, robot(), SweepMode.DRIVE_SIDE, 250.0)]

    return asyncio.run(measure())


@pytest.mark.parametrize("dictionary", ["plain", "epos4", "gold", "powerball"])
async def test_a_streamed_sweep_gives_the_inertia_of_the_virtual_drives_own(
    dictionary: str, own: Sequence[Run]
) -> None:
    period = 0.008 if "velocity" in WAYS[dictionary] else 0.004  # s; positions make stairs, which bias J at 8 ms
    with bench(dictionary) as foreign:
        content = profile(dictionary, foreign, DRIVES, patient=True, sync_period=period)
        async with closing(open_drive(content, DRIVES)) as port:
            await port.connect()
            assert port.capabilities.set_points == WAYS[dictionary]
            assert port.capabilities.sweep_modes == {SweepMode.HOST_STREAMED}
            streamed = await swept(port, robot(), SweepMode.HOST_STREAMED, 1 / period)
    for joint in LINES:
        assert all(each.gapless for each in streamed)
        found = compare(robot(), [*own, *streamed], joint)
        bias = found.streamed / found.drive_side - 1
        print(
            f"{dictionary} {joint}: {100 * bias:+.3f} %, std of the difference "
            f"{100 * found.difference_std / found.drive_side:.3f} %, of one streamed sweep "
            f"{100 * found.std / found.drive_side:.3f} %, z {found.z:+.1f}"
        )
        assert abs(bias) <= 2 * found.std / found.drive_side  # within the interval that one sweep states
        assert abs(bias) <= 3e-3 + 2 * found.difference_std / found.drive_side  # no more bias than 0.3 % and noise


def small(robot: Robot, joint: str, steps: float) -> SweepCommand:
    """A streamed sweep as a usual plan has it, each line of so many steps of a Powerball's position."""
    usual = command(robot, joint, POSE[joint], True, SweepMode.HOST_STREAMED, 250.0)
    lines = [replace(sine, amplitude=2 * np.pi * sine.frequency * steps * STEP) for sine in usual.sines]
    return replace(usual, sines=tuple(lines))


async def test_lines_of_five_steps_of_position_still_give_the_inertia(own: Sequence[Run]) -> None:
    """What rounding adds is motion; a line of fewer steps is refused before anything moves."""
    with bench("powerball") as foreign:
        content = profile("powerball", foreign, DRIVES, patient=True, sync_period=0.004)
        async with closing(open_drive(content, DRIVES)) as port:
            await port.connect()
            await move(port, POSE)
            told = (
                r"a sine of 8\.55e-05 rad at 3 Hz has fewer than 5 steps of the drive's position unit of 1\.75e-05 rad"
            )
            with pytest.raises(LimitExceeded, match=told):
                await run(port, robot(), [small(robot(), "joint_3", 4.9)], POSE)
            assert foreign.truth("joint_3")["position"] == pytest.approx(POSE["joint_3"], abs=1e-4)
            streamed: list[Run] = []
            for joint in ("joint_1", "joint_3"):
                await move(port, POSE)
                streamed.append(await run(port, robot(), [small(robot(), joint, 5.001)], POSE))
    for joint in ("joint_1", "joint_3"):
        found = compare(robot(), [*own, *streamed], joint)
        bias, std = found.streamed / found.drive_side - 1, found.std / found.drive_side
        print(f"{joint}, lines of 5 steps: {100 * bias:+.3f} %, std of the sweep {100 * std:.3f} %, z {found.z:+.1f}")
        assert abs(bias) <= 4 * std  # what it states holds; one sweep in 10,000 lies further out
        assert std < 0.03  # which is one


@pytest.mark.parametrize("by", ["stop", "halt"])
@pytest.mark.parametrize("dictionary", ["plain", "epos4", "simpliq", "powerball"])
async def test_a_stop_in_a_sweep_ends_where_the_axis_is(dictionary: str, by: str) -> None:
    """Also where positions are streamed, far from position 0."""
    with bench(dictionary) as foreign:
        async with closing(open_drive(profile(dictionary, foreign, DRIVES), DRIVES)) as port:
            await port.connect()
            await port.enable(AXIS)
            await port.move_to(AXIS, 0.8, 0.5)
            running = port.run_sweep(
                replace(wide(robot(), AXIS, POSE[AXIS], SweepMode.HOST_STREAMED, 125.0), position_window=(0.5, 1.2))
            )
            for _ in range(8):
                await anext(running)
            before = foreign.truth(AXIS)["position"]
            if by == "halt":
                port.halt()
            else:
                await port.stop()
            with pytest.raises(SweepInterrupted):
                async for _ in running:
                    pass
            after = foreign.truth(AXIS)
            assert not after["energised"]
            assert abs(after["position"] - before) < 0.05


async def test_cyclic_position_where_the_map_prefers_it(tmp_path: Path) -> None:
    content = yaml.safe_load((DRIVES / "../devices/maxon-epos4.yaml").read_text()) | {"excitation": ["cyclic_position"]}
    (tmp_path / "map.yaml").write_text(yaml.safe_dump(content))
    with bench("epos4") as foreign:
        own = profile("epos4", foreign, DRIVES) | {"device": str(tmp_path / "map.yaml")}
        async with closing(open_drive(own, DRIVES)) as port:
            await port.connect()
            assert port.capabilities.set_points == "cyclic_position (607Ah)"
            await port.enable(AXIS)
            blocks: list[SampleBlock] = []
            command = replace(wide(robot(), AXIS, POSE[AXIS], SweepMode.HOST_STREAMED, 125.0), periods=1)
            await consume(port, command, blocks.append)
            assert column(blocks, "index").tolist() == list(range(round(command.duration / SYNC_PERIOD) + 1))
            travelled = column(blocks, "position")[-1] - column(blocks, "position")[0]
            assert travelled == pytest.approx(column(blocks, "velocity_setpoint").sum() * SYNC_PERIOD, rel=1e-2)
            assert (await port.status())[AXIS].state is AxisState.ENABLED
