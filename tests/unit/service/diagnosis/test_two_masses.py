"""A load behind a spring that starts from standstill, against an integration of its own; and a law of friction."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from service.diagnosis.effects.friction.nonlinear_viscous_friction import law
from service.diagnosis.rows.responses import bins, in_frequency

RATE = 250.0


def test_the_load_behind_a_spring_from_standstill() -> None:
    """J q_l'' = k (q_m - q_l) + h (v_m - v_l), k of a locked rotor of 12 Hz: its acceleration, as the response says."""
    inertia, time = 3.0, np.arange(1000) / RATE
    stiffness = inertia * (2 * np.pi * 12.0) ** 2
    damping = 0.1 * np.sqrt(stiffness * inertia)

    def motor(t: float) -> tuple[float, float]:
        """Position and velocity: from rest up to 0.4 rad/s with a swing of 5 Hz, and still moving at the end."""
        w, ramp = 2 * np.pi * 5.0, 1.0
        speed = 0.4 * (t - ramp / np.pi * np.sin(np.pi * t / ramp)) / 2 if t < ramp else 0.2 * ramp + 0.4 * (t - ramp)
        slow = 0.2 * (1 - np.cos(np.pi * t / ramp)) if t < ramp else 0.4
        return speed + 0.01 * (t - np.sin(w * t) / w), slow + 0.01 * (1 - np.cos(w * t))

    def rates(t: float, state: np.ndarray) -> list[float]:
        position, velocity = motor(t)
        return [state[1], (stiffness * (position - state[0]) + damping * (velocity - state[1])) / inertia]

    answer = solve_ivp(rates, (0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-10, atol=1e-12)
    expected = np.array([rates(t, state)[1] for t, state in zip(time, answer.y.T, strict=True)])
    s = 2j * np.pi * bins(len(time), RATE)[None]
    follows = (stiffness + damping * s) / (inertia * s**2 + damping * s + stiffness)
    found = in_frequency(np.array([[motor(t)[1] for t in time]]), RATE, follows)[0]
    size = np.abs(expected).max()
    assert found[:-50] == pytest.approx(expected[:-50], abs=0.01 * size)
    assert found[0] == pytest.approx(0.0, abs=0.01 * size)


def test_a_lubricant_that_thins_is_linear_when_slow_and_a_power_when_fast() -> None:
    """Carreau: x (1 + x^2)^((n - 1)/2), at x = 1 by hand 2^((n - 1)/2)."""
    assert law(np.array([0.1, -0.1]), 0.1, 0.5) == pytest.approx([2**-0.25, -(2**-0.25)])
    assert law(np.array([1e-5]), 0.1, 0.3) == pytest.approx([1e-4], rel=1e-6)
    assert law(np.array([100.0]), 0.1, 0.3) == pytest.approx([1000**0.3], rel=1e-5)
    assert law(np.array([0.7]), 0.1, 1.0) == pytest.approx([7.0])
