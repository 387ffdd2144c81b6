"""Steady friction, sticking and warmth against numbers by hand."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulator import DriveTrain, Gravity, MovingAxis, SweepRun, Turn, load_scenario, run_sweeps, warmth
from simulator.drive_train import DriveTrains
from simulator.plant import Samples
from simulator.scenario import STEP
from tests.unit.simulator.conftest import CONFIG

pytestmark = pytest.mark.slow

Make = Callable[..., MovingAxis]
Run = Callable[..., Samples]

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
