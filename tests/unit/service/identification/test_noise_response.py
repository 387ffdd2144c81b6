"""The reference makes the response unbiased in a loop; what a record must have to hold one."""

from dataclasses import replace

import numpy as np
import pytest

from service import BadInput
from service.identification.axis.drive_train import TwoMassTrain, impedance
from service.identification.spectra.noise_response import NoiseSpectrum, noise_response, noise_spectrum
from service.model import Recording, Robot, Sweep, SweepSpec

TRAIN = TwoMassTrain(58.0, 140.0, 60.0, 1 / 7.4e5, 1.2e-3)
FREQUENCY = np.arange(2, 60) / 1.6
Z = impedance(FREQUENCY, TRAIN, 250.0, 0.0).total
CONTROL = 6000.0 * (1 + 1 / (2j * np.pi * FREQUENCY * 0.25))  # softened PI


def spec(number: int, **changes: object) -> SweepSpec:
    return SweepSpec(
        id=f"{number:04}", axis="swing", pose=(0.0, 0.0), offset_velocity=0.01, excitation="noise", period=1.6,
        periods=3, measure_from=0.0, sample_rate=250.0,
    ).model_copy(update=changes)  # fmt: skip


def closed_loop(runs: int, disturbance: float, noise: float, seed: int = 1) -> list[NoiseSpectrum]:
    """Runs of three periods: the loop answers to the reference and to a disturbance of every period."""
    rng = np.random.default_rng(seed)

    def random(size: float) -> np.ndarray:
        return size * (rng.standard_normal((3, len(Z))) + 1j * rng.standard_normal((3, len(Z)))) / np.sqrt(2)

    found = []
    for number in range(runs):
        reference = np.tile(np.exp(2j * np.pi * rng.random(len(Z))), (3, 1))
        velocity = (reference - random(disturbance)) / (Z + CONTROL)
        effort = reference - CONTROL * velocity + random(noise)
        found.append(NoiseSpectrum(spec(number), FREQUENCY, reference, effort, velocity))
    return found


def test_the_reference_removes_the_bias_of_the_loop() -> None:
    """Without it the quotient is drawn to minus the controller, and more runs do not help."""
    runs = closed_loop(400, disturbance=1.0, noise=0.05)
    ours = noise_response(runs)
    effort, velocity = (np.concatenate([getattr(run, name) for run in runs]) for name in ("effort", "velocity"))
    naive = (effort * velocity.conj()).sum(axis=0) / (np.abs(velocity) ** 2).sum(axis=0)
    expected = (Z - CONTROL) / 2  # equal powers of reference and disturbance
    assert np.median(np.abs(naive / expected - 1)) < 0.1
    assert np.median(np.abs(ours.impedance / Z - 1)) < 0.1
    assert np.median(np.abs(naive / Z - 1)) > 0.4
    # one part is a run of three periods
    assert ours.coherence == pytest.approx(np.full(len(Z), 1 / (1 + 1 / 3)), abs=0.08)


def test_the_stated_variance_is_that_of_many_experiments() -> None:
    responses = [noise_response(closed_loop(6, 0.1, 0.05, seed)) for seed in range(200)]
    scatter = np.mean([np.abs(response.impedance - Z) ** 2 for response in responses], axis=0)
    stated = np.mean([response.variance(Z) for response in responses], axis=0)
    assert np.mean(stated / scatter) == pytest.approx(1.0, abs=0.1)


def test_periods_are_averaged_where_runs_are_few() -> None:
    two = noise_response(closed_loop(2, 0.1, 0.05))
    assert np.median(np.abs(two.impedance / Z - 1)) < 0.1
    one = closed_loop(1, 0.1, 0.05)[0]
    single = replace(one, reference=one.reference[:1], effort=one.effort[:1], velocity=one.velocity[:1])
    with pytest.raises(BadInput, match="one period alone"):
        noise_response([single])


def test_runs_of_other_lines_are_refused() -> None:
    runs = closed_loop(2, 0.1, 0.05)
    with pytest.raises(BadInput, match=r"sweep 0001: has other lines than sweep 0000"):
        noise_response([runs[0], replace(runs[1], frequency=FREQUENCY + 0.1)])


def recording(count: int = 1200) -> Recording:
    """A rigid axis whose effort has ripple and gravity's ramp on top of the injected torque's share."""
    time = np.arange(count) / 250.0
    velocity, effort, injected = np.full(count, 0.01), np.zeros(count), np.zeros(count)
    for line in range(2, 40):
        wave = 2j * np.pi * line / 1.6
        phase = np.exp(1j * (line**2 + wave.imag * time))
        injected += np.imag(phase)
        velocity += np.imag(phase / (wave * 200 + 300))
        effort += np.imag(phase)
    position = 0.3 + np.cumsum(velocity) / 250.0
    angle = 24 * 170.0 * position
    return Recording(time, effort + 8 * np.sin(angle) + 40 * time, velocity, position, excitation_effort=injected)


def test_ripple_and_drift_leave_the_lines(robot: Robot) -> None:
    found = noise_spectrum(robot, Sweep(spec(1), recording()))
    z = found.effort.mean(axis=0) / found.velocity.mean(axis=0)
    rigid = 2j * np.pi * found.frequency * 200 + 300
    assert len(found.frequency) == 38
    assert np.median(np.abs(z / rigid - 1)) < 0.01
    assert np.abs(z / rigid - 1).max() < 0.05


@pytest.mark.parametrize(
    ("changes", "columns", "reason"),
    [
        ({}, {"excitation_effort": None}, "no column excitation_effort"),
        ({"periods": None}, {}, "has no whole periods"),
        ({"period": 1.602}, {}, "not whole samples|not a whole number of samples"),
        ({"periods": 4}, {}, "leaves the record"),
        ({}, {"excitation_effort": np.zeros(1200)}, "has no lines"),
    ],
)
def test_records_that_hold_no_response(
    robot: Robot, changes: dict[str, object], columns: dict[str, object], reason: str
) -> None:
    with pytest.raises(BadInput, match=reason):
        noise_spectrum(robot, Sweep(spec(1, **changes), replace(recording(), **columns)))
