"""The joint fit on an exact linear two-mass plant (scipy's lsim, no code of ours), and its derivatives."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.signal import lsim

from service import BadInput
from service.identification.axis import joint_fit
from service.identification.axis.drive_train import SHARED, TwoMassTrain, direct_terms, effort_residual
from service.identification.axis.joint_fit import FitEnded, complete_prior, fit_axis
from service.identification.axis.nominal_priors import PosePrior, SharedPrior
from service.identification.design.excitation import design_sweep, velocity_setpoint
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.model import Recording, Robot, Sweep
from tests.formula_sweep import Turning, by_formula, lines
from tests.numeric.campaign import spec_of

pytestmark = pytest.mark.slow

TRAIN = TwoMassTrain(60.0, 130.0, 80.0, 1 / 6e5, 1e-3)
LOADS = np.linspace(110.0, 560.0, 8)
NOMINAL_MOTOR = 57.0


def _measure(
    robot: Robot,
    number: int,
    load: float,
    noise: float,
    rng: np.random.Generator,
    periods: int | None = None,
    *,
    encoder: bool = False,
) -> Spectrum:
    """A speed-controlled two-mass axis with gravity stiffness, started at rest, sampled at 1 kHz; `encoder`: one on the
    load too, with 1e-6 rad of noise.
    """
    excitation = design_sweep(
        robot,
        "lift",
        np.zeros(2),
        load_inertia=load,
        locked_rotor_frequency=TRAIN.locked_rotor_frequency(load),
    )
    k, gravity = 1 / TRAIN.compliance, 400.0 * np.cos(number)
    d = TRAIN.damping_time * k
    proportional = 2 * np.pi * 20 * (TRAIN.motor_inertia + load)
    integral = 20 * proportional
    jm, mm, ml = TRAIN.motor_inertia, TRAIN.motor_friction, TRAIN.load_friction
    # states: motor speed, load speed, twist, control integral, load angle, motor angle
    a = np.array(
        [
            [-(mm + d + proportional) / jm, d / jm, -k / jm, integral / jm, 0, 0],
            [d / load, -(ml + d) / load, k / load, 0, -gravity / load, 0],
            [1, -1, 0, 0, 0, 0],
            [-1, 0, 0, 0, 0, 0],
            [0, 1, 0, 0, 0, 0],
            [1, 0, 0, 0, 0, 0],
        ]
    )
    b = np.array([[proportional / jm], [0], [0], [1], [0], [0]])
    c = np.array([[-proportional, 0, 0, integral, 0, 0], [1, 0, 0, 0, 0, 0], [0, 0, 0, 0, 0, 1], [0, 0, 0, 0, 1, 0]])
    time = np.arange(round(excitation.duration * 4000)) / 4000
    _, out, _ = lsim((a, b, c, [[proportional], [0], [0], [0]]), velocity_setpoint(excitation, time), time)
    effort, velocity, position, at_load = out[::4].T
    spec = spec_of(excitation, number, "lift", (0.0, 0.0), periods=periods or excitation.periods)
    effort = effort + rng.normal(0, noise, len(effort))
    load_position = at_load + rng.normal(0, 1e-6, len(at_load)) if encoder else None
    return spectrum(robot, Sweep(spec, Recording(time[::4], effort, velocity, position, load_position=load_position)))


def _measured(robot: Robot, seed: int, noise: float = 6.0, periods: int | None = None) -> list[Spectrum]:
    rng = np.random.default_rng(seed)
    return [_measure(robot, number, load, noise, rng, periods) for number, load in enumerate(LOADS)]


def _priors() -> tuple[SharedPrior, list[PosePrior]]:
    sigma = np.array([5.7, 100.0, 100.0, 1e-5, 2e-3])
    shared = SharedPrior(np.array([NOMINAL_MOTOR, 100.0, 100.0, 0.0, 1e-3]), np.diag(sigma**2))
    return shared, [PosePrior(np.array([1.15 * load, 0.0, 0.0]), np.array([load, 500.0, 500.0])) for load in LOADS]


@pytest.mark.parametrize("seed", range(3))
def test_recovers_the_inertia_of_an_elastic_axis(robot: Robot, seed: int) -> None:
    spectra = _measured(robot, seed)
    fit = fit_axis(spectra, *_priors(), noise_guess=6.0)
    truth = LOADS + TRAIN.motor_inertia
    error, std = fit.inertia / truth - 1, np.sqrt(np.diag(fit.covariance)) / truth
    assert np.median(np.abs(error)) < 0.006
    assert np.abs(error).max() < 0.02
    assert np.all(np.abs(error) < 4.5 * std)
    assert fit.noise * np.sqrt(2 * 3000) == pytest.approx(np.full(len(LOADS), 6.0), rel=0.15)
    resonance = [fit.train.locked_rotor_frequency(load) for load in fit.load_inertia]
    np.testing.assert_allclose(resonance, [TRAIN.locked_rotor_frequency(load) for load in LOADS], rtol=0.03)


@pytest.mark.parametrize("with_encoder", [len(LOADS), len(LOADS) - 1, 2])
def test_sweeps_without_a_direct_encoder_have_the_spring_from_the_others(robot: Robot, with_encoder: int) -> None:
    """The effort alone knows the compliance to 1.5 %, and without the others' encoder it would be that of one sweep."""
    away: list[float] = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        spectra = [
            _measure(robot, k, load, 6.0, rng, encoder=k >= len(LOADS) - with_encoder) for k, load in enumerate(LOADS)
        ]
        fit = fit_axis(spectra, *_priors(), noise_guess=6.0)
        assert fit.train_std[3] < 0.01 * TRAIN.compliance
        away += [(fit.train.compliance - TRAIN.compliance) / fit.train_std[3]]
        own = (fit.inertia - LOADS - TRAIN.motor_inertia) / np.sqrt(np.diag(fit.covariance))
        away += list(own[: len(LOADS) - with_encoder])
    assert np.abs(away).max() < 4.0
    assert np.sqrt(np.mean(np.square(away))) < 1.5


