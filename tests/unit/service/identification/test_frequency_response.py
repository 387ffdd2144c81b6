import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.model.errors import BadInput
from service.model.recording import Recording, Sine, Sweep, SweepSpec
from service.model.robot import Robot
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
    back = Spectrum.from_document(json.loads(json.dumps(result.to_document())))
    assert back.spec == result.spec
    for field in ("frequency", "line", "effort", "velocity", "regressors", "load_velocity"):
        assert np.array_equal(getattr(back, field), getattr(result, field))


def test_a_direct_encoder_in_degrees_is_refused(robot: Robot) -> None:
    sweep = _sweep()
    recording = replace(sweep.recording, load_position=np.degrees(sweep.recording.position))
    with pytest.raises(BadInput, match=r"load_position: moves 57\.3 times as far as position, limit 1 \+- 0\.5"):
        spectrum(robot, replace(sweep, recording=recording))
