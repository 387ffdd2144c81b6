"""Few axes are stepped one by one in floats, many together in arrays: to the last digit the same motion."""

from collections.abc import Callable
from dataclasses import fields

import numpy as np
import pytest

from simulator import Gravity, MovingAxis
from simulator.drive_train import DriveTrains
from simulator.plant import Samples
from simulator.scenario import STEP

SPRING = {"stiffness": 4e5, "damping": 300.0}
RUBBING = {
    "coulomb": 40.0,
    "stribeck": {"extra": 20.0, "velocity": 0.01},
    "load_dependence": 0.1,
    "power": {"coefficient": 30.0, "exponent": 0.4},
    "patch": {"coulomb": 5.0, "centre": 0.0, "width": 0.3},
}
WARMING = {"heat_capacity": 900.0, "time_constant": 1200.0, "coulomb_loss": 0.01, "viscous_loss": 0.02}
TRAINS = {
    "rigid": {"motor_friction": {"viscous": 30.0, "coulomb": 40.0}},
    "elastic": {"spring": SPRING, "load_friction": {"coulomb": 40.0}},
    "hardening with backlash": {"spring": SPRING | {"hardening": 1e9, "backlash": 4e-4}},
    "hose and cogging": {
        "spring": SPRING,
        "hose": {"stiffness": 20.0, "rest": 0.3, "damping": 2.0},
        "cogging": [{"order": 1, "amplitude": 3.0}, {"order": 8, "amplitude": 9.0, "phase": 1.0}],
    },
    "friction, rigid": {"motor_friction": RUBBING, "load_friction": {"backward_viscous": 50.0} | RUBBING},
    "friction, elastic": {"spring": SPRING, "motor_friction": RUBBING, "load_friction": {"backward_coulomb": 9.0}},
    "bristles": {
        "spring": SPRING,
        "lugre": {"stiffness": 1e6, "damping": 100.0, "coulomb": 30.0, "breakaway": 40.0, "stribeck_velocity": 0.01},
    },
}


@pytest.mark.parametrize("train", TRAINS.values(), ids=TRAINS.keys())
def test_alone_it_moves_as_in_company(
    axis: Callable[..., MovingAxis], turned: Callable[..., Samples], train: dict[str, object]
) -> None:
    one = axis(Gravity(cosine=300.0, sine=-90.0, constant=5.0), **train)
    swing = 4.0 * np.sin(2 * np.pi * 40.0 * np.arange(300) * 1e-3)[:, None]  # hard enough to reach the torque limit
    alone, together = (turned([one] * rows, np.tile(swing, rows)) for rows in (1, DriveTrains.few + 1))
    assert together.torque_limited.any()
    for field in fields(Samples):
        assert np.array_equal(getattr(alone, field.name)[:, 0], getattr(together, field.name)[:, -1]), field.name


@pytest.mark.parametrize(
    "train",
    [
        {"motor_friction": {"coulomb": 40.0}, "warming": WARMING},
        {"spring": SPRING, "gear_error": [{"order": 1, "amplitude": 1e-4}]},
        {"spring": SPRING, "appendage": {"inertia": 2.0, "stiffness": 8e3, "damping": 4.0}},
    ],
    ids=["warming", "gear error", "appendage"],
)
def test_effects_of_their_own_are_stepped_together(axis: Callable[..., MovingAxis], train: dict[str, object]) -> None:
    trains = DriveTrains([axis(**train)], STEP)
    trains.free[:] = 1.0
    assert trains.alone() is None
