"""The inverse run: recorded motor motion in, the torque the motor needs for it out. No controller enters.

The motor is led along the recording, the load follows through its spring (the plant's own step, with a motor that
nothing can disturb); then u = Jm a + fm(v) + cogging(q) + Ts. Samples are means over cycles; every linear relation
holds between means too, so they are taken as point values at the samples' instants and not averaged again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from simulator.drive_train import Bristles, DriveTrains, cogging
from simulator.moving_axis import MovingAxis
from simulator.scenario import STEP, DriveTrain, Friction

Array = NDArray[np.float64]

_IMMOVABLE = 1e18  # kg m^2


@dataclass(frozen=True, slots=True)
class Motion:
    """Recorded motion of a motor, referred to the joint: arrays (n,), s, rad, rad/s; n >= 4, starts at standstill."""

    time: Array
    position: Array
    velocity: Array


def replay(axes: Sequence[MovingAxis], motions: Sequence[Motion]) -> list[Array]:
    """Motor torque (n,) N m at the samples of each motion, one axis each (all rigid or all elastic), in one pass.

    At standstill dry friction may take any torque within its limits: there the motor's share counts as zero.
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
    effort = _motor_torque(axes, position, velocity, acceleration) + _load_torque(
        axes, position, velocity, acceleration
    )
    return [np.interp(motion.time - motion.time[0], grid, effort[:, row]) for row, motion in enumerate(motions)]


def _motor_torque(axes: Sequence[MovingAxis], position: Array, velocity: Array, acceleration: Array) -> Array:
    """What the motor itself takes, (steps, rows)."""
    friction = [axis.train.motor_friction for axis in axes]
    torque = acceleration * np.array([axis.motor_inertia for axis in axes])
    torque += velocity * np.array([f.viscous for f in friction])
    torque += np.sign(velocity) * np.array([f.coulomb for f in friction])
    ripple = cogging(axes)
    if ripple is not None:
        torque += np.stack([ripple(row) for row in position])
    if any(axis.train.lugre for axis in axes):
        bristles = Bristles([axis.train.lugre for axis in axes], STEP)
        torque += np.stack([bristles.step(row) for row in velocity])
    return torque


def _load_torque(axes: Sequence[MovingAxis], position: Array, velocity: Array, acceleration: Array) -> Array:
    """What the motor gives to the load, (steps, rows)."""
    led = [replace(axis, train=_led(axis)) for axis in axes]
    trains = DriveTrains(led, STEP)
    trains.free[:] = 1.0
    trains.position[:] = position[0]
    if not trains.elastic:
        inertia = np.array([axis.load_inertia for axis in axes])
        viscous = np.array([axis.train.load_friction.viscous for axis in axes])
        coulomb = np.array([axis.train.load_friction.coulomb for axis in axes])
        torque = inertia * acceleration + viscous * velocity + coulomb * np.sign(velocity)
        for n, here in enumerate(position):
            trains.position[0] = here
            torque[n] += trains.gravity()
        return torque
    for row in range(len(axes)):
        trains.settle(row)
    idle = np.zeros(len(axes))
    torque = np.empty_like(position)
    for n in range(len(position)):
        trains.position[0] = position[n]
        trains.velocity[0] = velocity[n]
        elastic, before = trains.spring_torque(), trains.velocity[1].copy()
        trains.step(idle)
        torque[n] = elastic + trains.damping * (velocity[n] - (before + trains.velocity[1]) / 2)
    return torque


def _led(axis: MovingAxis) -> DriveTrain:
    return axis.train.model_copy(
        update={"motor_inertia": _IMMOVABLE, "motor_friction": Friction(), "cogging": (), "lugre": None}
    )
