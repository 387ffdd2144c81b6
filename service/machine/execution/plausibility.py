"""Checks that the channels of a recording are consistent. Pure; applied to every sweep before it counts as recorded.

The samples of a drive can be wrong without any error: a channel that does not change, a wrong sign or unit of a
parameter, an encoder that loses steps. Each is detected by comparing the channels over the measured window:

    position    is the integral of velocity, with no step larger than that by velocity
    load        follows the motor
    effort      accelerates the axis: Im(E/V) > 0 at the lowest line, or takes energy about standstill; not checked
                along a trajectory, where gravity and the other axes dominate
    all         change while the axis moves; about standstill friction may hold it

Applied to the samples as reported by the drive: a delay of milliseconds does not affect the checks.
"""

from dataclasses import dataclass

import numpy as np

from drivers.errors import CauseCode
from service.model.arrays import Array
from service.model.errors import MotionFailed
from service.model.recording import Recording, SweepSpec


@dataclass(frozen=True)
class Tolerances:
    """What good channels may differ by."""

    frozen: float = 0.2
    """s: no channel repeats one value for longer while the axis moves; more for a slow line, see below."""
    velocity_gain: float = 0.01
    """Encoder and speed come from one sensor: a wrong unit or gear causes far more, noise less."""
    load_gain: float = 0.05
    """Effect of gear error and twist on a few degrees of travel."""
    glitch: float = 12.0
    """Robust standard deviations: never reached by noise in 1e5 samples, nor by the tails of dry friction."""
    harmless: float = 0.5
    """Of the commanded peak velocity, or of its travel in a sample: smaller steps do not affect the result."""
    stuck: float = 0.05
    """Of the travel of the sines: an axis that moves less is held by its friction."""
    steps: float = 3.0
    """Steps of a channel's resolution allowed for rounding."""
    significant: float = 3.0
    """Times the neighbouring bins: above, an apparent inertia below zero is not noise."""


_ALLOWED = Tolerances()


class ImplausibleChannels(MotionFailed, code=CauseCode.IMPLAUSIBLE_CHANNELS):
    """The samples contradict each other: encoder, unit, sign, or a channel that does not change. Not identified."""


def check_channels(spec: SweepSpec, recording: Recording) -> None:
    """Raises ImplausibleChannels with axis, quantity, value and limit. Sweeps at standstill are not checked."""
    if not (spec.offset_velocity or spec.sines):
        return
    part = _window(spec, recording.time)
    time, effort = recording.time[part], recording.effort[part]
    velocity, position = recording.velocity[part], recording.position[part]
    load = None if recording.load_position is None else recording.load_position[part]
    if not spec.offset_velocity and _sticks(spec, time, velocity, position):
        return
    _check_frozen(spec, {"effort": effort, "velocity": velocity, "position": position})
    _check_velocity(spec, time, velocity, position)
    if load is not None:
        _check_load(spec, time, position, load)
    if spec.sines and spec.excitation != "trajectory":
        _check_effort(spec, time, effort, velocity)


def _window(spec: SweepSpec, time: Array) -> slice:
    first = int(np.searchsorted(time, spec.measure_from - 0.5 / spec.sample_rate))
    if spec.period is None or spec.periods is None:
        return slice(first, None)
    return slice(first, first + round(spec.period * spec.periods * spec.sample_rate))


def _peak(spec: SweepSpec) -> float:
    """Highest commanded speed, rad/s (m/s)."""
    return abs(spec.offset_velocity) + sum(sine.amplitude for sine in spec.sines)


def _sticks(spec: SweepSpec, time: Array, velocity: Array, position: Array) -> bool:
    """About standstill dry friction may hold an axis all the time: encoder and speed then show no travel."""
    wanted = float(np.linalg.norm([sine.amplitude / (2 * np.pi * sine.frequency) for sine in spec.sines])) / np.sqrt(2)
    ways = (_without_trend(time, position), _without_trend(time, np.cumsum(velocity) / spec.sample_rate))
    return all(float(np.std(way)) < _ALLOWED.stuck * wanted for way in ways)


def _check_frozen(spec: SweepSpec, channels: dict[str, Array]) -> None:
    # around the crest of a slow line a coarse channel may be constant for half a period
    limit = max([_ALLOWED.frozen, *(0.5 / sine.frequency for sine in spec.sines)])
    for name, values in channels.items():
        edges = np.flatnonzero(np.diff(values))
        runs = np.diff(np.concatenate([[-1], edges, [len(values) - 1]])) - 1
        longest = float(runs.max()) / spec.sample_rate
        if longest > limit:
            raise ImplausibleChannels(
                spec.axis, f"{name} stands still for {longest:.3g} s while the axis moves, limit {limit:.3g} s"
            )


