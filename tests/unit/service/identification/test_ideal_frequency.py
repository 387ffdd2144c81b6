"""Fit and asymptotes on responses computed by hand from a known drive train."""

import json
from dataclasses import replace

import numpy as np
import pytest

from service import BadInput
from service.identification.axis.drive_train import TwoMassTrain, impedance
from service.identification.axis.ideal_frequency import InitialAnalysis, analyse_axis, nearest_line
from service.identification.axis.nominal_priors import PosePrior, SharedPrior
from service.identification.estimates.initial_analysis import analyses_document, analyses_from
from service.identification.spectra.noise_response import FrequencyResponse
from service.model.results import estimate as results

pytestmark = pytest.mark.slow

TRAIN = TwoMassTrain(58.0, 300.0, 150.0, 1 / 7.4e5, 1.2e-3)
LOADS = (140.0, 200.0, 330.0, 600.0)
FREQUENCY = np.arange(2, 63) / 1.6
PRIOR = SharedPrior(
    np.array([55.0, 250.0, 250.0, 0.0, 1e-3]), np.diag(np.square([5.5, 250.0, 250.0, 1 / (200 * 350.0), 2e-3]))
)


STIFF = replace(TRAIN, compliance=0.0)


def response(load: float, noise: float, rng: np.random.Generator, train: TwoMassTrain = TRAIN) -> FrequencyResponse:
    z = impedance(FREQUENCY, train, load, 0.0).total
    velocity = 1 / (z + 5000.0)
    error = noise * (rng.standard_normal(len(z)) + 1j * rng.standard_normal(len(z))) / np.sqrt(2)
    covariance = np.zeros((len(z), 2, 2), dtype=complex)
    covariance[:, 0, 0] = max(noise, 1e-9) ** 2
    return FrequencyResponse(FREQUENCY, z * velocity + error, velocity, covariance, np.ones(len(z)))


def analysis(
    noise: float = 0.01, seed: int = 1, loads: tuple[float, ...] = LOADS, train: TwoMassTrain = TRAIN
) -> InitialAnalysis:
    rng = np.random.default_rng(seed)
    priors = [PosePrior(np.array([1.2 * load, 0.0, 0.0]), np.array([0.6 * load, 1.0, 1.0])) for load in loads]
    poses = [(0.0, float(k)) for k in range(len(loads))]
    return analyse_axis("swing", poses, [response(load, noise, rng, train) for load in loads], PRIOR, priors)


@pytest.mark.slow
def test_the_drive_train_is_found_within_its_standard_deviations() -> None:
    found = np.array([analysis(seed=seed).mean for seed in range(40)])
    stated = np.sqrt(np.diag(analysis().covariance))
    off = (found - TRAIN.as_array()) / stated
    assert np.abs(off.mean(axis=0)).max() < 0.6
    assert off.std(axis=0) == pytest.approx(np.ones(5), abs=0.35)
    assert analysis().chi_squared == pytest.approx(1.0, abs=0.2)


def test_frequencies_of_a_pose_by_both_ways() -> None:
    for pose, load in zip(analysis(noise=1e-5).poses, LOADS, strict=True):
        resonance, corner = TRAIN.locked_rotor_frequency(load), 450.0 / (2 * np.pi * (load + 58.0))
        assert pose.fit.locked_rotor.value == pytest.approx(resonance, rel=1e-3)
        assert pose.fit.corner.value == pytest.approx(corner, rel=1e-2)
        assert pose.fit.frequency.value == pytest.approx(np.sqrt(resonance * corner), rel=1e-2)
        assert pose.fit.sweep_frequency == nearest_line(np.sqrt(resonance * corner))
        assert pose.asymptotes.locked_rotor.value == pytest.approx(resonance, abs=0.4)
        assert pose.asymptotes.inertia.value == pytest.approx(load + 58.0, rel=0.2)
        assert pose.asymptotes.corner.value == pytest.approx(corner, rel=0.3)


@pytest.mark.parametrize(
    ("frequency", "line"), [(0.3, 2.0), (2.4, 2.0), (2.6, 3.0), (4.4, 4.0), (9.0, 5.0), (np.inf, 5.0)]
)
def test_ideal_frequencies_are_rounded_to_the_papers(frequency: float, line: float) -> None:
    assert nearest_line(frequency) == line


