"""Between motor and load, on the load, and in the record: by hand, by the energy, beside a second axis."""

from collections.abc import Callable

import numpy as np
import pytest

from simulator import DriveTrain, Gravity, Measurement, MovingAxis, Scenario, SweepRun, run_sweeps, run_trajectories
from simulator.drive_train import DriveTrains
from simulator.plant import Samples
from simulator.scenario import STEP

pytestmark = pytest.mark.slow

Make = Callable[..., MovingAxis]
Run = Callable[..., Samples]

SPRING = {"stiffness": 4e5, "damping": 300.0}


def test_the_spring_takes_up_what_is_beyond_the_backlash(axis: Make) -> None:
    trains = DriveTrains([axis(spring=SPRING | {"backlash": 4e-4, "hardening": 1e9})] * 4, STEP)
    trains.position[0] = [1e-4, -2e-4, 5e-4, -7e-4]
    beyond = np.array([0.0, 0.0, 3e-4, -5e-4])
    np.testing.assert_allclose(trains.twist(), beyond, atol=1e-18)
    np.testing.assert_allclose(trains.spring_torque(), 4e5 * beyond + 1e9 * beyond**3)


def test_a_reversing_motor_travels_through_the_backlash(axis: Make, turned: Run) -> None:
    """The load rests on its friction until the motor has come through the gap as well."""
    time = np.arange(4000) * 1e-3
    speed = 0.01 * np.sin(2 * np.pi * 0.5 * time)
    friction = {"coulomb": 40.0}
    axes = [axis(spring=SPRING | {"backlash": gap}, load_friction=friction) for gap in (0.0, 6e-4)]
    samples = turned(axes, np.stack([speed, speed], axis=1))
    lag = np.ptp((samples.position - samples.load_position)[1000:], axis=0)
    assert lag[0] > 2 * 40.0 / 4e5  # what the spring winds
    assert lag[1] - lag[0] == pytest.approx(6e-4, rel=0.1)
    loose = np.abs(samples.load_velocity) < 1e-9  # the load rests longer, by the time the motor needs
    assert loose[1000:, 1].sum() > 1.3 * loose[1000:, 0].sum()


def test_a_load_hangs_on_one_flank(axis: Make) -> None:
    train = {"spring": SPRING | {"backlash": 4e-4}, "gear_error": ({"order": 2, "amplitude": 1e-4, "phase": 0.3},)}
    trains = DriveTrains([axis(Gravity(constant=weight), **train) for weight in (200.0, -200.0, 0.0)], STEP)
    for row in range(3):
        trains.settle(row)
    ahead = 1e-4 * np.sin(0.3)
    np.testing.assert_allclose(trains.position[1], [ahead - 5e-4 - 2e-4, ahead + 5e-4 + 2e-4, ahead], rtol=1e-9)
    np.testing.assert_allclose(trains.spring_torque(), [200.0, -200.0, 0.0], atol=1e-9)


def test_a_gear_error_moves_the_load_and_pushes_back(axis: Make, turned: Run) -> None:
    """Load position is motor position plus the error; a constant weight is felt as weight * (1 + its slope)."""
    error = {"order": 3, "amplitude": 2e-5, "phase": 0.4}
    samples = turned(
        [axis(Gravity(constant=800.0), spring={"stiffness": 5e7, "damping": 3e4}, gear_error=(error,))], [0.01], 4.0
    )
    motor = samples.position[2000:, 0]
    angle = 3 * 100 * motor + 0.4
    ahead = (samples.load_position[2000:, 0] - motor) + 800 / 5e7
    np.testing.assert_allclose(ahead, 2e-5 * np.sin(angle), atol=3e-7)
    # the inertia of the load on top: -50 * 2e-5 * 300^2 * 0.01^2 sin
    felt = 800 * (1 + 2e-5 * 300 * np.cos(angle)) - 50 * 2e-5 * (300 * 0.01) ** 2 * np.sin(angle)
    np.testing.assert_allclose(samples.effort[2000:, 0], felt, atol=0.1)


