"""Limits on the joint side: checks of a command and its set-point before any motion, and of a moving axis."""

import math
from dataclasses import dataclass

import numpy as np

from drivers.cia402.profile import AxisProfile
from drivers.errors import LimitExceeded, Measured, distinct
from drivers.ports import Array, ExcitationCommand, NoiseCommand, SweepCommand, SweepMode


@dataclass(frozen=True, slots=True)
class DriveEnvelope:
    """Limits of a moving axis; rad, rad/s, N m (m, m/s, N)."""

    velocity_limit: float
    effort_limit: float
    window: tuple[float, float]
    unit: str
    effort_unit: str

    def violation(self, position: float, velocity: float, effort: float) -> tuple[str, Measured] | None:
        """The limit that this reading exceeds; None if there is none."""
        low, high = self.window
        if not low <= position <= high:
            here, lowest, highest = distinct(position, low, high)
            text = f"position {here} {self.unit} is outside {lowest} to {highest} {self.unit}"
            return text, Measured(position, low if position < low else high, self.unit)
        if not abs(velocity) <= self.velocity_limit:
            speed, limit = _beyond(velocity, self.velocity_limit)
            text = f"velocity {speed} {self.unit}/s is beyond {limit} {self.unit}/s"
            return text, Measured(velocity, math.copysign(self.velocity_limit, velocity), f"{self.unit}/s")
        if not abs(effort) <= self.effort_limit:
            strength, limit = _beyond(effort, self.effort_limit)
            text = f"effort {strength} {self.effort_unit} is beyond {limit} {self.effort_unit}"
            return text, Measured(effort, math.copysign(self.effort_limit, effort), self.effort_unit)
        return None


def _beyond(value: float, limit: float) -> tuple[str, str]:
    size, most = distinct(abs(value), limit, digits=4)
    return f"-{size}" if value < 0 else size, most


def move_envelope(axis: AxisProfile) -> DriveEnvelope:
    """Envelope of positioning moves: the limits of the profile, with 10 % for the overshoot of the speed controller."""
    return DriveEnvelope(
        1.1 * axis.velocity_limit, axis.effort_limit, axis.position_limits, axis.unit, axis.effort_unit
    )


def sweep_envelope(axis: AxisProfile, command: SweepCommand | NoiseCommand) -> DriveEnvelope:
    """Envelope of a sweep or noise run: the limits of the command."""
    return DriveEnvelope(
        command.velocity_limit, command.effort_limit, command.position_window, axis.unit, axis.effort_unit
    )


def check_move(axis: AxisProfile, position: float, velocity: float) -> None:
    """Raises LimitExceeded if a positioning move is outside the limits of the profile."""
    low, high = axis.position_limits
    if not low <= position <= high:
        target, lowest, highest = distinct(position, low, high)
        raise LimitExceeded(
            axis.joint, f"target position {target} {axis.unit} is outside {lowest} to {highest} {axis.unit}"
        )
    _at_most(axis, "velocity", velocity, axis.velocity_limit, f"{axis.unit}/s")


