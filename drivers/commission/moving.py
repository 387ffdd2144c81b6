"""First motion of an axis, after a person has typed its name: half a degree and back, then one small sine, from whose
samples unit, sign, delay and noise of each channel are judged.
"""

import math
from collections.abc import AsyncGenerator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass

import numpy as np

from drivers.canopen.profile import CanopenAxis
from drivers.commission.drive import CheckRow, CheckVerdict
from drivers.errors import NotReady
from drivers.ports import Array, AxisStatus, ChannelTiming, DrivePort, SampleBlock, SineCommand, SweepCommand, SweepMode


@dataclass(frozen=True, slots=True)
class ChannelFinding:
    """One sentence on one channel; `fits` is None if there is nothing to compare with."""

    check: str
    fits: bool | None
    what: str


WAY = {"rad": math.radians(0.5), "m": 2e-3}
SPEED = {"rad": 0.015, "m": 3.5e-3}  # 1/s, constant speed, so that the axis does not reverse
FREQUENCY = 2.0  # Hz
PERIODS = 4  # of 1 s


def motion_text(axis: CanopenAxis) -> str:
    """Description of the motion for the person who confirms it."""
    return (
        f"{axis.joint} (node {axis.node}) gets energy, goes {WAY[axis.unit]:.3g} {axis.unit} and back, then "
        f"up to {_travel(axis):.3g} {axis.unit} forward in {_command(axis, 0.0, SweepMode.HOST_STREAMED).duration:g} s"
    )


async def moved(port: DrivePort, axis: CanopenAxis) -> list[CheckRow]:
    """Connects, moves, disables, closes. After any error the axis is disabled, and the error is raised."""
    async with _closing(port):
        await port.connect()
        await port.enable(axis.joint)
        rows = [*await _there_and_back(port, axis)]
        if all(row.verdict is not CheckVerdict.MISMATCH for row in rows):
            rows += [_row(axis, finding) for finding in await _sweep(port, axis)]
        await port.disable(axis.joint)
    return rows


async def _there_and_back(port: DrivePort, axis: CanopenAxis) -> list[CheckRow]:
    before = await port.status()
    start, way = before[axis.joint].position, WAY[axis.unit]
    await port.move_to(axis.joint, start + way, way)  # 1 s
    after = await port.status()
    gone = after[axis.joint].position - start
    rows = [*_others(axis, before, after)]
    rows.append(
        _judged(axis, "move", abs(gone - way) <= 0.25 * way, f"commanded {way:+.3g} {axis.unit}, moved {gone:+.3g}")
    )
    if rows[-1].verdict is not CheckVerdict.MISMATCH:
        await port.move_to(axis.joint, start, way)
    return rows