def test_derivatives_equal_difference_quotients(robot: Robot) -> None:
    spectrum_ = _measure(robot, 1, 300.0, 5.0, np.random.default_rng(0))
    shared = TRAIN.as_array()
    own = np.concatenate([[310.0, 250.0, -120.0, 0.4, 0.02], np.full(len(direct_terms(spectrum_)), 1.5)])
    _, by_shared, by_own = effort_residual(spectrum_, shared, own)
    for analytic, values, of_shared in ((by_shared, shared, True), (by_own, own, False)):
        for k, value in enumerate(values):
            step = 1e-5 * abs(value)
            up, down = values.copy(), values.copy()
            up[k] += step
            down[k] -= step
            pair = [
                effort_residual(spectrum_, side, own)[0] if of_shared else effort_residual(spectrum_, shared, side)[0]
                for side in (up, down)
            ]
            quotient = -(pair[0] - pair[1]) / (2 * step)
            scale = np.abs(quotient).max()
            np.testing.assert_allclose(analytic[:, k] / scale, quotient / scale, atol=2e-6)


def test_a_single_period_still_gives_an_answer(robot: Robot) -> None:
    """A bundle written by hand may have one period only: few bins more than unknowns, priors carry the rest."""
    spectra = _measured(robot, 3, noise=2.0, periods=1)
    fit = fit_axis(spectra, *_priors(), noise_guess=2.0)
    error = fit.inertia / (LOADS + TRAIN.motor_inertia) - 1
    assert np.abs(error).max() < 0.1
    assert np.isfinite(fit.covariance).all()


def test_reversing_about_standstill_costs_dry_friction_not_inertia(robot: Robot) -> None:
    """Effort = J dv/dt + mu v + Fc sign(v) by formula: the sign is a regressor of its own."""
    told = {"axis": "swing", "pose": (0.0, 0.0), "sines": lines((2.0, 3.0, 5.0), 0.01), "periods": 5}

    def effort(m: Turning, load: float) -> np.ndarray:
        return (load + NOMINAL_MOTOR) * m.acceleration + 150 * m.velocity + 80 * np.sign(m.velocity)

    spectra = [
        spectrum(robot, by_formula(partial(effort, load=load), 5.0, id=f"{number:04}", sample_rate=1000.0, **told))
        for number, load in enumerate(LOADS)
    ]
    fit = fit_axis(spectra, *_priors(), noise_guess=1.0)
    np.testing.assert_allclose(fit.inertia, LOADS + NOMINAL_MOTOR, rtol=2e-3)


