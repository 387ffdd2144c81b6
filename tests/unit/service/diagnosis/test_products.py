"""One filter for every signal, products that noise does not bias, a load behind a spring."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from service.diagnosis.effects.friction import law
from service.diagnosis.fit.cross_products import PLAIN, Group, Piece, between_periods, noise_model, pairing
from service.diagnosis.rows.periods import in_periods
from service.diagnosis.rows.signals import back, bins, derivative_spectrum, in_frequency, lowpass, row_samples
from service.model import Recording, Sweep, SweepSpec

RATE = 250.0


def test_the_filter_shifts_nothing_and_forgets_no_constant() -> None:
    time = np.arange(1000) / RATE
    slow = np.sin(2 * np.pi * 3.0 * time)
    filtered = lowpass(np.stack([np.full_like(time, 7.0), slow]), RATE)
    at = row_samples(1000, RATE)
    assert filtered[0] == pytest.approx(7.0)
    gain = np.exp(-0.5 * (3.0 / 20.0) ** 2)
    assert filtered[1] == pytest.approx(gain * slow[at], abs=2e-4)


def test_derivative_in_the_frequency_domain_also_of_a_record_that_ends_in_motion() -> None:
    """From standstill, as sweeps begin, it is right to the first sample; a jerk at the begin rings for 0.2 s."""
    time = np.arange(1500) / RATE
    smooth = (1 - np.cos(2 * np.pi * time) + 0.15 * time**2)[None]
    turning = 2 * np.pi * np.sin(2 * np.pi * time)
    assert in_frequency(smooth, RATE)[0, :-20] == pytest.approx((turning + 0.3 * time)[:-20], abs=2e-2)
    assert in_frequency(smooth, RATE)[0, 20:-20] == pytest.approx((turning + 0.3 * time)[20:-20], abs=2e-3)
    velocity = (1 - np.cos(2 * np.pi * time))[None] + 0.3 * time
    expected = turning + 0.3
    assert in_frequency(velocity, RATE)[0, 50:-20] == pytest.approx(expected[50:-20], abs=2e-3)
    late = np.exp(-2j * np.pi * bins(1500, RATE)[None] * 0.02)
    assert back(1500, derivative_spectrum(velocity, RATE) * late)[0, 50:-50] == pytest.approx(
        expected[45:-55], abs=5e-3
    )


def test_noise_of_regressors_does_not_bias_products_between_repeats() -> None:
    random = np.random.default_rng(3)
    true = random.normal(size=4000)
    columns = (true + random.normal(size=(3, 4000)))[..., None]
    group = Group(tuple(Piece(k, 0, 4000) for k in range(3)), 0)
    pairs = pairing(np.ones((3, 4000), dtype=bool), [group], 0, 1)
    across, same = pairs.products(columns)[0, 0, 0], float(np.sum(columns**2))
    assert pairs.rows == 12000
    assert across == pytest.approx(3 * float(true @ true), rel=0.05)
    assert same == pytest.approx(2 * across, rel=0.1)


def test_what_repeats_leave_is_whitened_to_unit_variance() -> None:
    random = np.random.default_rng(4)
    white = 5.0 * random.normal(size=(2, 6000))
    coloured = np.zeros_like(white)
    for n in range(1, 6000):
        coloured[:, n] = 0.9 * coloured[:, n - 1] + white[:, n]
    group = Group((Piece(0, 0, 6000), Piece(1, 0, 6000)), 0)
    whitened = noise_model(coloured, np.ones((2, 6000), dtype=bool), [group], np.eye(9)[0])(coloured)[:, 20:]
    assert whitened.std() == pytest.approx(1.0, abs=0.05)
    assert abs(np.mean(whitened[:, 1:] * whitened[:, :-1])) < 0.05
    assert np.array_equal(PLAIN(coloured), coloured)


def test_a_record_that_repeats_itself_is_cut_into_its_periods() -> None:
    time = np.arange(10_500) / 500.0
    velocity = np.sin(2 * np.pi * time / 6.0) + 0.5 * np.sin(2 * np.pi * time / 3.0 + 1.0)
    spec = SweepSpec(id="1", axis="slide", pose=(0.0,), offset_velocity=0.0, excitation="trajectory", sample_rate=500.0)
    cut = in_periods("slide", [Sweep(spec, Recording(time, velocity, velocity, velocity))])
    assert [sweep.spec.repeat for sweep in cut] == [0, 1, 2]
    assert all(len(sweep.recording.time) == pytest.approx(3000, abs=2) for sweep in cut)


@pytest.mark.parametrize("repeats", [1, 2, 3])
def test_gathered_products_are_those_between_different_repeats(repeats: int) -> None:
    random = np.random.default_rng(5)
    columns = random.normal(size=(repeats, 50, 2))
    group = Group(tuple(Piece(k, 0, 50) for k in range(repeats)), 0)
    pairs = pairing(np.ones((repeats, 50), dtype=bool), [group], 0, 1)
    couples = [(r, s) for r in range(repeats) for s in range(repeats) if r != s] or [(0, 0)]
    wanted = sum(columns[r].T @ columns[s] for r, s in couples) / max(repeats - 1, 1)
    gathered = pairs.gathered(np.moveaxis(columns, -1, 0))
    assert pairs.crossed(gathered, gathered)[0] == pytest.approx(wanted)
    assert pairs.products(columns)[0] == pytest.approx(wanted)


def test_noise_from_one_period_to_the_next_where_nothing_is_repeated() -> None:
    """Autocovariance of a first-order process by hand: s^2 a^k / (1 - a^2); what is periodic does not count."""
    random = np.random.default_rng(8)
    rows, period, keep = 20_000, 125, 0.8
    noise = np.zeros((4, rows))
    white = random.normal(size=noise.shape)
    for n in range(1, rows):
        noise[:, n] = keep * noise[:, n - 1] + white[:, n]
    left = noise + 30.0 * np.sin(2 * np.pi * 3 * np.arange(rows) / period)
    found = between_periods(left, np.ones(left.shape, dtype=bool), period)
    assert found is not None
    assert found[:4] == pytest.approx(keep ** np.arange(4) / (1 - keep**2), rel=0.05)


def test_less_than_two_periods_show_no_noise() -> None:
    usable = np.zeros((2, 240), dtype=bool)
    usable[:, :180] = True
    assert between_periods(np.ones((2, 240)), usable, 125) is None
    assert between_periods(np.ones((2, 240)), usable, 300) is None


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
    velocity = np.array([[motor(t)[1] for t in time]])
    found = back(len(time), derivative_spectrum(velocity, RATE) * follows)[0]
    size = np.abs(expected).max()
    assert found[:-50] == pytest.approx(expected[:-50], abs=0.01 * size)
    assert found[0] == pytest.approx(0.0, abs=0.01 * size)


def test_a_lubricant_that_thins_is_linear_when_slow_and_a_power_when_fast() -> None:
    """Carreau: x (1 + x^2)^((n - 1)/2), at x = 1 by hand 2^((n - 1)/2)."""
    assert law(np.array([0.1, -0.1]), 0.1, 0.5) == pytest.approx([2**-0.25, -(2**-0.25)])
    assert law(np.array([1e-5]), 0.1, 0.3) == pytest.approx([1e-4], rel=1e-6)
    assert law(np.array([100.0]), 0.1, 0.3) == pytest.approx([1000**0.3], rel=1e-5)
    assert law(np.array([0.7]), 0.1, 1.0) == pytest.approx([7.0])
