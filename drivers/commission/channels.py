"""Unit, sign, delay and noise of each channel, from the samples of one small sweep with one sine. Pure.

Position, velocity and effort are each fitted by a straight line and three harmonics of the sine; the residual is
noise. The position is the reference, because encoder and gear are checked without energy; the velocity is compared
with its slope.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from drivers.ports import Array, ChannelTiming

UNIT = 0.05  # relative difference allowed between velocity and slope of the position
MAX_DELAY = 0.02  # s, maximum of the profile's `channels`
DELAY_TOLERANCE = 0.002  # s, allowed difference from the delay in the profile
_HARMONICS = 3


@dataclass(frozen=True, slots=True)
class ChannelFinding:
    """One sentence on one channel; `fits` is None if there is nothing to compare with."""

    check: str
    fits: bool | None
    what: str


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

    `offset` is the constant speed of the set-point, 1/s and not 0; `timing`: delays of the velocity in the profile.
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
        ChannelFinding("unit", abs(share - 1) <= UNIT, f"position: {share:.4f} of the speed commanded"),
        ChannelFinding(
            "unit",
            all(abs(each - 1) <= UNIT for each in shares),
            f"velocity: {shares[0]:.4f} of the position's in the mean, {shares[1]:.4f} at {frequency:g} Hz",
        ),
        ChannelFinding("delay", None, f"position: {1e3 * behind:.2f} ms behind the set-point, with speed control lag"),
        ChannelFinding(
            "delay",
            abs(late - stated) <= DELAY_TOLERANCE and abs(late) <= MAX_DELAY,
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
    phases = [angular * harmonic * time for harmonic in range(1, _HARMONICS + 1)]
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
