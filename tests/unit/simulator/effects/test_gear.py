"""Friction, sticking, warmth, gear and load: by hand, by the energy, beside a second axis."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulator import (
    DriveTrain,
    Gravity,
    Measurement,
    MovingAxis,
    Scenario,
    SweepRun,
    Turn,
    load_scenario,
    run_sweeps,
    run_trajectories,
    warmth,
)
from simulator.drive_train import DriveTrains
from simulator.plant import Samples
from simulator.scenario import STEP
from tests.unit.simulator.conftest import CONFIG

pytestmark = pytest.mark.slow

Make = Callable[..., MovingAxis]
Run = Callable[..., Samples]

SPRING = {"stiffness": 4e5, "damping": 300.0}


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


ASYMMETRIC = {"viscous": 100.0, "coulomb": 80.0, "backward_viscous": 60.0, "backward_coulomb": 50.0}
STRIBECK = {"coulomb": 80.0, "stribeck": {"extra": 40.0, "velocity": 0.02, "exponent": 1.5}}
POWER = {"viscous": 10.0, "power": {"coefficient": 300.0, "exponent": 0.5}}
PATCH = {"coulomb": 20.0, "patch": {"centre": 0.01, "width": 0.02, "coulomb": 30.0}}


@pytest.mark.parametrize("side", ["motor_friction", "load_friction"])
@pytest.mark.parametrize("elastic", [False, True])
def test_steady_friction(axis: Make, turned: Run, side: str, elastic: bool) -> None:
    """Effort at constant speed is the friction curve: (friction, speed, N m)."""
    cases: Sequence[tuple[Mapping[str, object], float, float]] = [
        (ASYMMETRIC, 0.02, 80 + 100 * 0.02),
        (ASYMMETRIC, -0.02, -50 - 60 * 0.02),
        (ASYMMETRIC, -0.04, -50 - 60 * 0.04),
        (STRIBECK, 0.01, 80 + 40 * np.exp(-(0.5**1.5))),
        (STRIBECK, -0.02, -80 - 40 * np.exp(-1)),
        (POWER, 0.04, 10 * 0.04 + 300 * 0.2),
        (POWER, -0.01, -10 * 0.01 - 300 * 0.1),
    ]
    spring = {"spring": {"stiffness": 1e6, "damping": 500.0}} if elastic else {}
    axes = [axis(**{side: friction}, **spring) for friction, _, _ in cases]
    effort = turned(axes, [speed for _, speed, _ in cases]).effort[-200:]
    np.testing.assert_allclose(effort.mean(axis=0), [torque for _, _, torque in cases], rtol=1e-3)


@pytest.mark.parametrize("elastic", [False, True])
def test_friction_grows_with_what_the_gear_transmits(axis: Make, turned: Run, elastic: bool) -> None:
    spring = {"spring": {"stiffness": 1e6, "damping": 500.0}} if elastic else {}
    friction = {"coulomb": 30.0, "load_dependence": 0.1}
    axes = [axis(Gravity(constant=weight), motor_friction=friction, **spring) for weight in (0.0, 500.0, -500.0)]
    up = turned(axes, [0.02] * 3).effort[-200:].mean(axis=0)
    down = turned(axes, [-0.02] * 3).effort[-200:].mean(axis=0)
    np.testing.assert_allclose(up, [30.0, 500 + 80.0, -500 + 80.0], rtol=1e-3)
    np.testing.assert_allclose(down, [-30.0, 500 - 80.0, -500 - 80.0], rtol=1e-3)


def test_a_patch_rubs_where_it_is(axis: Make, turned: Run) -> None:
    samples = turned([axis(motor_friction=PATCH)], [0.02], 2.0)
    for position, torque in ((0.01, 50.0), (0.02, 35.0), (0.035, 20.0)):
        there = np.argmin(np.abs(samples.position[:, 0] - position))
        assert samples.effort[there, 0] == pytest.approx(torque, abs=0.5)


def test_an_axis_sticks_below_the_limit_of_its_direction(axis: Make) -> None:
    """Limits at standstill: 80 forward, 50 backward; Stribeck 120; a tenth of 500 N m on top of 30."""
    frictions = [ASYMMETRIC, ASYMMETRIC, STRIBECK, STRIBECK]
    trains = DriveTrains([axis(motor_friction=friction) for friction in frictions], STEP)
    trains.free[:] = 1.0
    for _ in range(200):
        trains.step(np.array([79.0, -51.0, 119.0, 121.0]))
    assert np.array_equal(trains.velocity[0] != 0.0, [False, True, False, True])


def test_warming_follows_its_differential_equation(axis: Make) -> None:
    """C T' = f v - C T / tau with f = 100 exp(-0.05 T) + 50 exp(-0.02 T) v, v = 0.02 rad/s."""
    warming = {"heat_capacity": 0.05, "time_constant": 0.2, "coulomb_loss": 0.05, "viscous_loss": 0.02}
    train = {"motor_friction": {"viscous": 20.0, "coulomb": 60.0}, "load_friction": {"viscous": 30.0, "coulomb": 40.0}}
    trains = DriveTrains([axis(warmth=warmth, warming=warming, **train) for warmth in (0.0, 3.0)], STEP)
    law = trains.friction
    assert law is not None

    def torque(rise: np.ndarray) -> np.ndarray:
        return 100 * np.exp(-0.05 * rise) + 50 * np.exp(-0.02 * rise) * 0.02

    for seconds in (0.1, 0.3):
        for _ in range(round(seconds / STEP)):
            trains.velocity[0] = 0.02
            trains.step(np.zeros(2))
        trains.velocity[0] = 0.02
        felt = trains.friction_torque(np.zeros(2))[0]
        time = 0.1 if seconds == 0.1 else 0.4
        for row, start in enumerate((0.0, 3.0)):
            heating = solve_ivp(
                lambda _, rise: torque(rise) * 0.02 / 0.05 - rise / 0.2, (0.0, time), [start], rtol=1e-8
            )
            assert law.warmth[row] == pytest.approx(heating.y[0, -1], rel=2e-3)
            assert felt[row] == pytest.approx(torque(heating.y[0, -1]), rel=1e-3)