def test_a_gear_error_needs_a_spring(axis: Make) -> None:
    with pytest.raises(ValueError, match="needs a spring"):
        DriveTrain.model_validate({"motor_inertia": 0.002, "gear_error": [{"order": 1, "amplitude": 1e-5}]})


def test_without_friction_the_energy_stays(axis: Make) -> None:
    """Spring with backlash and gear error, hose and appendage swing for a second: their energies add up to the same."""
    train = {
        "spring": {"stiffness": 4e5, "backlash": 2e-4, "hardening": 1e10},
        "gear_error": ({"order": 5, "amplitude": 1e-4},),
        "hose": {"stiffness": 3000.0, "rest": 0.1},
        "appendage": {"inertia": 8.0, "stiffness": 2e4},
    }
    trains = DriveTrains([axis(**train)], STEP)
    trains.free[:] = 1.0
    trains.settle(0)
    trains.velocity[0] = 0.03
    energies: list[float] = []
    appendages = trains.appendages
    assert appendages is not None
    for _ in range(4000):
        before, loose, twist = trains.velocity[:, 0].copy(), appendages.position[0], trains.twist()[0]
        load = trains.position[1, 0]
        trains.step(np.zeros(1))
        motion = (before**2 + trains.velocity[:, 0] ** 2) / 2 @ np.array([20.0, 50.0]) / 2
        speed = (appendages.position[0] - loose) / STEP
        energies.append(
            motion
            + 4e5 * twist**2 / 2
            + 1e10 * twist**4 / 4
            + 3000 * (load - 0.1) ** 2 / 2
            + 8 * speed**2 / 2
            + 2e4 * (load - appendages.position[0] + STEP * speed / 2) ** 2 / 2
        )
    assert np.ptp(energies) < 0.02 * (20 * 0.03**2 / 2)


def test_a_hose_pulls_towards_its_rest(axis: Make, turned: Run) -> None:
    hose = {"stiffness": 2000.0, "rest": 0.05, "damping": 400.0}
    for spring in ({}, {"spring": SPRING}):
        samples = turned([axis(hose=hose, **spring)], [0.02])
        expected = 2000 * (samples.load_position[-200:, 0] - 0.05) + 400 * 0.02
        np.testing.assert_allclose(samples.effort[-200:, 0], expected, atol=0.5)


def test_an_appendage_weighs_below_its_resonance_and_not_above(axis: Make, turned: Run) -> None:
    """At 2 Hz the load feels J w^2 / (w0^2 - w^2) w0^2... of 8 kg m^2 hung at 6 Hz; at 18 Hz it swings against it."""
    own = 2 * np.pi * 6.0
    time = np.arange(4000) * 1e-3
    for frequency in (2.0, 18.0):
        wave = 0.01 * np.sin(2 * np.pi * frequency * time)
        hung = axis(appendage={"inertia": 8.0, "stiffness": 8.0 * own**2, "damping": 30.0})
        samples = turned([axis(), hung], np.stack([wave, wave], axis=1))
        turn = np.exp(-2j * np.pi * frequency * time[2000:])[:, None]
        ratio = (samples.effort[2000:] * turn).mean(axis=0) / (samples.velocity[2000:] * turn).mean(axis=0)
        s = 2j * np.pi * frequency
        mounted = 8.0 * own**2 + 30.0 * s
        expected = s * (70 + 8.0 * mounted / (8.0 * s**2 + mounted))
        np.testing.assert_allclose(ratio, [70 * s, expected], rtol=0.01)


def test_the_record_has_gain_and_offset(axis: Make, turned: Run) -> None:
    friction = {"motor_friction": {"coulomb": 50.0, "viscous": 100.0}}
    axes = [axis(**friction), axis(effort_gain=0.93, effort_offset=12.0, **friction)]
    samples = turned(axes, [0.02] * 2, measurement=Measurement(effort_delay=0.0003))
    np.testing.assert_allclose(samples.effort[:, 1], 0.93 * samples.effort[:, 0] + 12.0)
    assert samples.effort[-1, 0] == pytest.approx(52.0, rel=1e-3)


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
