"""A rigid axis by formula, as four sweeps show it: two directions, each twice, with white noise."""

import numpy as np
import pytest

from service.model import Axis, Recording, Robot, RobotDescription, Sine, Sweep, SweepSpec, build_robot
from tests.unit.service.identification.conftest import URDF

RATED = 3000.0  # N m
RATE = 1000.0  # Hz
POSE = (0.4, -0.7)
OFFSET = 0.035  # rad/s
LINES = (2.0, 3.0, 5.0)  # Hz
AMPLITUDE = 0.009  # rad/s
INERTIA = 150 * 1.2**2 + 40 + 170.0**2 * 0.002  # of lift, kg m^2: arm about its joint, and motor
WEIGHT = 150 * 1.2 * 9.81  # N m
FRICTION = 400.0  # N m s/rad
NOISE = 0.0015 * RATED


def pair() -> Robot:
    """Two axes, of which `lift` carries its arm."""
    axes = tuple(
        Axis(joint=joint, gear_ratio=170.0, motor_inertia=0.002, rated_effort=RATED, viscous_friction=400.0)
        for joint in ("swing", "lift")
    )
    return build_robot(RobotDescription(name="pair", urdf="robot.urdf", axes=axes), URDF)


def lift_sweep(
    number: int, offset: float = OFFSET, *, repeat: int = 0, periods: int = 4, rate: float = RATE, run_up: float = 1.0
) -> Sweep:
    """A sweep of `lift` that starts from rest with a ramp of velocity; noise by its number."""
    random = np.random.default_rng(number)
    sines = tuple(Sine(frequency=f, amplitude=AMPLITUDE, phase=f) for f in LINES)
    time = np.arange(round((run_up + periods) * rate)) / rate
    turn = [2 * np.pi * s.frequency * (time - run_up) + s.phase for s in sines]
    ramp = np.clip(time / (0.5 * run_up), 0, 1) if run_up else np.ones_like(time)
    waves = sum(s.amplitude * np.sin(angle) for s, angle in zip(sines, turn, strict=True))
    velocity = ramp * (offset + waves)
    position = POSE[1] + np.concatenate([[0.0], np.cumsum(velocity[1:] + velocity[:-1]) / 2]) / rate
    effort = INERTIA * np.gradient(velocity, 1 / rate) + FRICTION * velocity + WEIGHT * np.cos(position)
    spec = SweepSpec(
        id=f"{number:04}",
        axis="lift",
        pose=POSE,
        offset_velocity=offset,
        sines=sines,
        period=1.0,
        periods=periods,
        measure_from=run_up,
        sample_rate=rate,
        started_at=10.0 * number,
        repeat=repeat,
        block="forward" if offset > 0 else "backward",
    )
    return Sweep(
        spec,
        Recording(
            time=time,
            effort=effort + NOISE * random.standard_normal(len(time)),
            velocity=velocity + 2e-5 * random.standard_normal(len(time)),
            position=position + 1e-7 * random.standard_normal(len(time)),
        ),
    )


@pytest.fixture
def robot() -> Robot:
    return pair()


@pytest.fixture
def sweeps() -> tuple[Sweep, ...]:
    return tuple(
        lift_sweep(number, offset, repeat=number % 2)
        for number, offset in enumerate((OFFSET, OFFSET, -OFFSET, -OFFSET))
    )