def test_the_stacked_fit_is_the_least_of_the_plain_sum(robot: Robot) -> None:
    """Sweeps of three lengths, two of them with a direct encoder: SciPy on the sum over single sweeps agrees.

    The prior of the spring is that of the fit: data sheet and encoders.
    """
    rng = np.random.default_rng(8)
    spectra = [_measure(robot, k, load, 6.0, rng, periods=3 - (k == 4)) for k, load in enumerate(LOADS[:6])]
    for k in (1, 2):
        amplified = 1 / (1 - (spectra[k].frequency / TRAIN.locked_rotor_frequency(LOADS[k])) ** 2)
        spectra[k] = replace(spectra[k], load_velocity=amplified * spectra[k].velocity)
    shared, poses = _priors()
    fit = fit_axis(spectra, shared, poses[:6], noise_guess=6.0)
    priors = [complete_prior(*pair) for pair in zip(spectra, poses[:6], strict=True)]
    mean, root = fit.priors.mean, np.linalg.cholesky(fit.priors.precision).T
    edges = np.cumsum([SHARED, *(len(prior.mean) for prior in priors)])

    def rows(values: np.ndarray) -> np.ndarray:
        parts = [root @ (values[:SHARED] - mean)]
        for one, prior, noise, a, b in zip(spectra, priors, fit.noise, edges[:-1], edges[1:], strict=True):
            residual = effort_residual(one, values[:SHARED], values[a:b])[0] / noise
            parts += [residual.real, residual.imag, (values[a:b] - prior.mean) / prior.sigma]
        return np.concatenate(parts)

    start = np.concatenate([shared.mean, *(prior.mean for prior in priors)])
    start[3] = 1 / (300 * (2 * np.pi * 11) ** 2)
    plain = least_squares(rows, start, method="lm", x_scale="jac", xtol=1e-14, ftol=1e-14)
    # SciPy's difference quotients stop a little short of the least
    away = fit.inertia - plain.x[edges[:-1]] - plain.x[0]
    assert np.abs(away / np.sqrt(np.diag(fit.covariance))).max() < 0.1
    jacobian = np.asarray(plain.jac, dtype=float)
    information = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
    pick = np.zeros((6, len(start)))
    pick[:, 0] = 1.0
    pick[range(6), edges[:-1]] = 1.0
    np.testing.assert_allclose(fit.covariance, pick @ covariance @ pick.T, rtol=0.02, atol=0.02)


def test_the_noise_of_a_spoiled_sweep_is_its_own(robot: Robot) -> None:
    spectra = _measured(robot, 6)
    sound = fit_axis(spectra, *_priors(), noise_guess=6.0)
    assert (sound.weight == 1).all()
    spike = np.exp(-2j * np.pi * spectra[3].frequency * 0.7)
    spectra[3] = replace(spectra[3], effort=spectra[3].effort + spike)
    fit = fit_axis(spectra, *_priors(), noise_guess=6.0)
    assert np.flatnonzero(fit.weight < 1).tolist() == [3]
    np.testing.assert_allclose(np.delete(fit.noise, 3), np.delete(sound.noise, 3), rtol=0.05)
    assert fit.noise[3] > 5 * fit.noise[2]
    others = np.delete(np.arange(8), 3)
    assert np.abs(fit.inertia - sound.inertia)[others].max() < 0.8 * np.sqrt(np.diag(sound.covariance)).min()


def test_a_prior_may_be_correlated(robot: Robot) -> None:
    """Motor and load friction cannot be told apart by sweeps, but an analysis may know their sum."""
    spectra = _measured(robot, 2)
    shared, poses = _priors()
    covariance = shared.covariance.copy()
    covariance[1, 2] = covariance[2, 1] = -0.9999 * covariance[1, 1]
    mean = shared.mean + np.array([0, 5, 5, 0, 0])
    fit = fit_axis(spectra, SharedPrior(mean, covariance), poses, noise_guess=6.0)
    assert fit.train.motor_friction + fit.train.load_friction == pytest.approx(210, abs=3)


def test_what_is_no_number_is_refused_with_its_sweep(robot: Robot) -> None:
    spectra = _measured(robot, 1)
    shared, poses = _priors()
    spoiled = [one if number != 3 else replace(one, effort=one.effort * np.nan) for number, one in enumerate(spectra)]
    with pytest.raises(BadInput, match=r"^sweep 0003 of lift: has no finite residual"):
        fit_axis(spoiled, shared, poses, 6.0)


def test_a_fit_that_does_not_converge_tells_nothing(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    spectra = _measured(robot, 2)
    shared, poses = _priors()
    assert fit_axis(spectra, shared, poses, 6.0).ended in (FitEnded.CONVERGED, FitEnded.AT_REST)
    monkeypatch.setattr(joint_fit.FitLimits, "iterations", 1)
    monkeypatch.setattr(joint_fit.FitLimits, "rounds", 1)
    with pytest.raises(BadInput, match=r"^lift: its fit over 8 sweeps did not converge: the cost still falls after"):
        fit_axis(spectra, shared, poses, 6.0)


def test_derivatives_that_overflow_are_refused_with_the_axis(robot: Robot) -> None:
    """Residuals in standard deviations of 1e-150 are numbers, their derivatives squared are not."""
    spectra = _measured(robot, 1)
    shared, poses = _priors()
    with np.errstate(all="ignore"), pytest.raises(BadInput, match=r"^lift: has no finite residual or derivative"):
        fit_axis(spectra, shared, poses, 1e-146)


def test_the_noise_has_settled_in_the_last_round(robot: Robot) -> None:
    spectra = _measured(robot, 1)
    for guess in (0.6, 6.0, 600.0):
        assert fit_axis(spectra, *_priors(), guess).noise_change.max() < 1e-4
