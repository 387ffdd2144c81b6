"""Which records are free motions of several axes, the filter, and the whitening of residuals."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service import BadInput
from service.identification.axis.drive_train import TwoMassTrain
from service.identification.estimates.combination import combine
from service.identification.estimation import estimate_document, sweep_spectrum
from service.identification.motion.equations import mean_sign
from service.identification.motion.fit import Colour
from service.identification.motion.free_motion import at_once, calibrated, free_motions, low_pass, memory, with_loads
from service.identification.spectra.frequency_response import stretches
from service.model import Recording, Robot, Sweep, SweepSpec
from tests.random_chain import random_arm

RATE = 200.0


def robot() -> Robot:
    return random_arm(3, 2, rated_effort=300.0)


def sweep(axis: str, samples: int = 400, **changes: object) -> Sweep:
    time = np.arange(samples) / RATE
    way = np.sin(time)
    spec = SweepSpec(
        id=f"{axis} {changes}",
        axis=axis,
        pose=(0.0, 0.0),
        offset_velocity=0.0,
        excitation="trajectory",
        sample_rate=RATE,
    )
    return Sweep(spec.model_copy(update=changes), Recording(time, 5 * way, np.cos(time), way))


def test_one_start_one_motion() -> None:
    both = [sweep("joint_2"), sweep("joint_1"), sweep("joint_1", started_at=9.0)]
    (record,) = free_motions(robot(), both)
    assert record.joints == ("joint_1", "joint_2")
    assert record.effort.shape == (400, 2)
    assert record.duration == pytest.approx(2.0)


@pytest.mark.parametrize(
    "changes", [{"started_at": 5.0}, {"pose": (0.0, 1.0)}, {"repeat": 1}, {"block": "b"}, {"excitation": "noise"}]
)
def test_another_start_is_another_motion(changes: dict[str, Any]) -> None:
    assert at_once([sweep("joint_1").spec, sweep("joint_2", **changes).spec]) == ()


@pytest.mark.parametrize(
    ("sweeps", "message"),
    [
        (
            [sweep("joint_1", id="a"), sweep("joint_1", id="b"), sweep("joint_2")],
            "another record of joint_1 starts with it at 0",
        ),
        ([sweep("joint_1"), sweep("joint_2", samples=300)], "number of samples 300 differs from 400"),
        ([sweep("joint_1", measure_from=1.8), sweep("joint_2", measure_from=1.8)], "fewer than 50 samples"),
    ],
)
def test_sweeps_that_are_no_motion_are_refused(sweeps: list[Sweep], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        free_motions(robot(), sweeps)


def test_an_estimate_of_single_axes_refuses_them() -> None:
    """With another axis moving, inertia about one alone would be wrong: it is refused, or taken as a free motion."""
    both = [sweep("joint_1"), sweep("joint_2")]
    spectra = [sweep_spectrum(robot(), one) for one in both]
    with pytest.raises(BadInput, match="moved while"):
        estimate_document(robot(), spectra)
    assert estimate_document(robot(), spectra, motions=free_motions(robot(), both)).axes == {}
    assert set(estimate_document(robot(), spectra[:1]).axes) == {"joint_1"}


def test_a_record_in_which_nothing_moves_is_refused() -> None:
    both = [sweep("joint_1"), sweep("joint_2")]
    still = [replace(s, recording=replace(s.recording, position=0 * s.recording.time)) for s in both]
    with pytest.raises(BadInput, match="no axis moves for more than"):
        combine(robot(), (), (), free_motions(robot(), still))


def test_gains_and_springs() -> None:
    (record,) = free_motions(robot(), [sweep("joint_1", samples=2000), sweep("joint_2", samples=2000)])
    assert calibrated(record, {"joint_2": 2.0}).effort[7] == pytest.approx(record.effort[7] / [1, 2])
    train = TwoMassTrain(3.0, 0.0, 0.0, 1e-3, 0.0)
    loads = with_loads(record, {"joint_1": train}).load_position
    # effort 5 sin t, acceleration -sin t: the spring carries 8 sin t
    inner = slice(100, -100)
    assert set(loads) == {"joint_1"}
    np.testing.assert_allclose(loads["joint_1"][inner], 0.992 * record.position[inner, 0], atol=1e-5)


def test_the_filter_passes_what_is_slow_and_differentiates_it() -> None:
    time = np.arange(2000) / RATE
    omega = 2 * np.pi * 2.0
    signal = 100.0 + np.sin(omega * time)
    inner = slice(round(2 * memory(20.0) * RATE), -round(2 * memory(20.0) * RATE))
    np.testing.assert_allclose(low_pass(signal, RATE, 20.0)[inner], signal[inner], atol=1e-5)
    np.testing.assert_allclose(low_pass(signal, RATE, 20.0, 1)[inner], omega * np.cos(omega * time)[inner], atol=1e-4)
    second = low_pass(signal, RATE, 20.0, 2)[inner]
    np.testing.assert_allclose(second, -(omega**2) * np.sin(omega * time)[inner], atol=2e-3)
    assert np.abs(low_pass(np.sin(2 * np.pi * 45.0 * time), RATE, 20.0)[inner]).max() < 1e-6


def test_the_filter_keeps_value_and_slope_at_the_ends() -> None:
    ramp = np.asarray(3.0 + 2.0 * np.arange(500) / RATE, dtype=float)
    np.testing.assert_allclose(low_pass(ramp, RATE, 10.0), ramp, atol=1e-5)
    np.testing.assert_allclose(low_pass(ramp, RATE, 10.0, 1), 2.0, atol=1e-5)


def test_the_sign_between_two_samples_counts_as_long_as_it_lasts() -> None:
    # speed crosses zero a quarter of a sample after the third one: its sample interval is -1/2 .. 1/2 about it
    velocity = np.array([-2.25, -1.25, -0.25, 0.75, 1.75])
    assert mean_sign(velocity) == pytest.approx([-1, -1, -0.5, 1, 1])
    assert mean_sign(np.zeros(4)) == pytest.approx(np.zeros(4))


def test_whitening_is_that_of_the_covariance() -> None:
    """An autoregressive process of first order, coefficient 0.8, variance 1: covariance 0.8^|i - j|."""
    rng = np.random.default_rng(0)
    noise = rng.standard_normal(40_000)
    noise[1:] *= 0.6
    for k in range(1, len(noise)):
        noise[k] += 0.8 * noise[k - 1]
    colour = Colour.of([noise[:25_000], noise[25_000:]], 0.0, len(noise))
    covariance = 0.8 ** np.abs(np.subtract.outer(np.arange(12), np.arange(12)))
    white = colour.whiten(np.eye(12)) @ covariance @ colour.whiten(np.eye(12)).T
    np.testing.assert_allclose(white, np.eye(12), atol=0.05)


def test_a_short_stretch_is_whitened_too() -> None:
    colour = Colour.of([np.array([1.0, -1.0])], 0.0, 2.0)
    assert len(colour.whiten(np.array([2.0]))) == 1
    assert colour.whiten(np.array([2.0])) == pytest.approx([2.0])


def test_stretches_are_runs() -> None:
    sound = np.array([True, True, False, True, False])
    assert stretches(sound) == [slice(0, 2), slice(3, 4)]
    assert stretches(np.zeros(3, dtype=bool)) == []