def test_a_gear_is_as_warm_as_its_past_leaves_it() -> None:
    """60 N m at 0.02 rad/s for 10 s, then 20 s of rest, then again; C = 4 J/K, tau = 50 s. The list is out of order."""
    train = DriveTrain.model_validate(
        {
            "motor_inertia": 0.002,
            "motor_friction": {"coulomb": 60.0},
            "warming": {"heat_capacity": 4.0, "time_constant": 50.0, "coulomb_loss": 0.1},
        }
    )
    turns = [Turn(start, 0.01, np.full(1000, 0.02)) for start in (130.0, 100.0, 0.0)]
    rises = warmth(train, turns)
    after_one = 60 * 0.02 * 50 / 4 * (1 - np.exp(-0.2))
    second = after_one * np.exp(-90 / 50)
    limit = 60 * np.exp(-0.1 * second) * 0.02 * 50 / 4
    third = (limit + (second - limit) * np.exp(-0.2)) * np.exp(-20 / 50)
    np.testing.assert_allclose(rises, [third, second, 0.0], rtol=1e-9)


def test_sweeps_warm_the_gear_in_the_order_of_their_start() -> None:
    rigid = load_scenario(CONFIG / "scenarios" / "max100-rigid.yaml")
    driven = rigid.driven("joint_1")
    warming = {"heat_capacity": 2.0, "time_constant": 500.0, "coulomb_loss": 0.2}
    train = DriveTrain.model_validate(driven.train.model_dump() | {"warming": warming})
    scenario = rigid.model_copy(update={"axes": {"joint_1": driven.model_copy(update={"train": train})}})
    runs = [
        SweepRun("joint_1", (0.0,) * 6, 0.02, (), 1.0, 1, 0.2, 0.2, started_at=started) for started in (500.0, 0.0, 2.0)
    ]
    late, first, second = (columns["effort"][400:1400].mean() for columns in run_sweeps(scenario, runs, seed=1))
    plain = run_sweeps(rigid, runs[:1], seed=1)[0]["effort"][400:1400].mean()
    assert second < first - 5.0
    assert second < late < first
    # 2.7 J a second for one second and a half, at 0.2 % loss a mK: half of it is there in the middle of the first
    assert first == pytest.approx(plain * np.exp(-0.2 * 130 * 0.02 * 0.8 / 2), rel=0.05)
