"""First motion of an axis, after a person has typed its name: half a degree and back, then one small sine."""

import math
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager

import numpy as np

from drivers.canopen.profile import CanopenAxis
from drivers.commission.channels import ChannelFinding, judge
from drivers.commission.sheet import Row, Verdict
from drivers.errors import NotReady
from drivers.ports import Array, AxisStatus, DrivePort, SampleBlock, Sine, SweepCommand, SweepMode

WAY = {"rad": math.radians(0.5), "m": 2e-3}
SPEED = {"rad": 0.015, "m": 3.5e-3}  # 1/s, constant speed, so that the axis does not reverse
AMPLITUDE = 0.6  # of the constant speed
FREQUENCY = 2.0  # Hz
PERIODS = 4  # of 1 s
ROOM = 1.5  # times the travel of the sine, on both sides
ASTRAY, MISSED = 0.1, 0.25  # share of the travel: motion of another joint; error of this one at its target
_COLUMNS = ("time", "position", "velocity", "effort", "velocity_setpoint")


def motion_text(axis: CanopenAxis) -> str:
    """Description of the motion for the person who confirms it."""
    return (
        f"{axis.joint} (node {axis.node}) gets energy, goes {WAY[axis.unit]:.3g} {axis.unit} and back, then "
        f"up to {_travel(axis):.3g} {axis.unit} forward in {_command(axis, 0.0, SweepMode.HOST_STREAMED).duration:g} s"
    )


async def moved(port: DrivePort, axis: CanopenAxis) -> list[Row]:
    """Connects, moves, disables, closes. After any error the axis is disabled, and the error is raised."""
    async with _closing(port):
        await port.connect()
        await port.enable(axis.joint)
        rows = [*await _there_and_back(port, axis)]
        if all(row.verdict is not Verdict.MISMATCH for row in rows):
            rows += [_row(axis, finding) for finding in await _sweep(port, axis)]
        await port.disable(axis.joint)
    return rows


async def _there_and_back(port: DrivePort, axis: CanopenAxis) -> list[Row]:
    before = await port.status()
    start, way = before[axis.joint].position, WAY[axis.unit]
    await port.move_to(axis.joint, start + way, way)  # 1 s
    after = await port.status()
    gone = after[axis.joint].position - start
    rows = [*_others(axis, before, after)]
    rows.append(
        _judged(axis, "move", abs(gone - way) <= MISSED * way, f"commanded {way:+.3g} {axis.unit}, moved {gone:+.3g}")
    )
    if rows[-1].verdict is not Verdict.MISMATCH:
        await port.move_to(axis.joint, start, way)
    return rows


def _others(axis: CanopenAxis, before: Mapping[str, AxisStatus], after: Mapping[str, AxisStatus]) -> list[Row]:
    limit = ASTRAY * WAY[axis.unit]
    gone = {joint: status.position - before[joint].position for joint, status in after.items() if joint != axis.joint}
    astray = [f"{joint} by {way:+.3g}" for joint, way in gone.items() if not abs(way) <= limit]
    return [_judged(axis, "others-stand", not astray, ", ".join(astray) or "no other joint moved")]


async def _sweep(port: DrivePort, axis: CanopenAxis) -> list[ChannelFinding]:
    """Raises NotReady if the drive has no way of excitation."""
    modes = port.capabilities.sweep_modes
    mode = next((mode for mode in (SweepMode.HOST_STREAMED, SweepMode.DRIVE_SIDE) if mode in modes), None)
    if mode is None:
        raise NotReady(f"{axis.joint}: no excitation mode, so its channels are not measured")
    command = _command(axis, (await port.status())[axis.joint].position, mode)
    blocks = [block async for block in port.run_sweep(command)]
    columns = _settled(blocks, command)
    return judge(columns, FREQUENCY, SPEED[axis.unit], axis.channels.timing, axis.unit, axis.effort_unit)


def _command(axis: CanopenAxis, start: float, mode: SweepMode) -> SweepCommand:
    speed, room = SPEED[axis.unit], ROOM * _travel(axis)
    low, high = axis.position_limits
    return SweepCommand(
        joint=axis.joint,
        mode=mode,
        offset_velocity=speed,
        sines=(Sine(FREQUENCY, AMPLITUDE * speed, 0.0),),
        period=1.0,
        periods=PERIODS,
        ramp=0.5,
        settle=0.5,
        sample_rate=250.0,
        velocity_limit=min(axis.velocity_limit, 4 * speed),
        effort_limit=axis.effort_limit,
        position_window=(max(low, start - room), min(high, start + room)),
    )


def _travel(axis: CanopenAxis) -> float:
    return SPEED[axis.unit] * (PERIODS + 1.5)


def _settled(blocks: Sequence[SampleBlock], command: SweepCommand) -> dict[str, Array]:
    whole = {name: np.concatenate([getattr(block, name) for block in blocks]) for name in _COLUMNS}
    time = whole["time"]
    inside = (time >= command.measure_from) & (time < command.measure_from + command.periods * command.period)
    return {name: values[inside] for name, values in whole.items()}


def _row(axis: CanopenAxis, finding: ChannelFinding) -> Row:
    verdict = {None: Verdict.NOTE, True: Verdict.FITS, False: Verdict.MISMATCH}[finding.fits]
    return Row(axis.joint, finding.check, verdict, finding.what)


def _judged(axis: CanopenAxis, check: str, fits: bool, what: str) -> Row:
    return _row(axis, ChannelFinding(check, fits, what))


@asynccontextmanager
async def _closing(port: DrivePort) -> AsyncGenerator[None]:
    """Closing de-energises every axis, whatever happened before."""
    try:
        yield
    finally:
        await port.close()
