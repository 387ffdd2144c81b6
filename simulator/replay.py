"""The inverse run: recorded motor motion in, the torque that a drive would record for it out. No controller enters.

The motor is led along the recording, the load follows through its spring (the plant's own step, with a motor that
nothing can disturb); then u = Jm a + fm(v) + cogging(q) + what the gear takes. Samples are means over cycles; every
linear relation holds between means too, so they are taken as point values at the samples' instants and not averaged
again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from simulator.channel import Channel
from simulator.drive_train import DriveTrains
from simulator.effects.bristles import Bristles
from simulator.effects.ripples import cogging
from simulator.moving_axis import MovingAxis
from simulator.scenario import STEP, Measurement

Array = NDArray[np.float64]

_IMMOVABLE = 1e18  # kg m^2
_EXACT = Measurement()


@dataclass(frozen=True, slots=True)
class Motion:
    """Recorded motion of a motor, referred to the joint: arrays (n,), s, rad, rad/s; n >= 4, starts at standstill."""

    time: Array
    position: Array
    velocity: Array


def replay(axes: Sequence[MovingAxis], motions: Sequence[Motion], measurement: Measurement = _EXACT) -> list[Array]:
    """Recorded torque (n,) N m at the samples of each motion, one axis each (all rigid or all elastic), in one pass.

    Of `measurement`, delay and smoothing of the effort count; there is no noise. How warm a gear is at the start, its
    `MovingAxis` says. At standstill dry friction may take any torque within its limits: there it counts as zero.
    """
    if len(axes) != len(motions):
        raise ValueError(f"{len(axes)} axes for {len(motions)} motions")
    if not axes:
        return []
    steps = max(round(float(m.time[-1] - m.time[0]) / STEP) for m in motions) + 1
    grid = np.linspace(0.0, STEP * (steps - 1), steps)
    position, velocity, acceleration = np.empty((3, steps, len(motions)))
    for row, motion in enumerate(motions):
        since = motion.time - motion.time[0]
        at = np.minimum(grid, since[-1])  # a shorter motion waits at its end
        speed = CubicSpline(since, motion.velocity)
        position[:, row] = CubicSpline(since, motion.position)(at)
        velocity[:, row] = speed(at)
        acceleration[:, row] = speed(at, 1)
    effort = _motor_torque(axes, position, velocity, acceleration)
    effort += (_elastic if axes[0].train.spring else _rigid)(axes, position, velocity, acceleration)
    effort = _recorded(axes, effort, measurement)
    return [np.interp(motion.time - motion.time[0], grid, effort[:, row]) for row, motion in enumerate(motions)]


def _motor_torque(axes: Sequence[MovingAxis], position: Array, velocity: Array, acceleration: Array) -> Array:
    """What the motor itself takes but for friction that `effects.friction` knows, (steps, rows)."""
    torque = acceleration * np.array([axis.motor_inertia for axis in axes])
    ripple = cogging(axes)
    if ripple is not None:
        torque += np.stack([ripple.at(row) for row in position])
    if any(axis.train.lugre for axis in axes):
        bristles = Bristles([axis.train.lugre for axis in axes], STEP)
        torque += np.stack([bristles.step(row) for row in velocity])
    return torque


def _rigid(axes: Sequence[MovingAxis], position: Array, velocity: Array, acceleration: Array) -> Array:
    """Friction, and what the motor gives to a load that follows at once, (steps, rows)."""
    trains = _led(axes, position[0])
    torque = np.array([axis.load_inertia for axis in axes]) * acceleration
    for n, here in enumerate(position):
        trains.position[0], trains.velocity[0] = here, velocity[n]
        torque[n] += trains.gravity()
        if trains.appendages is not None:
            torque[n] += trains.appendages.step(here, velocity[n])
        transmitted = torque[n].copy()
        torque[n] += trains.friction_torque(transmitted)[0]
        if trains.friction is not None:
            trains.friction.warm(trains.velocity, transmitted, here)
    return torque


def _elastic(axes: Sequence[MovingAxis], position: Array, velocity: Array, acceleration: Array) -> Array:
    """Friction of the motor, and what it gives to the spring, (steps, rows)."""
    trains = _led(axes, position[0])
    idle = np.zeros(len(axes))
    torque = np.empty_like(acceleration)
    for n in range(len(position)):
        trains.position[0] = position[n]
        trains.velocity[0] = velocity[n]
        spring, damping, before = trains.spring_torque(), trains.damping * trains.engaged(), trains.velocity[1].copy()
        lever = trains.lever()
        torque[n] = trains.friction_torque(spring)[0]
        trains.step(idle)
        torque[n] += lever * (spring + damping * (lever * velocity[n] - (before + trains.velocity[1]) / 2))
    return torque


def _led(axes: Sequence[MovingAxis], position: Array) -> DriveTrains:
    """The drive trains at rest in `position` (rows,), their motors led: nothing disturbs them."""
    bare = {"motor_inertia": _IMMOVABLE, "cogging": (), "lugre": None}
    trains = DriveTrains([replace(axis, train=axis.train.model_copy(update=bare)) for axis in axes], STEP)
    trains.free[:] = 1.0
    trains.position[:] = position
    for row in range(len(axes)):
        trains.settle(row)
    return trains


def _recorded(axes: Sequence[MovingAxis], effort: Array, measurement: Measurement) -> Array:
    """What the drive makes of the torque (steps, rows)."""
    channel = Channel(len(axes), STEP, measurement.effort_delay, measurement.effort_smoothing)
    for row, value in enumerate(effort[0]):
        channel.restart(row, float(value))
    gain = np.array([axis.train.effort_gain for axis in axes])
    return channel.pass_on(effort) * gain + np.array([axis.train.effort_offset for axis in axes])
