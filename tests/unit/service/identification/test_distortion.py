"""Noise and distortion apart: against the variance that theory gives for friction that is quadratic in speed.

Friction mu v + c (v - v0)^2 of v = v0 + sum a_i sin(w_i t + phi_i) has c a_i a_j at w_i +- w_j and c a_i^2 / 2 at 2 w_i
beside its linear part. Of 2, 3, 4 and 5 Hz that falls onto

    2 Hz: a_2 a_4 and a_3 a_5;   3 Hz: a_2 a_5;   4 Hz: a_2^2 / 2;   5 Hz: a_2 a_3

with phases that are independent over realisations; a bin holds half of an amplitude.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from service.identification.axis.axis_estimate import AxisEstimate
from service.identification.design.excitation import (
    Excitation,
    Sines,
    design_sweep,
    realisations,
    velocity_setpoint,
)
from service.identification.estimates.document import as_document
from service.identification.estimates.estimate import identify
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.model import Recording, Robot, Sweep
from tests.numeric.campaign import spec_of

pytestmark = pytest.mark.slow

RATE, VISCOUS, NOISE = 500.0, 200.0, 2.0
QUADRATIC = 1e5  # N m s^2/rad^2


def truth(pose: float) -> float:
    """Inertia about the vertical axis, motor included: the arm's reach goes with the cosine."""
    return 18.0 + 40.0 + 57.8 + 150.0 * (0.3 + 1.2 * np.cos(pose)) ** 2


def sweep_of(robot: Robot, pose: float, seed: int, count: int) -> tuple[Excitation, ...]:
    excitation = design_sweep(robot, "swing", np.array([0.0, pose]), load_inertia=300.0)
    return realisations(excitation, count, [seed])


def recorded(robot: Robot, excitation: Excitation, number: int, pose: float, columns: Sequence[np.ndarray]) -> Spectrum:
    spec = spec_of(excitation, number, "swing", (0.0, pose), RATE)
    time, effort, velocity, position = columns
    return spectrum(robot, Sweep(spec, Recording(time, effort, velocity, position)))


def prescribed(robot: Robot, poses: Sequence[float], count: int, seed: int, quadratic: float) -> list[Spectrum]:
    """Rigid sweeps that follow their set-point exactly; `count` realisations in each pose."""
    rng = np.random.default_rng(seed)
    spectra: list[Spectrum] = []
    for place, pose in enumerate(poses):
        for excitation in sweep_of(robot, pose, 1000 * seed + place, count):
            time = np.arange(round(excitation.duration * RATE)) / RATE
            fine = velocity_setpoint(excitation, np.linspace(0.0, time[-1] + 1 / RATE, 20 * len(time) + 1))
            velocity = velocity_setpoint(excitation, time)
            position = (np.cumsum(fine)[::20][: len(time)] - fine[0]) / (20 * RATE)
            acceleration = np.gradient(fine, 1 / (20 * RATE))[::20][: len(time)]
            effort = truth(pose) * acceleration + VISCOUS * velocity
            effort += quadratic * (velocity - excitation.offset_velocity) ** 2
            effort += rng.normal(0, NOISE, len(time))
            columns = (time, effort, velocity, position)
            spectra.append(recorded(robot, excitation, len(spectra), pose, columns))
    return spectra


def axis_of(robot: Robot, spectra: Sequence[Spectrum]) -> AxisEstimate:
    (axis,) = identify(robot, spectra).axes
    return axis


POSES = tuple(np.linspace(-1.0, 1.0, 12))


def test_realisations_differ_in_their_phases_alone(robot: Robot) -> None:
    several = sweep_of(robot, 0.0, 7, 6)
    assert len({one.sines for one in several}) == 6
    assert sweep_of(robot, 0.0, 7, 6) == several
    (designed,) = sweep_of(robot, 0.0, 7, 1)
    time = np.linspace(0, 1, 1000, endpoint=False)
    for one in several:
        same = tuple(
            sine.model_copy(update={"phase": own.phase}) for sine, own in zip(one.sines, designed.sines, strict=True)
        )
        assert replace(one, sines=same) == designed
        shape = sum(s.amplitude * np.sin(2 * np.pi * s.frequency * time + s.phase) for s in one.sines)
        assert np.abs(shape).max() < 1.02 * Sines.crest * np.sqrt(np.mean(shape**2))
        assert velocity_setpoint(one, np.linspace(1.0, 4.0, 3000)).min() > 0  # never reverses, whatever the phases


