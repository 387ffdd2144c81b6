"""Sweeps of axis 1 of the representative robot as they are in a bundle, made without a machine."""

import numpy as np

from service.model import Recording, Robot, Sine, Sweep, SweepSpec
from service.store.files.bundle import Bundle

OFFSET, AMPLITUDE, FRICTION = 0.0105, 0.002, 180.0  # rad/s, rad/s, N m s/rad


def rigid_sweep(number: int, elbow: float, inertia: float = 300.0, rate: float = 250.0, periods: int = 5) -> Sweep:
    """Of a rigid body (kg m^2) with viscous friction, and noise of 1 N m; `number` is also the seed of the noise."""
    sines = tuple(Sine(frequency=f, amplitude=AMPLITUDE, phase=f**2) for f in (2.0, 3.0, 4.0, 5.0))
    time = np.arange(int(rate * periods)) / rate
    noise = np.random.default_rng(number).normal(size=len(time))
    angles = [2 * np.pi * sine.frequency * time + sine.phase for sine in sines]
    velocity = OFFSET + sum(sine.amplitude * np.sin(angle) for sine, angle in zip(sines, angles, strict=True))
    acceleration = sum(
        2 * np.pi * sine.frequency * sine.amplitude * np.cos(angle) for sine, angle in zip(sines, angles, strict=True)
    )
    effort = inertia * acceleration + FRICTION * velocity + noise
    spec = SweepSpec(
        id=f"{number:04d}",
        axis="joint_1",
        pose=(0.0, elbow, 0.0, 0.0, 0.0, 0.0),
        offset_velocity=OFFSET,
        sines=sines,
        period=1.0,
        periods=periods,
        sample_rate=rate,
        started_at=10.0 * number,
    )
    return Sweep(spec, Recording(time, np.asarray(effort), np.asarray(velocity), np.cumsum(velocity) / rate))


def rigid_bundle(robot: Robot, count: int) -> Bundle:
    """Short sweeps in `count` poses: the inertia changes with the elbow."""
    elbows = np.linspace(-0.5, 0.5, count).tolist()
    return Bundle(
        robot, tuple(rigid_sweep(n, elbow, 300.0 + 50.0 * elbow, periods=3) for n, elbow in enumerate(elbows, 1))
    )
