"""The inverse simulation: from recorded motor motion to the torque that a drive would record. Without a controller.

The motor follows the recording and the load follows through its spring (the same step as in the plant, with a
prescribed motor motion). Then u = Jm a + fm(v) + cogging(q) + torque of the gear. Samples are means over cycles.
Every linear relation also holds between means, so they are used as point values at the samples' instants and not
averaged again. Effects without memory need no steps between samples and are computed for many samples at once.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from simulator.drive_train import DriveTrains
from simulator.effects import Bristles, FrictionLaw, KnownRipples, Ripples, cogging
from simulator.plant import Channel
from simulator.rigid_body import MovingAxis
from simulator.scenario import CYCLE, STEP, Measurement
from simulator.waveform import Array

if TYPE_CHECKING:  # otherwise a virtual machine would load SciPy without using it
    from scipy.interpolate import CubicSpline, PPoly


@dataclass(frozen=True)
class Motion:
    """Recorded motion of a motor on the joint side: arrays (n,), s, rad, rad/s; n >= 4.

    A load with a spring begins at the motor's speed, without acceleration: preferably from standstill.
    """

    time: Array
    position: Array
    velocity: Array

    def at(self, grid: Array, late: float) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration at times since the start, with the speed as if recorded `late`, s.
        Constant after the end.
        """
        position, velocity, acceleration = self._splines
        end = float(self.time[-1] - self.time[0])
        here, ahead = np.minimum(grid, end), np.minimum(grid + late, end)
        return position(here), velocity(ahead), acceleration(ahead)

    @cached_property
    def _splines(self) -> "tuple[CubicSpline, CubicSpline, PPoly]":
        from scipy.interpolate import CubicSpline

        since = self.time - self.time[0]
        velocity = CubicSpline(since, self.velocity)
        return CubicSpline(since, self.position), velocity, velocity.derivative()


def replay(
    axes: Sequence[MovingAxis],
    motions: Sequence[Motion],
    measurement: Measurement | Sequence[Measurement] | None = None,
) -> list[Array]:
    """Recorded torque (n,) N m at the samples of each motion, one axis each (all rigid or all elastic), in one pass.

    Of `measurement` (one for all, or one per row) delay and smoothing of the effort and delay of the speed are
    applied; there is no noise. The initial temperature of a gear is in its `MovingAxis`. At standstill dry friction
    may have any value within its limits; here it counts as zero.
    """
    exact = measurement or Measurement()
    measurements = [exact] * len(axes) if isinstance(exact, Measurement) else list(exact)
    if not len(axes) == len(motions) == len(measurements):
        raise ValueError(f"{len(axes)} axes for {len(motions)} motions and {len(measurements)} measurements")
    if not axes:
        return []
    step = _step(axes)
    position, velocity, acceleration = _on_grid(motions, [one.velocity_delay for one in measurements], step)
    effort = _motor_torque(axes, position, velocity, acceleration)
    effort += (_elastic if axes[0].train.spring else _rigid)(axes, position, velocity, acceleration, step)
    grid = np.linspace(0.0, step * (len(effort) - 1), len(effort))
    return [
        np.interp(motion.time - motion.time[0], grid, _recorded(axis, effort[:, row], measurements[row], step))
        for row, (axis, motion) in enumerate(zip(axes, motions, strict=True))
    ]


def _step(axes: Sequence[MovingAxis]) -> float:
    """Step in s: that of the plant for fast dynamics, a longer one if the loads only oscillate slowly or nothing has
    memory.
    """
    trains = [axis.train for axis in axes]
    if any(train.lugre or train.appendage for train in trains):
        return STEP
    swings = [np.sqrt(axis.train.spring.stiffness / axis.load_inertia) for axis in axes if axis.train.spring]
    phase = 1.25  # rad of a load oscillation per step with prescribed motor; the leapfrog is unstable from 2
    return next((CYCLE / n for n in (1, 2) if CYCLE / n * max(swings, default=0.0) < phase), STEP)


def _on_grid(motions: Sequence[Motion], late: Sequence[float], step: float) -> Array:
    """Position, velocity and acceleration (3, steps, rows), with the speed shifted earlier by `late`, s. A shorter
    motion stays at its end.
    """
    different = {(id(motion), delay): motion for motion, delay in zip(motions, late, strict=True)}
    steps = max(round(float(m.time[-1] - m.time[0]) / step) for m in motions) + 1
    grid = np.linspace(0.0, step * (steps - 1), steps)
    result = np.empty((3, steps, len(motions)))
    for (key, delay), motion in different.items():
        rows = [row for row, other in enumerate(motions) if (id(other), late[row]) == (key, delay)]
        for signal, value in zip(result, motion.at(grid, delay), strict=True):
            signal[:, rows] = value[:, None]
    return result


def _motor_torque(axes: Sequence[MovingAxis], position: Array, velocity: Array, acceleration: Array) -> Array:
    """Torque for the motor itself, without the friction in `effects.friction`, (steps, rows)."""
    torque = acceleration * np.array([axis.motor_inertia for axis in axes])
    ripple = cogging(axes)
    if ripple is not None:
        for at in _pieces(position):
            torque[at] += ripple.at(position[at])
    if any(axis.train.lugre for axis in axes):
        bristles = Bristles([axis.train.lugre for axis in axes], STEP)
        for at in _pieces(velocity):
            torque[at] += bristles.along(velocity[at])
    return torque