def test_noise_and_distortion_are_those_of_theory(robot: Robot) -> None:
    spectra = prescribed(robot, POSES, 4, 1, QUADRATIC)
    found = axis_of(robot, spectra).distortion
    assert found is not None
    assert (found.realisations, found.groups) == (4, len(POSES))
    a = {sine.frequency: sine.amplitude for sine in spectra[0].spec.sines}
    wanted = {
        2.0: np.hypot(a[2.0] * a[4.0], a[3.0] * a[5.0]),
        3.0: a[2.0] * a[5.0],
        4.0: a[2.0] ** 2 / 2,
        5.0: a[2.0] * a[3.0],
    }
    for frequency, amplitude in wanted.items():
        place = int(np.flatnonzero(np.isclose(found.frequency, frequency))[0])
        part = QUADRATIC * amplitude / 2 / np.sqrt(2)
        print(f"{frequency} Hz: distortion {found.distortion[place]:.4f} N m, theory {part:.4f}")
        assert found.distortion[place] == pytest.approx(part, rel=0.35)
        # 36 complex values of spread: one standard deviation of the estimate is a tenth
    lines = np.isin(found.frequency, list(wanted))
    samples = spectra[0].samples
    assert found.noise[lines] == pytest.approx(np.full(4, NOISE / np.sqrt(2 * samples)), rel=0.15)


def test_without_a_nonlinearity_there_is_no_distortion(robot: Robot) -> None:
    found = axis_of(robot, prescribed(robot, POSES, 4, 2, 0.0)).distortion
    assert found is not None
    # of a variance that is the difference of two equal ones, on 36 values: up to half of the noise by chance
    assert np.median(found.distortion / found.noise) < 0.5
    assert found.distortion.max() < found.noise.max()
    assert axis_of(robot, prescribed(robot, POSES, 1, 2, 0.0)).distortion is None


def test_repeats_are_no_realisations(robot: Robot) -> None:
    spectra = prescribed(robot, POSES[:4], 1, 3, QUADRATIC)
    twice = [replace(one, spec=one.spec.model_copy(update={"id": f"{one.spec.id}-again"})) for one in spectra]
    assert axis_of(robot, [*spectra, *twice]).distortion is None


@pytest.mark.slow
def test_standard_deviations_are_honest_under_distortion(robot: Robot) -> None:
    """RMS of error over standard deviation of J: with several realisations 1.

    One alone takes the distortion at the multiples of 1 Hz without sines for noise everywhere, and knows J better than
    it says.
    """

    def z(count: int, seeds: range) -> float:
        squares: list[float] = []
        for seed in seeds:
            axis = axis_of(robot, prescribed(robot, POSES, count, seed, QUADRATIC))
            assert axis.fit is not None
            wanted = np.repeat([truth(pose) for pose in POSES], count)
            squares += list((axis.fit.inertia - wanted) ** 2 / np.diag(axis.fit.covariance))
        return float(np.sqrt(np.mean(squares)))

    alone, several = z(1, range(20, 26)), z(4, range(20, 26))
    print(f"error of J over its standard deviation, RMS: {alone:.2f} of one realisation, {several:.2f} of four")
    assert 0.75 < several < 1.3
    assert alone < 0.6


def test_the_document_tells_both_parts(robot: Robot) -> None:
    estimate = identify(robot, prescribed(robot, POSES[:6], 3, 5, QUADRATIC))
    axis = as_document(estimate, estimate.workspace).axes["swing"]
    assert axis.distortion is not None
    assert (axis.distortion.realisations, axis.distortion.poses) == (3, 6)
    assert {entry.frequency for entry in axis.distortion.effort} >= {2.0, 3.0, 4.0, 5.0, 6.0}
    for line in (line for sweep in axis.inertia for line in sweep.frequency_response):
        assert line.noise_std is not None
        assert line.distortion_std is not None
        assert line.noise_std > 0
        assert line.std == pytest.approx(np.hypot(line.noise_std, line.distortion_std))
