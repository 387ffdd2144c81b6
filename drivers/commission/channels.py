"""Unit, sign, delay and noise of each channel from the samples of one small sweep with one sine. Pure.

Position, velocity and effort are each fitted by a straight line and three harmonics of the sine; what is left is noise.
The position is the measure, for encoder and gear are checked without energy; the velocity is compared with its slope.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from drivers.ports import Array, ChannelTiming

UNIT = 0.05  # of a velocity that the position does not tell
MOST_DELAY = 0.02  # s, as the profile's `channels` allow
UNTOLD_DELAY = 0.002  # s beside the profile's before it counts
_HARMONICS = 3


@dataclass(frozen=True, slots=True)
class Told:
    """One sentence on one channel; `fits` is None where there is nothing to compare it with."""

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
) -> list[Told]:
    """`columns`: time, position, velocity, effort, velocity_setpoint of the settled part, whole periods, (n,) each.

    `offset` is the set-point's steady speed, 1/s and not 0; `timing` what the profile already says of the velocity.
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
    told = timing.velocity_delay + timing.velocity_smoothing
    behind = _delay(wanted.line, speed, angular)
    went, share = f"{position.slope:+.4g} {unit}/s", position.slope / offset
    return [
        Told("sign", share > 0, f"position: {went} at {offset:+.4g} commanded"),
        Told("sign", shares[0] > 0, f"velocity: {velocity.mean:+.4g} {unit}/s where the position says {went}"),
        Told("sign", inertia > 0, f"effort: {inertia:.4g} {effort_unit} for 1 {unit}/s^2; it must be above 0"),
        Told("unit", abs(share - 1) <= UNIT, f"position: {share:.4f} of the speed commanded"),
        Told(
            "unit",
            all(abs(each - 1) <= UNIT for each in shares),
            f"velocity: {shares[0]:.4f} of the position's in the mean, {shares[1]:.4f} at {frequency:g} Hz",
        ),
        Told("delay", None, f"position: {1e3 * behind:.2f} ms behind the set-point, the speed control's lag with it"),
        Told(
            "delay",
            abs(late - told) <= UNTOLD_DELAY and abs(late) <= MOST_DELAY,
            f"velocity: {1e3 * late:.2f} ms behind the position, the profile's channels say {1e3 * told:.2f} ms",
        ),
        *(
            Told("noise", None, f"{name}: {fit.noise:.3g} {of} RMS")
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
    """s by which the second comes after the first; within half a period either way."""
    return float(np.angle(first / second)) / angular
