"""Inertia of a speed loop and of a torque response: exact by formula, and standard deviations that hold."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

from service import BadInput
from service.identification.spectra import speed_loop
from service.identification.spectra.speed_loop import fit_closed_loop, fit_torque_response

OVER_GAIN, FRICTION, DELAY = 3.6e-3, 0.025, 0.7e-3  # J/K in s, mu/K, s
FREQUENCY = np.arange(1, 256) * 8000 / 2047
S = 2j * np.pi * FREQUENCY


def loop(reset_time: float | None = None) -> NDArray[np.complex128]:
    train = (OVER_GAIN * S + FRICTION) * np.exp(S * DELAY)
    opened = train if reset_time is None else train * reset_time * S / (1 + reset_time * S)
    return np.asarray(1 / (1 + opened), dtype=np.complex128)


@pytest.mark.parametrize("reset_time", [None, 0.05, 0.01])
def test_a_loop_by_formula_is_found_exactly(reset_time: float | None) -> None:
    fit = fit_closed_loop(FREQUENCY, loop(reset_time), "x", reset_time)
    assert fit.inertia == pytest.approx(OVER_GAIN, rel=1e-6)
    assert fit.friction == pytest.approx(FRICTION, rel=1e-4)
    assert fit.delay == pytest.approx(DELAY, rel=1e-4)
    assert fit.converged
    assert "condition is satisfied" in fit.ended


@pytest.mark.slow
def test_two_standard_deviations_hold() -> None:
    z: list[float] = []
    for seed in range(200):
        rng = np.random.default_rng(seed)
        noise = 0.02 * (rng.normal(size=len(S)) + 1j * rng.normal(size=len(S)))
        fit = fit_closed_loop(FREQUENCY, loop() + noise, "x")
        z.append((fit.inertia - OVER_GAIN) / fit.inertia_std)
    within = float(np.mean(np.abs(z) < 2))
    print(f"z: mean {np.mean(z):.2f}, scatter {np.std(z):.2f}; within 2 std {100 * within:.0f} %")
    assert within > 0.93
    assert 0.4 < np.std(z) < 1.1


def test_a_structure_that_the_model_lacks_is_in_the_deviation() -> None:
    """A mode at 80 Hz: rings in both directions alike, so no scatter between them shows it."""
    mode = 1 + 0.15 * S**2 / (S**2 + 2 * 0.05 * 500 * S + 500**2)
    fit = fit_closed_loop(FREQUENCY, loop() * mode, "x")
    print(f"J/K {100 * (fit.inertia / OVER_GAIN - 1):.1f} % off, std {100 * fit.inertia_std / fit.inertia:.1f} %")
    assert abs(fit.inertia - OVER_GAIN) < 2.5 * fit.inertia_std


def test_a_torque_response_tells_rotor_and_load_together() -> None:
    rotor, total, zero = 0.076, 0.147, 41.5
    frequency = np.linspace(1, 300, 600)
    s = 2j * np.pi * frequency
    swing = 1 / (1 - (frequency / zero) ** 2)
    response = 1 / (s * rotor + s * (total - rotor) * swing + 0.4)
    fit = fit_torque_response(frequency, response, "x", 5.5, zero, rotor)
    assert fit.inertia == pytest.approx(total, rel=1e-9)
    assert fit.friction == pytest.approx(0.4, rel=1e-9)
    assert fit.band == pytest.approx((5.5, zero / 2), abs=0.5)
    rigid = fit_torque_response(frequency, np.asarray(1 / (s * total + 0.4), dtype=np.complex128), "x")
    assert rigid.inertia == pytest.approx(total, rel=1e-9)


def test_what_shows_no_inertia_is_refused() -> None:
    with pytest.raises(BadInput, match="x: has 3 lines where the train is rigid and the loop follows, needs 12"):
        fit_closed_loop(FREQUENCY[:3], loop()[:3], "x")
    with pytest.raises(BadInput, match="y: has 0 lines"):
        fit_torque_response(FREQUENCY, loop(), "y", lowest=1e4)
    with pytest.raises(BadInput, match=r"x: shows no inertia from 3\.91 to"):
        fit_closed_loop(FREQUENCY, np.conj(loop()), "x")


@pytest.mark.parametrize("spoilt", [np.nan, np.inf])
def test_a_line_that_is_no_number_is_refused(spoilt: float) -> None:
    """A linear fit of NaN used to give NaN and call it converged; SciPy's error named no file."""
    response = loop()
    response[20] = spoilt
    with pytest.raises(BadInput, match=r"^x: 1 of 255 values of its response are not finite, the first is number 20"):
        fit_closed_loop(FREQUENCY, response, "x")
    with pytest.raises(BadInput, match=r"^y: 1 of 255 values of its response are"):
        fit_torque_response(FREQUENCY, response, "y")


def test_a_part_that_does_not_converge_leaves_no_standard_deviation(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fit of all lines converges; the one without its third stretch is cut short."""
    calls: list[int] = []

    def cut_short(*given: Any, **options: Any) -> Any:
        calls.append(1)
        return least_squares(*given, **options | ({"max_nfev": 2} if len(calls) == 4 else {}))

    monkeypatch.setattr(speed_loop, "least_squares", cut_short)
    with pytest.raises(BadInput, match=r"^x: the fit without its lines from 43 to 58\.6 Hz ended: The maximum number"):
        fit_closed_loop(FREQUENCY, loop(), "x")