def _check_velocity(spec: SweepSpec, time: Array, velocity: Array, position: Array) -> None:
    """Steps of position and velocity, and the slope of position over the integral of velocity."""
    step = np.diff(time)
    explained = step * (velocity[1:] + velocity[:-1]) / 2
    # at a reversal, backlash lets the axis move from one flank to the other
    harmless = (_ALLOWED.harmless if spec.offset_velocity else 1.0) * _peak(spec)
    _check_steps(spec, "position", np.diff(position) - explained, harmless / spec.sample_rate, _resolution(position))
    _check_steps(spec, "velocity", np.diff(velocity), harmless, _resolution(velocity))
    travelled = np.concatenate([[0.0], np.cumsum(explained)])
    # without an offset a constant error of velocity would dominate: both are then used without their trend
    slope = _slope(time, travelled, position, trend=spec.offset_velocity == 0)
    # a drive that truncates to whole units has a mean error of half a unit
    rounding = _resolution(velocity) / 2 / abs(spec.offset_velocity) if spec.offset_velocity else 0.0
    limit = _ALLOWED.velocity_gain + rounding
    if not abs(slope - 1) <= limit:
        raise ImplausibleChannels(
            spec.axis, f"position changes by {slope:.4g} times the integral of velocity, limit 1 +- {limit:.2g}"
        )


def _check_load(spec: SweepSpec, time: Array, position: Array, load: Array) -> None:
    """The direct encoder. Without an offset the load may oscillate more than the motor, or stick: it is not checked."""
    if not spec.offset_velocity:
        return
    _check_frozen(spec, {"load position": load})
    harmless = _ALLOWED.harmless * _peak(spec) / spec.sample_rate
    _check_steps(spec, "load position", np.diff(load) - np.diff(position), harmless, _resolution(load))
    slope = _slope(time, position, load, trend=False)
    if not abs(slope - 1) <= _ALLOWED.load_gain:
        raise ImplausibleChannels(
            spec.axis,
            f"the direct encoder moves {slope:.4g} times as far as the motor, limit 1 +- {_ALLOWED.load_gain}",
        )


def _check_steps(spec: SweepSpec, name: str, steps: Array, harmless: float, resolution: float) -> None:
    middle = float(np.median(steps))
    deviation = np.abs(steps - middle)
    spread = 1.4826 * float(np.median(deviation))  # standard deviation of a normal distribution
    limit = max(_ALLOWED.glitch * spread, harmless, _ALLOWED.steps * resolution)
    worst = int(np.argmax(deviation))
    if not deviation[worst] <= limit:
        raise ImplausibleChannels(
            spec.axis, f"{name} jumps {deviation[worst]:.3g} at sample {worst + 1} of the window, limit {limit:.3g}"
        )


def _check_effort(spec: SweepSpec, time: Array, effort: Array, velocity: Array) -> None:
    """Only at the lowest line: above the locked-rotor frequency the spring acts on the motor, not the load.

    About standstill presliding friction is a spring as well, at any frequency, but it takes energy.
    """
    line = min(sine.frequency for sine in spec.sines)
    turn = np.exp(-2j * np.pi * line * time)
    slow = np.exp(-2j * np.pi * np.arange(len(time)) / len(time))  # one bin further
    drive, noise = _without_trend(time, effort), 0.0
    response = np.mean(drive * turn) / np.mean(velocity * turn)
    if spec.periods is not None and spec.periods > 2:  # bins between the lines show the noise
        beside = [abs(np.mean(drive * turn * slow**k)) for k in (-1, 1)]
        noise = float(max(beside) / abs(np.mean(velocity * turn)))
    takes_energy = not spec.offset_velocity and drive @ velocity > 0
    if response.imag < -_ALLOWED.significant * noise and not takes_energy:
        raise ImplausibleChannels(
            spec.axis,
            f"apparent inertia {response.imag / (2 * np.pi * line):.4g} at {line:g} Hz is below 0: "
            "effort has the wrong sign or belongs to another axis",
        )


def _slope(time: Array, x: Array, y: Array, trend: bool) -> float:
    """Least squares slope of y over x, both without mean or trend."""
    x, y = (_without_trend(time, values) if trend else values - values.mean() for values in (x, y))
    return float(x @ y / (x @ x))


def _without_trend(time: Array, values: Array) -> Array:
    centred = time - time.mean()
    level = values - values.mean()
    return level - centred * (centred @ level) / (centred @ centred)


def _resolution(values: Array) -> float:
    """The smallest step of a channel; 0 if there is none."""
    steps = np.abs(np.diff(values))
    return float(np.min(steps, where=steps > 0, initial=np.inf)) if np.any(steps) else 0.0