def _rigid(axes: Sequence[MovingAxis], position: Array, velocity: Array, acceleration: Array, step: float) -> Array:
    """Friction, and torque from the motor to a rigidly connected load, (steps, rows)."""
    trains = _led(axes, position[0], velocity[0], step)
    law = FrictionLaw([axis.train for axis in axes], [axis.warmth for axis in axes], step)
    damping = np.array([axis.train.hose.damping if axis.train.hose else 0.0 for axis in axes])
    torque = np.array([axis.load_inertia for axis in axes]) * acceleration
    quarter = round(0.25 / step)  # s per block, so that few iterations make friction and temperature agree
    for at in _pieces(position, quarter if law.warms else None):
        trains.position = position[None, at]
        torque[at] += trains.gravity()
        if trains.appendages is not None:
            torque[at] += np.stack(
                [trains.appendages.step(*now) for now in zip(position[at], velocity[at], strict=True)]
            )
        torque[at] += _friction(law, velocity[at], torque[at], position[at]) + damping * velocity[at]
    return torque


def _friction(law: FrictionLaw, velocity: Array, transmitted: Array, position: Array) -> Array:
    """Friction of motor and load together (steps, rows), N m, including its own heating; updates the temperature of
    `law`.
    """
    motion = (velocity[:, None], transmitted[:, None], position[:, None])
    start, torque = law.warmth, law.whole(*motion).sum(axis=1)
    while law.warms:
        gained = law.heating * torque * velocity
        path = _cooling(gained, 1 - law.cooling, start)
        law.warmth = np.concatenate([start[None], path[:-1]])[:, None]
        before, torque = torque, law.whole(*motion).sum(axis=1)
        if np.abs(torque - before).max() < 1e-7 * np.abs(torque).max():
            law.warmth = path[-1]
            break
    return torque


def _cooling(gained: Array, keep: Array, start: Array) -> Array:
    """``T[n] = keep T[n - 1] + gained[n]`` (steps, rows)."""
    from scipy.signal import lfilter

    path = np.empty_like(gained)
    for one in np.unique(keep):
        alike = keep == one
        path[:, alike] = lfilter([1.0], [1.0, -one], gained[:, alike], axis=0, zi=one * start[None, alike])[0]
    return path


def _elastic(axes: Sequence[MovingAxis], position: Array, velocity: Array, acceleration: Array, step: float) -> Array:
    """Friction of the motor, and its torque on the spring, (steps, rows)."""
    trains = _led(axes, position[0], velocity[0], step)
    known = _known(trains.gear_error, position)
    if known is not None:
        trains.gear_error = known
    idle = np.zeros(len(axes))
    torque = np.empty_like(acceleration)
    for n in range(len(position)):
        if known is not None:
            known.step = n
        trains.position[0] = position[n]
        trains.velocity[0] = velocity[n]
        spring, lever = trains.spring_torque(), trains.lever()
        torque[n] = trains.friction_torque(spring)[0]
        trains.step(idle)
        torque[n] += lever * (spring + trains.damping_torque())
    return torque


def _known(ripples: Ripples | KnownRipples | None, position: Array) -> KnownRipples | None:
    """Ripples along the positions (steps, rows) of the motor."""
    if not isinstance(ripples, Ripples):
        return None
    parts = [(ripples.at(position[at]), ripples.slope(position[at])) for at in _pieces(position)]
    sums, slopes = (np.concatenate(part) for part in zip(*parts, strict=True))
    return KnownRipples(sums, slopes)


def _led(axes: Sequence[MovingAxis], position: Array, velocity: Array, step: float) -> DriveTrains:
    """The drive trains in balance at `position` and `velocity` (rows,), with prescribed motor motion."""
    bare = {"motor_inertia": 1e18, "cogging": (), "lugre": None}
    trains = DriveTrains([replace(axis, train=axis.train.model_copy(update=bare)) for axis in axes], step)
    trains.free[:] = 1.0
    trains.position[:] = position
    for row in range(len(axes)):
        trains.settle(row)
    trains.velocity[:] = velocity
    return trains


def _recorded(axis: MovingAxis, effort: Array, measurement: Measurement, step: float) -> Array:
    """Torque (steps,) as recorded by the drive."""
    channel = Channel(1, step, measurement.effort_delay, measurement.effort_smoothing)
    channel.restart(0, float(effort[0]))
    return channel.pass_on(effort[:, None])[:, 0] * axis.train.effort_gain + axis.train.effort_offset


def _pieces(signal: Array, longest: int | None = None) -> Iterator[slice]:
    """Slices of steps in order, limited by the number of values over all rows, or by `longest`."""
    steps, rows = signal.shape
    count = longest or max(1, 200_000 // rows)  # values, so that arrays stay near the size of the cache
    return (slice(first, first + count) for first in range(0, steps, count))