def _others(axis: CanopenAxis, before: Mapping[str, AxisStatus], after: Mapping[str, AxisStatus]) -> list[CheckRow]:
    limit = 0.1 * WAY[axis.unit]
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
    speed, room = SPEED[axis.unit], 1.5 * _travel(axis)
    low, high = axis.position_limits
    return SweepCommand(
        joint=axis.joint,
        mode=mode,
        offset_velocity=speed,
        sines=(SineCommand(FREQUENCY, 0.6 * speed, 0.0),),
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
    names = ("time", "position", "velocity", "effort", "velocity_setpoint")
    whole = {name: np.concatenate([getattr(block, name) for block in blocks]) for name in names}
    time = whole["time"]
    inside = (time >= command.measure_from) & (time < command.measure_from + command.periods * command.period)
    return {name: values[inside] for name, values in whole.items()}


def _row(axis: CanopenAxis, finding: ChannelFinding) -> CheckRow:
    verdict = {None: CheckVerdict.NOTE, True: CheckVerdict.FITS, False: CheckVerdict.MISMATCH}[finding.fits]
    return CheckRow(axis.joint, finding.check, verdict, finding.what)


def _judged(axis: CanopenAxis, check: str, fits: bool, what: str) -> CheckRow:
    return _row(axis, ChannelFinding(check, fits, what))


@asynccontextmanager
async def _closing(port: DrivePort) -> AsyncGenerator[None]:
    """Closing de-energises every axis, whatever happened before."""
    try:
        yield
    finally:
        await port.close()


@dataclass(frozen=True, slots=True)
class _Fit:
    mean: float  # at the middle of the window
    slope: float
    line: complex  # amplitude of exp(i w t)
    noise: float  # RMS


def judge(
    columns: Mapping[str, Array], frequency: float, offset: float, timing: ChannelTiming, unit: str, effort_unit: str
) -> list[ChannelFinding]:
    """`columns`: time, position, velocity, effort, velocity_setpoint of the settled part, whole periods, (n,) each.

    Position, velocity and effort are each fitted by a straight line and three harmonics of the sine; the residual is
    noise. The position is the reference, because encoder and gear are checked without energy. Velocity and slope of the
    position may differ by 5 %, the delay from the profile's by 2 ms, and be 20 ms at most. `offset` is the constant
    speed of the set-point, 1/s and not 0; `timing`: delays of the velocity in the profile.
    """
    time, angular = columns["time"], 2 * np.pi * frequency
    position, velocity, effort, wanted = (
        _fit(time, columns[name], angular) for name in ("position", "velocity", "effort", "velocity_setpoint")
    )
    speed = 1j * angular * position.line  # of the sine
    acceleration = 1j * angular * speed
    inertia = float((effort.line / acceleration).real)
    shares = velocity.mean / position.slope, abs(velocity.line / speed)
    late = _delay(speed, velocity.line, angular)
    stated = timing.velocity_delay + timing.velocity_smoothing
    behind = _delay(wanted.line, speed, angular)
    went, share = f"{position.slope:+.4g} {unit}/s", position.slope / offset
    return [
        ChannelFinding("sign", share > 0, f"position: {went} at {offset:+.4g} commanded"),
        ChannelFinding("sign", shares[0] > 0, f"velocity: {velocity.mean:+.4g} {unit}/s; from position: {went}"),
        ChannelFinding("sign", inertia > 0, f"effort: {inertia:.4g} {effort_unit} for 1 {unit}/s^2; must be above 0"),
        ChannelFinding("unit", abs(share - 1) <= 0.05, f"position: {share:.4f} of the speed commanded"),
        ChannelFinding(
            "unit",
            all(abs(each - 1) <= 0.05 for each in shares),
            f"velocity: {shares[0]:.4f} of the position's in the mean, {shares[1]:.4f} at {frequency:g} Hz",
        ),
        ChannelFinding("delay", None, f"position: {1e3 * behind:.2f} ms behind the set-point, with speed control lag"),
        ChannelFinding(
            "delay",
            abs(late - stated) <= 0.002 and abs(late) <= 0.02,
            f"velocity: {1e3 * late:.2f} ms behind the position, the profile's channels say {1e3 * stated:.2f} ms",
        ),
        *(
            ChannelFinding("noise", None, f"{name}: {fit.noise:.3g} {of} RMS")
            for name, fit, of in (
                ("position", position, unit),
                ("velocity", velocity, f"{unit}/s"),
                ("effort", effort, effort_unit),
            )
        ),
    ]  # fmt: skip


def _fit(time: Array, values: Array, angular: float) -> _Fit:
    middle = float(np.mean(time))
    phases = [angular * harmonic * time for harmonic in range(1, 4)]
    basis = np.stack(
        [np.ones_like(time), time - middle, *(wave(phase) for phase in phases for wave in (np.cos, np.sin))], axis=1
    )
    found = np.linalg.lstsq(basis, values, rcond=None)[0]
    rest = values - basis @ found
    noise = float(np.sqrt(rest @ rest / max(1, len(values) - basis.shape[1])))
    return _Fit(float(found[0]), float(found[1]), complex(found[2], -found[3]), noise)


def _delay(first: complex, second: complex, angular: float) -> float:
    """Delay of `second` after `first`, s; within half a period in either direction."""
    return float(np.angle(first / second)) / angular
