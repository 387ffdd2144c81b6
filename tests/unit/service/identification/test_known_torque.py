"""Known effects are taken out of a sweep: against efforts written down in the time domain, where all is exact."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from service.identification.axis.known_effects import Corrected, GearLoad, KnownAxis, corrected, motion_of
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.model.recording import Sine
from service.model.robot import Robot
from tests.formula_sweep import by_formula, turning
from tests.unit.service.identification.known import Parameters, known

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


def test_the_motion_is_known_from_its_bins(robot: Robot) -> None:
    motion = motion_of(measured(robot, rigid), GearLoad(100.0, 50.0, 20.0))
    time = START + np.arange(5000) / RATE
    turned = way(time) - way(time[:1])
    np.testing.assert_allclose(motion.velocity, velocity(time), atol=1e-12)
    np.testing.assert_allclose(motion.way, turned, atol=1e-12)
    wanted = 100.0 * acceleration(time) + 50.0 * np.cos(turned) + 20.0 * np.sin(turned)
    np.testing.assert_allclose(motion.transmitted, wanted, atol=1e-9)


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
