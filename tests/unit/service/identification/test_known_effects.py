"""Known effects are read from a model's document, and what cannot be used is told."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from service import BadInput
from service.diagnosis.effects.friction import law
from service.identification.axis.known_effects import (
    LAWS,
    Corrected,
    GearLoad,
    KnownAxis,
    SweepMotion,
    corrected,
)
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.model import Robot, Sine
from tests.formula_sweep import by_formula, turning
from tests.unit.service.identification.known import Parameters, known, model, read

FRICTION = {"coulomb": (90.0, 2.0), "extra": (40.0, 3.0), "velocity": (0.006, 0.0005), "exponent": (2.0, 0.1)}


def test_correlations_are_those_of_the_covariance_and_directions_are_its_root() -> None:
    document = model(lift={"load_dependent_friction": {"coulomb": (90.0, 4.0), "load_dependence": (0.05, 0.01)}})
    document["axes"]["lift"]["effects"][0]["covariance"] = [[4.0, -0.008], [-0.008, 2.5e-5]]  # correlation -0.8
    effect = read(document, "lift").of("lift").effects[0]
    np.testing.assert_allclose(effect.covariance, [[16.0, -0.032], [-0.032, 1e-4]])
    root = np.array([list(step.values()) for step in effect.directions()])
    np.testing.assert_allclose(root.T @ root, effect.covariance, rtol=1e-12)


def test_what_is_exactly_known_moves_nothing() -> None:
    effect = known(lift={"coulomb_friction": {"coulomb": (90.0, 0.0)}}).of("lift").effects[0]
    assert effect.directions() == [{"coulomb": 0.0}]


@pytest.mark.parametrize(
    ("effects", "why"),
    [
        ({"measurement_delay": {"lag": (1e-3, 1e-5)}}, "it has no parameter delay"),
        (
            {"joint_elasticity": {"compliance": (-1e-6, 1e-7), "damping_time": (1e-3, 1e-4)}},
            "its compliance is not above 0",
        ),
        ({"torque_constant_error": {"gain_error": (-1.2, 0.1)}}, "its 1 + gain_error is not above 0"),
    ],
)
def test_an_effect_that_says_nothing_is_left_out(effects: dict[str, dict[str, tuple[float, float]]], why: str) -> None:
    axis = known(lift=effects).of("lift")
    (name,) = effects
    assert axis.get(name) is None
    assert axis.effects[0].unusable.startswith(why)


def with_covariance(told: list[Any]) -> dict[str, Any]:
    document = model(lift={"a": {"b": (1.0, 1.0)}})
    document["axes"]["lift"]["effects"][0]["covariance"] = told
    return document


def test_an_effect_without_parameters_is_read() -> None:
    assert known(lift={"a": {}}).of("lift").effects[0].covariance.shape == (0, 0)


def test_a_variance_without_a_root_gives_no_correlations() -> None:
    document = with_covariance([[5e-324, 1.0], [1.0, 5e-324]])
    document["axes"]["lift"]["effects"][0]["parameters"]["c"] = {"value": 1.0, "std": 2.0}
    effect = read(document, "lift").of("lift").effects[0]
    np.testing.assert_array_equal(effect.covariance, np.diag([1.0, 4.0]))


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ({}, r"model\.axes: Field required"),
        (
            {"axes": {"joint_9": {"effects": []}}},
            r"model\.axes\.joint_9: is not a joint of the robot; its joints are lift",
        ),
        ({"axes": {"lift": []}}, r"model\.axes\.lift: Input should be"),
        ({"axes": {"lift": {"effects": {}}}}, r"lift\.effects: Input should be"),
        ({"axes": {"lift": {"effects": [{}]}}}, r"lift\.effects\.0\.effect: Field required"),
        (model(lift={"a": {"b": (float("nan"), 1.0)}}), r"effects\.a\.b\.value: nan is not a finite number"),
        (model(lift={"a": {"b": (10**400, 1.0)}}), r"effects\.0\.parameters\.b\.value: Input should be a valid number"),
        (model(lift={"a": {"b": (1.0, -1.0)}}), r"effects\.a\.b\.std: -1\.0 is below 0"),
        (with_covariance([[1.0], [1.0, 2.0]]), r"effects\.a\.covariance: has rows of different lengths"),
        (with_covariance([["x"]]), r"effects\.0\.covariance\.0\.0: Input should be a valid number"),
    ],
)
def test_what_cannot_be_read_is_named(document: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        read(document, "lift")


SPEED = np.linspace(-0.1, 0.1, 41)
LOAD = np.linspace(-400.0, 900.0, 41)
MOTION = SweepMotion(SPEED, np.zeros(41), np.zeros(41), LOAD)


def test_a_lubricant_that_thins() -> None:
    told = {"coefficient": -30.0, "velocity": 0.03, "exponent": 0.4}
    expected = -30.0 * law(SPEED, 0.03, 0.4)
    assert LAWS["nonlinear_viscous_friction"](told, MOTION) == pytest.approx(expected)


def test_friction_that_grows_with_the_load_beyond_a_knee() -> None:
    told = {"coulomb": 20.0, "load_dependence": 0.05, "load_curvature": 0.01, "knee": 300.0}
    grown = 0.05 * (np.sqrt(LOAD**2 + 300.0**2) - 300.0) + 0.01 * LOAD**2 / 300.0
    assert LAWS["load_dependent_friction"](told, MOTION) == pytest.approx((20.0 + grown) * np.sign(SPEED))


def test_models_of_before_are_read_as_they_were_written() -> None:
    power = LAWS["nonlinear_viscous_friction"]({"coefficient": 5.0, "exponent": 0.5}, MOTION)
    assert power == pytest.approx(5.0 * np.sign(SPEED) * np.sqrt(np.abs(SPEED) / 0.01))
    straight = LAWS["load_dependent_friction"]({"coulomb": 20.0, "load_dependence": 0.05}, MOTION)
    assert straight == pytest.approx((20.0 + 0.05 * np.abs(LOAD)) * np.sign(SPEED))


RATE, START, INERTIA, VISCOUS = 1000.0, 1.0, 300.0, 40.0
SINES = tuple(Sine(frequency=f, amplitude=a, phase=f) for f, a in ((2.0, 0.004), (3.0, 0.003), (5.0, 0.002)))
NO_LOAD = GearLoad(0.0, 0.0, 0.0)

Signal = Callable[[np.ndarray], np.ndarray]


def velocity(time: np.ndarray) -> np.ndarray:
    return turning(time, 0.012, SINES, START).velocity


def acceleration(time: np.ndarray) -> np.ndarray:
    return turning(time, 0.012, SINES, START).acceleration


def way(time: np.ndarray) -> np.ndarray:
    return turning(time, 0.012, SINES, START).position


def measured(robot: Robot, effort: Signal) -> Spectrum:
    """A sweep of five periods whose effort is a formula of time."""
    told = {"axis": "lift", "pose": (0.0, 0.0), "offset_velocity": 0.012, "sines": SINES, "periods": 5}
    sweep = by_formula(lambda m: effort(m.time), 6.5, **told, measure_from=START, sample_rate=RATE)
    return spectrum(robot, sweep)


def rigid(time: np.ndarray) -> np.ndarray:
    return INERTIA * acceleration(time) + VISCOUS * velocity(time)


def lines(spectrum_: Spectrum) -> np.ndarray:
    return (spectrum_.effort / spectrum_.velocity)[spectrum_.line]


def taken_out(
    robot: Robot, effort: Signal, load: GearLoad = NO_LOAD, gain: float = 1.0, **effects: Parameters
) -> Corrected:
    axis: KnownAxis = known(lift=effects).of("lift")
    return corrected(measured(robot, effort), axis, gain, load)


IMPEDANCE = VISCOUS + 2j * np.pi * np.array([2.0, 3.0, 5.0]) * INERTIA


def test_effort_that_comes_late_is_taken_earlier(robot: Robot) -> None:
    late: Signal = lambda time: rigid(time - 1.3e-3)  # noqa: E731
    assert np.abs(lines(measured(robot, late)) / IMPEDANCE - 1).max() > 0.01
    done = taken_out(robot, late, measurement_delay={"delay": (1.3e-3, 1e-5)})
    np.testing.assert_allclose(lines(done.spectrum), IMPEDANCE, rtol=1e-9)
    # the effort that is one standard deviation less late is the column more
    other = taken_out(robot, late, measurement_delay={"delay": (1.29e-3, 1e-5)})
    np.testing.assert_allclose(
        other.spectrum.effort - done.spectrum.effort, done.uncertain[0], atol=1e-3 * np.abs(done.uncertain).max()
    )


@pytest.mark.parametrize(
    ("name", "told", "law"),
    [
        ("coulomb_friction", {"coulomb": (90.0, 2.0)}, lambda v: 90.0 * np.sign(v)),
        (
            "asymmetric_friction",
            {"coulomb": (90.0, 2.0), "coulomb_difference": (10.0, 1.0), "viscous_difference": (30.0, 1.0)},
            lambda v: 90.0 * np.sign(v) + 10.0 + 30.0 * np.abs(v),
        ),
        (
            "stribeck_friction",
            {"coulomb": (90.0, 2.0), "extra": (60.0, 3.0), "velocity": (0.01, 5e-4), "exponent": (1.5, 0.1)},
            lambda v: (90.0 + 60.0 * np.exp(-(np.abs(v / 0.01) ** 1.5))) * np.sign(v),
        ),
        (
            "nonlinear_viscous_friction",
            {"coefficient": (80.0, 2.0), "exponent": (0.6, 0.02)},
            lambda v: 80.0 * np.sign(v) * np.abs(v / 0.01) ** 0.6,
        ),
    ],
)
def test_friction_of_a_known_law_is_taken_out(robot: Robot, name: str, told: Parameters, law: Signal) -> None:
    known: dict[str, Any] = {name: told}
    rubbed: Signal = lambda time: rigid(time) + law(velocity(time))  # noqa: E731
    done = taken_out(robot, rubbed, **known)
    np.testing.assert_allclose(lines(done.spectrum), IMPEDANCE, rtol=1e-7)
    assert len(done.uncertain) == len(told)
    # recorded torques of a gain of 1.25 hold friction that is 1.25 times as large, and so does the model made of them
    larger = {key: (1.25 * v if key in ("coulomb", "extra", "coefficient") else v, s) for key, (v, s) in told.items()}
    if name != "asymmetric_friction":
        scaled: Signal = lambda time: 1.25 * rubbed(time)  # noqa: E731
        known = {name: larger}
        np.testing.assert_allclose(lines(taken_out(robot, scaled, gain=1.25, **known).spectrum), IMPEDANCE, rtol=1e-7)


def test_friction_that_grows_with_the_load_is_taken_out_where_gravity_rules(robot: Robot) -> None:
    heavy, light = GearLoad(100.0, -800.0, 300.0), GearLoad(100.0, -5.0, 0.0)

    def rubbed(load: GearLoad) -> Signal:
        def effort(time: np.ndarray) -> np.ndarray:
            turned = way(time) - way(np.array([START]))
            carried = load.gravity * np.cos(turned) + load.stiffness * np.sin(turned)
            carried += load.inertia * acceleration(time)
            return rigid(time) + (20.0 + 0.05 * np.abs(carried)) * np.sign(velocity(time))

        return effort

    law: Parameters = {"coulomb": (20.0, 1.0), "load_dependence": (0.05, 0.002)}
    done = taken_out(robot, rubbed(heavy), heavy, load_dependent_friction=law)
    np.testing.assert_allclose(lines(done.spectrum), IMPEDANCE, rtol=1e-7)
    assert done.doubt == 0.0
    doubtful = taken_out(robot, rubbed(light), light, load_dependent_friction=law)
    assert doubtful.doubt == pytest.approx(5.0)
    np.testing.assert_array_equal(lines(doubtful.spectrum), lines(measured(robot, rubbed(light))))


def test_what_cannot_be_used_changes_nothing(robot: Robot) -> None:
    done = taken_out(robot, rigid, stribeck_friction={"coulomb": (90.0, 1.0)}, backlash={"gap": (1e-3, 1e-4)})
    np.testing.assert_array_equal(done.spectrum.effort, measured(robot, rigid).effort)
    assert done.uncertain.shape == (0, len(done.spectrum.frequency))