def check_sweep(axis: AxisProfile, command: SweepCommand, start: float, sync_period: float) -> None:
    """Raises LimitExceeded if a sweep from `start`, rad (m), would exceed its own limits or those of the profile."""
    _at_most(axis, "velocity limit", command.velocity_limit, axis.velocity_limit, f"{axis.unit}/s")
    _at_most(axis, "effort limit", command.effort_limit, axis.effort_limit, axis.effort_unit)
    for what, value in (("ramp", command.ramp), ("period", command.period), ("sample rate", command.sample_rate)):
        if not (math.isfinite(value) and value > 0):
            raise LimitExceeded(axis.joint, f"{what} {value} must be above 0")
    if not (math.isfinite(command.settle) and command.settle >= 0 and command.periods >= 1):
        raise LimitExceeded(
            axis.joint, f"settle {command.settle} s must be 0 or more, periods {command.periods} must be 1 or more"
        )
    peak = abs(command.offset_velocity) + sum(abs(sine.amplitude) for sine in command.sines)
    if not peak <= command.velocity_limit:
        raise LimitExceeded(
            axis.joint,
            f"peak velocity {peak:.4g} {axis.unit}/s is beyond the limit of {command.velocity_limit:.4g} {axis.unit}/s",
        )
    if command.mode is SweepMode.DRIVE_SIDE and len(command.sines) > 16:
        raise LimitExceeded(axis.joint, f"{len(command.sines)} sines are more than the drive's 16")
    rate = 1 / sync_period if command.mode is SweepMode.HOST_STREAMED else command.sample_rate
    highest = max((sine.frequency for sine in command.sines), default=0.0)
    if not highest < rate / 2:
        found, _ = distinct(highest, rate / 2, digits=4)
        raise LimitExceeded(axis.joint, f"{found} Hz is not below half the sample rate of {rate:.4g} Hz")
    low, high = command.position_window
    down, up = travel(command)
    for what, value in (("start", start), ("lowest position", start + down), ("highest position", start + up)):
        if not (low <= value <= high):
            place, lowest, highest = distinct(value, low, high)
            raise LimitExceeded(
                axis.joint,
                f"{what} {place} {axis.unit} of the sweep is outside its window {lowest} to {highest} {axis.unit}",
            )
    least, most = axis.position_limits
    if low < least or high > most:
        (from_, lowest), (to, highest) = distinct(low, least), distinct(high, most)
        raise LimitExceeded(
            axis.joint, f"window {from_} to {to} {axis.unit} is outside {lowest} to {highest} {axis.unit}"
        )


def check_noise(axis: AxisProfile, command: NoiseCommand, start: float) -> None:
    """Raises LimitExceeded if the motion under the noise is outside the limits, or if the noise parameters are invalid.

    The additional motion caused by the noise depends on the plant; the envelope monitors it.
    """
    common = {name: getattr(command, name) for name in ExcitationCommand.__dataclass_fields__}
    turn = SweepCommand(mode=SweepMode.DRIVE_SIDE, sines=(), **common)
    check_sweep(axis, turn, start, math.inf)
    _at_most(axis, "RMS of the injected effort", command.effort, command.effort_limit, axis.effort_unit)
    _at_most(axis, "softening", command.softening, 1.0, "of the speed control")
    if not 0 <= command.lowest <= command.highest < command.sample_rate / 2:
        raise LimitExceeded(
            axis.joint,
            f"band {command.lowest:.4g} to {command.highest:.4g} Hz must rise and end below half the "
            f"sample rate of {command.sample_rate:.4g} Hz",
        )
    if not 0 <= command.seed < 1 << 32:
        raise LimitExceeded(axis.joint, f"seed {command.seed} does not fit 32 bits")


def _at_most(axis: AxisProfile, what: str, value: float, limit: float, unit: str) -> None:
    if not 0 < value <= limit:
        shown, most = distinct(value, limit, digits=4)
        raise LimitExceeded(axis.joint, f"{what} {shown} {unit} must be above 0 and at most {most} {unit}")


def set_point(command: SweepCommand, time: Array) -> Array:
    """``e(t) (offset + sum a sin(2 pi f (t - t0) + phi))`` in rad/s (m/s) at `time` (n,), s from the sweep's start."""
    value = np.full_like(time, command.offset_velocity)
    for sine in command.sines:
        value += sine.amplitude * np.sin(2 * np.pi * sine.frequency * (time - command.measure_from) + sine.phase)
    return envelope(command, time) * value


def envelope(command: SweepCommand, time: Array) -> Array:
    """e(t): raised cosine over `ramp`, one, raised cosine down; zero before and after. (n,)"""
    since_end = np.minimum(time, command.duration - time)
    return 0.5 - 0.5 * np.cos(np.pi * np.clip(since_end / command.ramp, 0.0, 1.0))


def travel(command: SweepCommand, step: float = 1e-3) -> tuple[float, float]:
    """Lowest and highest position of the set-point relative to the start, rad (m), by the trapezoidal rule."""
    count = max(2, round(command.duration / step) + 1)
    time = np.linspace(0.0, command.duration, count)
    velocity = set_point(command, time)
    path = np.concatenate([[0.0], np.cumsum((velocity[1:] + velocity[:-1]) / 2 * np.diff(time))])
    return float(path.min()), float(path.max())
