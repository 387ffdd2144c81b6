import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service import BadInput
from service.identification.estimation import spectrum_from, sweep_spectrum
from service.identification.motion.free_motion import free_motions
from service.identification.motion.trajectory_record import AxisTrack, axis_track
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.identification.spectra.noise_response import NoiseSpectrum, noise_spectrum
from service.model import Recording, Robot, Sine, Sweep, SweepSpec
from tests.formula_sweep import by_formula

RATE = 250.0


def _sweep(**changes: object) -> Sweep:
    """2 and 5 Hz on an offset, three periods of 1 s; effort = 300 dv/dt + 40 v + 7 exactly."""
    sines = (Sine(frequency=2, amplitude=0.004), Sine(frequency=5, amplitude=0.002, phase=1.0))
    window = {"sines": sines, "periods": 3, "measure_from": 0.4, "sample_rate": RATE}
    fields: dict[str, Any] = {"axis": "lift", "pose": (0.0, 0.2), "offset_velocity": 0.02} | window | changes
    return by_formula(lambda m: 300 * m.acceleration + 40 * m.velocity + 7, 4.4, place=0.2, **fields)


def test_lines_carry_amplitude_phase_and_impedance(robot: Robot) -> None:
    result = spectrum(robot, _sweep())
    assert result.samples == 750
    np.testing.assert_allclose(result.frequency[result.line], [2.0, 5.0])
    np.testing.assert_allclose(np.abs(result.velocity[result.line]), [0.002, 0.001], rtol=1e-9)
    expected = 40 + 2j * np.pi * np.array([2.0, 5.0]) * 300
    np.testing.assert_allclose((result.effort / result.velocity)[result.line], expected, rtol=1e-9)
    assert np.abs(result.velocity[~result.line]).max() < 1e-12
    assert np.diff(result.frequency) == pytest.approx(1 / 3)


def test_regressors_are_the_dfts_of_the_signals(robot: Robot) -> None:
    sweep = _sweep()
    result = spectrum(robot, sweep)
    part = slice(100, 850)
    way = sweep.recording.position[part] - 0.2
    row = int(np.flatnonzero(np.isclose(result.frequency, 3.0))[0])
    kernel = np.exp(-2j * np.pi * 3.0 * np.arange(750) / RATE) / 750
    assert result.named("gravity_stiffness")[0, row] == pytest.approx(kernel @ np.sin(way))
    assert result.named("ripple")[2, row] == pytest.approx(kernel @ np.cos(48 * 170.0 * sweep.recording.position[part]))
    assert not len(result.named("coulomb"))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"periods": 5}, "sweep 0001: window of 1250 samples from 0.4 s leaves the record of 1100 samples"),
        ({"sines": ({"frequency": 2.1, "amplitude": 0.1},)}, "not a whole multiple of 0.333333 Hz"),
        ({"period": 0.9999}, "not whole samples at 250.0 Hz"),
        ({"axis": "elbow"}, "elbow: unknown joint; robot pair has swing, lift"),
    ],
)
def test_what_cannot_be_analysed_is_refused(robot: Robot, changes: dict[str, object], reason: str) -> None:
    good = _sweep()
    sweep = Sweep(SweepSpec.model_validate({**good.spec.model_dump(), **changes}), good.recording)
    with pytest.raises(BadInput, match=reason):
        spectrum(robot, sweep)


def _with_load(sweep: Sweep, factor: float) -> Recording:
    """A load that swings `factor` times as wide as the motor about the same slow turn, 5 mrad behind."""
    time, spec = sweep.recording.time, sweep.spec
    ramp = 0.2 + spec.offset_velocity * time
    return replace(sweep.recording, load_position=ramp + factor * (sweep.recording.position - ramp) - 0.005)


@pytest.mark.parametrize("periods", [3, 4])
def test_a_direct_encoder_gives_the_speed_of_the_load(robot: Robot, periods: int) -> None:
    """Differentiated without a difference quotient; with four periods the window ends with the record."""
    sweep = _sweep(periods=periods)
    result = spectrum(robot, replace(sweep, recording=_with_load(sweep, 1.2)))
    assert result.load_velocity is not None
    np.testing.assert_allclose(
        result.load_velocity[result.line], 1.2 * result.velocity[result.line], rtol=1e-6 if periods == 3 else 5e-3
    )
    assert np.abs(result.load_velocity[~result.line]).max() < (1e-8 if periods == 3 else 3e-5)
    told = replace(sweep.recording, load_velocity=1.2 * sweep.recording.velocity)
    from_speed = spectrum(robot, replace(sweep, recording=told)).load_velocity
    assert from_speed is not None
    np.testing.assert_allclose(from_speed, 1.2 * result.velocity, atol=1e-12)


def test_a_direct_encoder_in_degrees_is_refused(robot: Robot) -> None:
    sweep = _sweep()
    recording = replace(sweep.recording, load_position=np.degrees(sweep.recording.position))
    with pytest.raises(BadInput, match=r"load_position: moves 57\.3 times as far as position, limit 1 \+- 0\.5"):
        spectrum(robot, replace(sweep, recording=recording))


@pytest.mark.parametrize(
    ("kind", "changes", "columns"),
    [
        (Spectrum, {}, ()),
        (Spectrum, {}, ("load_velocity",)),
        (NoiseSpectrum, {"excitation": "noise"}, ("excitation_effort",)),
        (AxisTrack, {"excitation": "trajectory", "offset_velocity": 0.0}, ()),
        (AxisTrack, {"excitation": "trajectory", "period": 3.0, "periods": 1}, ("load_position",)),
    ],
)
def test_a_stored_spectrum_has_every_number(
    robot: Robot, kind: type, changes: dict[str, object], columns: tuple[str, ...]
) -> None:
    sweep = _sweep(**changes)
    told = {name: getattr(sweep.recording, name.split("_")[1]) for name in columns}
    found = sweep_spectrum(robot, replace(sweep, recording=replace(sweep.recording, **told)))
    assert isinstance(found, kind)
    stored: Any = json.loads(json.dumps(found.to_document()))
    np.testing.assert_equal(vars(spectrum_from(stored)), vars(found))


def _motions(robot: Robot, sweep: Sweep) -> object:
    sound = replace(sweep.recording, effort=sweep.recording.velocity)
    other = Sweep(sweep.spec.model_copy(update={"id": "0002", "axis": "swing"}), sound)
    return free_motions(robot, [other, sweep])


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize(
    ("read", "column"),
    [
        (spectrum, "velocity"),
        (noise_spectrum, "excitation_effort"),
        (lambda _, sweep: axis_track(sweep), "position"),
        (_motions, "effort"),
    ],
)
def test_a_sample_that_is_no_number_is_refused_with_its_sweep(
    robot: Robot, read: Callable[[Robot, Sweep], object], column: str, value: float
) -> None:
    """It used to spread over all bins, and by the filter over the whole record."""
    sweep = _sweep(excitation="trajectory", sines=(), period=None, periods=None)
    spoilt = sweep.recording.effort.copy()
    spoilt[17] = value
    with pytest.raises(BadInput, match=rf"^sweep 0001 of lift: {column} is not a number at sample 17"):
        read(robot, replace(sweep, recording=replace(sweep.recording, **{column: spoilt})))
