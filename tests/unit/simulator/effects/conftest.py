"""Rows of a plant with a drive train each, turned at constant speed."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from simulator import DriveTrain, Gravity, Measurement, MovingAxis, SpeedControl
from simulator.plant import Plant, Samples

CONTROL = SpeedControl(gain=9000.0, reset_time=0.05, effort_limit=1e4)


@pytest.fixture
def axis() -> Callable[..., MovingAxis]:
    """50 kg m^2 behind a motor of 20 kg m^2 (both at the joint), gear ratio 100, weightless unless said otherwise."""

    def make(gravity: Gravity | None = None, warmth: float = 0.0, **train: object) -> MovingAxis:
        whole = DriveTrain.model_validate({"motor_inertia": 0.002} | train)
        return MovingAxis(whole, 100.0, 50.0, gravity or Gravity(), warmth)

    return make


@pytest.fixture
def turned() -> Callable[..., Samples]:
    """Samples of `seconds` at the speeds (rows,) rad/s, or at set-points (cycles, rows); from standstill at 0."""

    def run(
        axes: Sequence[MovingAxis], speeds: object, seconds: float = 1.0, measurement: Measurement | None = None
    ) -> Samples:
        setpoints = np.asarray(speeds, dtype=float)
        if setpoints.ndim == 1:
            setpoints = np.tile(setpoints, (round(seconds * 1000), 1))
        plant = Plant(axes, [CONTROL] * len(axes), measurement or Measurement())
        for row in range(len(axes)):
            plant.release(row)
        return plant.advance(setpoints)

    return run