def test_classes_of_poses_and_their_lines() -> None:
    light, heavy = analysis().classes
    assert (light.name, heavy.name) == ("light", "heavy")
    assert light.inertia_up_to == pytest.approx(np.sqrt(198.0 * 658.0), rel=0.02)
    assert light.locked_rotor == pytest.approx(TRAIN.locked_rotor_frequency(330.0), rel=0.02) or (
        light.locked_rotor == pytest.approx(TRAIN.locked_rotor_frequency(200.0), rel=0.02)
    )
    assert heavy.locked_rotor == pytest.approx(TRAIN.locked_rotor_frequency(600.0), rel=0.02)
    assert analysis().lines(140.0) == (2.0, 3.0, 4.0, 5.0)
    assert analysis().lines(600.0) == (2.0, 3.0, 4.0)  # locked rotor at 5.6 Hz
    assert [each.name for each in analysis(loads=(200.0, 210.0)).classes] == ["all"]


@pytest.mark.parametrize("seed", range(6))  # noise decides whether the spring found is very stiff or none at all
def test_of_a_stiff_train_only_lower_bounds_are_told(seed: int) -> None:
    stiff = analysis(seed=seed, train=STIFF)
    for pose in stiff.poses:
        last, ideal = pose.at_least or (0.0, 0.0)
        assert last == FREQUENCY[-1] == 38.75
        assert ideal == pytest.approx(np.sqrt(38.75 * pose.fit.corner.value))
        assert np.isfinite([pose.fit.inertia.std, pose.fit.corner.std]).all()
        assert np.isinf(pose.fit.frequency.std) == np.isinf(pose.fit.locked_rotor.std)
        assert np.isinf(pose.fit.frequency.std) == np.isinf(pose.fit.frequency.value)
    assert all(pose.at_least is None for pose in analysis(seed=seed).poses)


def test_documents_keep_the_prior_exactly() -> None:
    given = {"swing": analysis()}
    document = analyses_document(given)
    text = json.dumps({joint: axis.as_json() for joint, axis in document.items()}, allow_nan=False)
    read = {joint: results.AxisAnalysis.read(axis, joint) for joint, axis in json.loads(text).items()}
    back = analyses_from(read)
    assert np.array_equal(back["swing"].mean, given["swing"].mean)
    assert np.array_equal(back["swing"].covariance, given["swing"].covariance)
    assert back["swing"].classes == given["swing"].classes
    assert back["swing"].lines(330.0) == given["swing"].lines(330.0)
    again = analyses_document(back)["swing"].poses[0].frequency_response[5]
    assert again.re == document["swing"].poses[0].frequency_response[5].re


def few(full: FrequencyResponse) -> FrequencyResponse:
    """Of three lines."""
    return FrequencyResponse(
        full.frequency[:3], full.effort[:3], full.velocity[:3], full.covariance[:3], full.coherence[:3]
    )


def spoilt(full: FrequencyResponse, value: float) -> FrequencyResponse:
    return replace(full, effort=np.where(np.arange(len(full.effort)) == 7, value, full.effort))


GOOD = response(140.0, 0.01, np.random.default_rng(1))


@pytest.mark.parametrize(
    ("responses", "message"),
    [
        ([few(GOOD)], r"^swing: 6 equations of its frequency responses for 7 unknowns"),
        ([GOOD, spoilt(GOOD, np.nan)], r"^swing: \d+ of 61 values of its frequency response in pose 2 are not finite"),
        ([GOOD, spoilt(GOOD, np.inf)], r"^swing: \d+ of 61 values of its frequency response in pose 2 are not finite"),
        (  # without noise: a weight of infinity, of which SciPy's error named no axis
            [replace(GOOD, covariance=np.zeros((61, 2, 2), dtype=complex))],
            r"^swing: 61 of 61 values of the weight of its frequency response in pose 1 are not finite",
        ),
    ],
)
def test_responses_that_tell_nothing_are_refused_with_their_pose(
    responses: list[FrequencyResponse], message: str
) -> None:
    priors = [PosePrior(np.array([140.0, 0.0, 0.0]), np.array([70.0, 1.0, 1.0]))] * len(responses)
    with pytest.raises(BadInput, match=message):
        analyse_axis("swing", [(float(k),) for k in range(len(responses))], responses, PRIOR, priors)
