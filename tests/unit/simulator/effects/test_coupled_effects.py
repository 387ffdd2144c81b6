"""With two brakes open, an axis that hides everything at once is the one it is alone."""

from collections.abc import Callable

import numpy as np
import pytest

from simulator import DriveTrain, Scenario, SweepRun, run_sweeps, run_trajectories

pytestmark = pytest.mark.slow

EVERYTHING = {
    "motor_friction": {
        "viscous": 150.0,
        "coulomb": 100.0,
        "backward_viscous": 120.0,
        "backward_coulomb": 60.0,
        "stribeck": {"extra": 40.0, "velocity": 0.02},
        "load_dependence": 0.03,
    },
    "warming": {"heat_capacity": 4.0, "time_constant": 20.0, "coulomb_loss": 0.1},
    "spring": {"stiffness": 1.75e6, "damping": 1400.0, "backlash": 2e-4},
    "gear_error": [{"order": 1, "amplitude": 5e-5, "phase": 1.0}],
    "hose": {"stiffness": 800.0, "rest": 0.1, "damping": 100.0},
    "appendage": {"inertia": 10.0, "stiffness": 3e4, "damping": 60.0},
    "effort_gain": 1.04,
    "effort_offset": 30.0,
}


def test_a_coupled_axis_hides_what_it_hides_alone(noise_free: Callable[[str], Scenario]) -> None:
    six = noise_free("six")
    driven = six.driven("joint_2")
    train = DriveTrain.model_validate(driven.train.model_dump() | EVERYTHING)
    axes = six.axes | {"joint_2": driven.model_copy(update={"train": train})}
    scenario = six.model_copy(update={"axes": axes})
    pose, sines = (0.1, 0.4, -0.9, 0.0, 0.3, 0.0), ((2.0, 0.03, 0.3), (3.0, 0.01, 1.0))
    moving = SweepRun("joint_2", pose, 0.0, sines, 0.5, 2, 0.3, 0.2)
    still = SweepRun("joint_6", pose, 0.0, (), 0.5, 2, 0.3, 0.2)
    (alone,) = run_sweeps(scenario, [moving], seed=1)
    ((coupled, _),) = run_trajectories(scenario, [[moving, still]], seed=1)
    assert np.ptp(alone["effort"]) > 500
    for column, most in (("effort", 6.0), ("load_position", 2e-6)):
        np.testing.assert_allclose(coupled[column], alone[column], atol=most, err_msg=column)
