"""Predicted confidence: against the Cramer-Rao formula and against least squares written out."""

import numpy as np
import pytest

from service.identification.design.pose_selection import (
    EFFORT_NOISE,
    NOISE_RATE,
    SOFTEST,
    PredictedConfidence,
    needed,
    sweep_information,
    without_gain,
)
from service.model.recording import Sine

SINES = tuple(Sine(frequency=f, amplitude=a, phase=0.0) for f, a in ((2.0, 0.003), (3.0, 0.002), (5.0, 0.001)))
RATED, DURATION, LOAD = 3000.0, 5.0, 150.0


def rows_of_lines(stiffness_sigma: float) -> np.ndarray:
    """Whitened rows of Im Z in [J, c, k_g], and the prior of k_g as one row more."""
    omega = 2 * np.pi * np.array([sine.frequency for sine in SINES])
    amplitude = np.array([sine.amplitude for sine in SINES])
    samples = NOISE_RATE * DURATION
    std = EFFORT_NOISE * RATED * np.sqrt(2 / samples) / amplitude
    rows = np.stack([omega, omega**3 * LOAD**2, -1 / omega], -1) / std[:, None]
    return np.vstack([rows, [0, 0, 1 / stiffness_sigma]])


def test_with_inertia_alone_unknown_it_is_the_cramer_rao_bound() -> None:
    information = sweep_information(SINES, DURATION, RATED, LOAD, 1e-9)
    squares = sum((2 * np.pi * sine.frequency * sine.amplitude) ** 2 for sine in SINES)
    noise = EFFORT_NOISE * RATED
    assert 1 / information[0, 0] == pytest.approx(2 * noise**2 / (NOISE_RATE * DURATION * squares))


def test_an_unknown_gravity_stiffness_costs_what_it_costs_in_least_squares() -> None:
    rows = rows_of_lines(200.0)
    whole = np.linalg.inv(rows.T @ rows)[:2, :2]
    information = sweep_information(SINES, DURATION, RATED, LOAD, 200.0)
    assert np.linalg.inv(information) == pytest.approx(whole, rel=1e-6)


def test_near_the_locked_rotor_frequency_more_is_seen() -> None:
    rigid = sweep_information(SINES[:1], DURATION, RATED, LOAD, 1.0)
    elastic = sweep_information(SINES[:1], DURATION, RATED, LOAD, 1.0, locked_rotor=4.0)
    assert elastic[0, 0] == pytest.approx(rigid[0, 0] / (1 - 0.25) ** 4, rel=1e-3)


def test_confidence_is_that_of_the_whole_least_squares() -> None:
    """Two axes, three base parameters, six poses; all rows stacked and inverted at once."""
    rng = np.random.default_rng(0)
    rows, workspace = rng.normal(size=(6, 2, 3)), rng.normal(size=(50, 2, 3))
    inertia = rng.uniform(50, 200, (50, 2))
    about = rng.normal(size=(6, 2, 4, 2)) * [10.0, 1e6]  # whitened rows of [J, c]
    information = about.swapaxes(-1, -2) @ about
    predicted = PredictedConfidence(workspace, inertia, np.ones(3))
    percent = []
    for row, own in zip(rows, information, strict=True):
        predicted.add(row, own)
        percent.append(predicted.percent())
    prior = np.median(inertia, axis=0) * (2 * np.pi * SOFTEST) ** 2
    stacked = [np.concatenate([np.zeros(3), one]) for one in np.diag(prior)]
    for pose in range(6):
        for axis in range(2):
            for inertia_part, compliance_part in about[pose, axis]:
                row = np.zeros(5)
                row[:3] = inertia_part * rows[pose, axis]
                row[3 + axis] = compliance_part
                stacked.append(row)
    whole = np.array(stacked)
    covariance = np.linalg.inv(whole.T @ whole)[:3, :3]
    std = np.sqrt(np.einsum("wai,ij,waj->wa", workspace, covariance, workspace))
    assert percent[-1] == pytest.approx(100 * float((std / inertia).max()), rel=1e-6)
    assert percent[0] == np.inf  # two rows, three parameters
    assert percent[1:] == sorted(percent[1:], reverse=True)


def test_a_parameter_is_determined_where_the_sweeps_are_better_than_the_model() -> None:
    """One axis; each of two parameters has its own pose, and the compliance is known from its prior."""
    rows = np.eye(2)[:, None, :]
    workspace, inertia = np.ones((1, 1, 2)), np.full((1, 1), 100.0)
    predicted = PredictedConfidence(workspace, inertia, np.array([2.0, 2.0]))
    for row, std in zip(rows, (1.9, 2.1), strict=True):
        predicted.add(row, np.diag([std**-2, 0.0])[None])
    assert predicted.determined().tolist() == [True, False]
    assert np.isfinite(predicted.percent())  # of the sweeps alone
    predicted.add(rows[1], np.diag([2.1**-2, 0.0])[None])
    assert predicted.determined().tolist() == [True, True]


def test_confidence_and_open_parameters_are_told_by_axis() -> None:
    """Two axes; J of the first is b1, of the second b1 + b2; b1 is known to 1, b2 to 2 kg m^2."""
    rows = np.array([[[1.0, 0.0], [1.0, 1.0]]])
    predicted = PredictedConfidence(rows, np.full((1, 2), 100.0), np.array([5.0, 5.0]))
    stiff = np.diag([0.0, 1e30])  # compliance known
    predicted.add(np.eye(2), np.array([np.diag([1.0, 0.0]), np.diag([0.25, 0.0])]) + stiff)
    assert predicted.percent_by_axis() == pytest.approx([1.0, np.sqrt(5.0)])
    assert predicted.percent() == pytest.approx(np.sqrt(5.0))
    assert predicted.depending(np.array([True, False])).tolist() == [True, True]
    assert predicted.depending(np.array([False, True])).tolist() == [False, True]


def test_poses_that_a_confidence_does_not_need_are_found_from_the_last() -> None:
    """One parameter, which each pose shows with the std 2; two poses give 1.41 %, three 1.15 %."""
    pose = (np.ones((1, 1)), np.diag([0.25, 0.0])[None])
    predicted = PredictedConfidence(np.ones((1, 1, 1)), np.full((1, 1), 100.0), np.array([9.0]))
    for _ in range(5):
        predicted.add(*pose)
    assert needed(predicted, [pose] * 5, 1.2) == [0, 1, 2]
    assert predicted.percent() == pytest.approx(2 / np.sqrt(3))
    assert needed(predicted, [pose] * 3, 1.0) == [0, 1, 2]  # out of reach: all


def test_a_compliance_that_the_sweeps_must_find_costs_precision() -> None:
    """With correlation 0.8 of J and c, and c free, the variance of J is 1 / (1 - 0.64) of the one with c known."""
    softest = 1 / (100.0 * (2 * np.pi * SOFTEST) ** 2)
    scale = np.diag([1.0, 1e6 / softest])  # c is found much better than its prior
    about = scale @ np.array([[1.0, 0.8], [0.8, 1.0]]) @ scale
    for spread, determined in ((1.6, False), (1.7, True)):  # 1 / 0.6 = 1.67
        predicted = PredictedConfidence(np.ones((1, 1, 1)), np.full((1, 1), 100.0), np.array([spread]))
        predicted.add(np.ones((1, 1)), about[None])
        assert predicted.determined().tolist() == [determined]


def test_a_pose_that_sees_nothing_new_adds_nothing() -> None:
    assert without_gain([np.inf, np.inf, 2.0, 1.5, 1.499, 1.2]) == [4]
    # noise that averages out is a gain
    assert without_gain([1 / np.sqrt(n) for n in range(1, 300)]) == []
