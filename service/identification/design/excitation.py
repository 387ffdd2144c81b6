r"""Designs one sweep: a slow motion with superposed sines, within a few degrees of travel.

The set-point is e(t) (v0 + sum a_i sin(2 pi f_i (t - t0) + phi_i)) with a raised-cosine envelope e over `ramp`.

It follows from three rules (FRF measurement practice: Pintelon and Schoukens, System RobotEstimate, 2012, ch. 2 and
5):

Cogging. Torque ripple of order o (per motor revolution) appears at o u v0 / 2 pi Hz, and because the sines modulate the
motor angle also at whole-Hz distances from it. With a window of P whole seconds and  g u v0 P / 2 pi = n, g the common
divisor of the orders, every ripple line falls on (o/g) n / P Hz: orthogonal to the whole-Hz sines as long as no
(o/g) n is a multiple of the prime P. Orders that are not whole count as the nearest whole one.

No reversal. Friction is a constant only while nothing reverses, so  sum a_i max(1, |T_i|) < v0, where
T = 1 / (1 - (f/f_lr)^2) is the amplitude of the load over that of the motor below the locked-rotor frequency f_lr.

Travel. v0 (ramp + settle + P) stays within the travel; at fixed travel the standard deviation of J is proportional to
1 / (v0 sqrt(P)), so the fastest and shortest window allowed by the first rule is used.

Schroeder phases (1970), phi_i = -pi i (i - 1) / n, keep the crest factor low. Several realisations of one sweep have
random phases instead, uniform except that crest factors above CREST are drawn again: the response of a nonlinearity at
a line then has a random phase as well and scatters between realisations (`axis_estimate`). The sum of the amplitudes,
which is limited by the no-reversal rule and the envelope, does not depend on phases.

The path of a sweep: its velocity set-point integrated in closed form (paper, section 4.1).

Every part of the set-point (`excitation`) is c sin(w t + p), the offset with w = 0 and p = pi/2, times the envelope.
With k = pi / ramp and s the time since the start of the rise, the hold or the fall,

    rise   (1 - cos k s) / 2    hold   1    fall   (1 + cos k s) / 2
    cos(k s) sin(w s + p) = (sin((w + k) s + p) + sin((w - k) s + p)) / 2

so the only integral needed is  F(w, p, s) = int_0^s sin(w x + p) dx = s sin(p + w s / 2) sinc(w s / 2 pi),
which holds for every w, zero included.

Designs one noise run: a slow motion with superposed pseudo-random torque (paper, section 4.1).

The paper's values are used: offset 0.1 rpm, 1 % of the rated torque, band below 40 Hz, softened speed control. Two
rules change them. The offset is the next lower one for which cogging does not fall on the lines (`ripple_free_offset`).
And a light axis must not reverse, because friction is constant only in one direction: noise of RMS f over n lines moves
a free inertia J by

    v_rms = f / (2 pi J sqrt(n)) sqrt(sum 1/f_k^2),

which may be 0.2 of the offset. That is about the velocity in the softened loop with the resonance included;
random phases have peaks of 3 to 4 times their RMS.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from math import ceil, floor

import numpy as np

from service import BadInput
from service.model import Array, Axis, Robot, Sine


@dataclass(frozen=True)
class Sines:
    """How a sweep of sines is laid out."""

    lines: tuple[float, ...] = (2.0, 3.0, 4.0, 5.0)  # Hz, the paper's sweep frequencies
    travel: float = math.radians(4.0)  # rad (m), most that a sweep may turn
    settle: float = 0.5  # s
    load_margin: float = 0.8  # of the offset that the sines may use on motor and load
    crest: float = 2.4  # highest crest factor of a random realisation; 4 lines of any phases have at most 2.83
    line_margin: float = 0.75  # of the locked-rotor frequency: no line above, but for the lowest


RAMP = 0.5  # s


@dataclass(frozen=True, slots=True)
class Excitation:
    """One sweep from standstill to standstill; SI on the joint side (see the module docstring)."""

    offset_velocity: float  # rad/s (m/s), signed
    sines: tuple[Sine, ...]
    period: float  # s
    periods: int
    ramp: float  # s
    settle: float  # s

    @property
    def measure_from(self) -> float:
        """Start of the measured window, s."""
        return self.ramp + self.settle

    @property
    def duration(self) -> float:
        """From standstill to standstill, s."""
        return 2 * self.ramp + self.settle + self.periods * self.period

    @property
    def travel(self) -> float:
        """Signed travel from start to end, rad (m): the sines cancel over whole periods."""
        return self.offset_velocity * (self.ramp + self.settle + self.periods * self.period)


def design_sweep(
    robot: Robot,
    joint: str,
    pose: Array,
    *,
    load_inertia: float,
    lines: Sequence[float] | None = None,
    locked_rotor_frequency: float | None = None,
    direction: int = 1,
    travel: float = Sines.travel,
    velocity_limit: float = np.inf,
    effort_limit: float = np.inf,
    window: int | None = None,
) -> Excitation:
    """The sweep of `joint` in `pose` within `travel` rad (m). Raises BadInput if the limits leave no room for one.

    `load_inertia`: predicted inertia behind the spring, kg m^2 (kg); `locked_rotor_frequency`: predicted one at that
    inertia, Hz (None: the drive train is treated as stiff). `effort_limit`: limit of the effort of the sines alone,
    N m (N), after gravity and friction. `lines`, whole Hz, are used as given; None: those of the paper, without
    those too close to the locked-rotor frequency. `window`, s: of a simultaneous sweep, one period, with `lines` of
    `zippered_lines`; the offset puts the ripple on even multiples of 1/window.
    """
    axis = robot.axis(joint)
    if not effort_limit > 0:
        raise BadInput(joint, f"effort limit {effort_limit:.4g} leaves no effort for the sines")
    if locked_rotor_frequency is not None and not locked_rotor_frequency > Sines.lines[0]:
        raise BadInput(joint, f"locked rotor at {locked_rotor_frequency:.4g} Hz is not above {Sines.lines[0]:.4g} Hz")
    highest = np.inf if locked_rotor_frequency is None else Sines.line_margin * locked_rotor_frequency
    frequency = np.array(lines or [line for line in Sines.lines if line <= highest] or Sines.lines[:1])
    gain = np.ones_like(frequency)
    if locked_rotor_frequency is not None:
        gain = np.maximum(1.0, 1.0 / np.abs(1.0 - (frequency / locked_rotor_frequency) ** 2))
    share = Sines.load_margin / len(frequency) / gain  # amplitude of each line relative to the offset

    speed_limit = velocity_limit / (1.0 + float(share.sum()))

    def fastest(seconds: int) -> float:
        return min(travel / (RAMP + Sines.settle + seconds), speed_limit)

    if window is None:
        # whole periods of 1 s; prime by the cogging rule
        offsets = [(n, ripple_free_offset(axis, fastest(n), 1.0, n)) for n in (3, 5, 7)]
    else:
        offsets = [(window, _even_offset(axis, fastest(window), window))]
    seconds, offset = max(offsets, key=lambda choice: choice[1] ** 2 * choice[0])
    if offset <= 0:
        raise BadInput(
            f"{joint}", f"no sweep fits into a travel of {travel:.4g} and a velocity of {velocity_limit:.4g}"
        )
    inertia = load_inertia * gain + (axis.reflected_motor_inertia or 0.0)
    effort = float(np.sum(2 * np.pi * frequency * inertia * share)) * offset
    amplitudes = share * offset * min(1.0, effort_limit / effort if effort > 0 else 1.0)
    number = np.arange(len(frequency))
    phases = -np.pi * number * (number + 1) / len(frequency)
    sines = tuple(
        Sine(frequency=float(f), amplitude=float(a), phase=float(p % (2 * np.pi)))
        for f, a, p in zip(frequency, amplitudes, phases, strict=True)
    )
    period, periods = (1.0, seconds) if window is None else (float(window), 1)
    return Excitation(direction * offset, sines, period, periods, RAMP, Sines.settle)


def zippered_lines(axes: int) -> tuple[int, tuple[tuple[float, ...], ...]]:
    """The window, s, and the lines, Hz, of 2 to 6 axes that move at once, a low and a high one for each.

    All lines are odd multiples of 1/window between 2 and 5 Hz: their sums, differences and doubles are even, so no
    product of two motions has the frequency of a line. Triples are above 5 Hz. Two lines are what inertia and
    compliance need; more would have smaller amplitudes. Raises BadInput for another number of axes.
    """
    for window in (3, 5, 7, 9):  # s
        odd = [n / window for n in range(2 * window, 5 * window + 1) if n % 2]
        if 2 <= axes <= min(6, len(odd) // 2):
            return window, tuple(zip(odd[:axes], odd[-axes:], strict=True))
    raise BadInput("simultaneous sweep", f"{axes} axes; limits 2 and 6: choose other axes")


def realisations(excitation: Excitation, count: int, seed: Sequence[int]) -> tuple[Excitation, ...]:
    """`count` sweeps that differ only in their phases; for one: the sweep as designed. Another `seed` gives other
    phases.
    """
    if count == 1:
        return (excitation,)
    rng = np.random.default_rng(list(seed))
    return tuple(_with_random_phases(excitation, rng) for _ in range(count))


def _with_random_phases(excitation: Excitation, rng: np.random.Generator) -> Excitation:
    """The first draw of an acceptable crest factor, or the last of all draws."""
    # where the crest factor is looked at
    time = np.linspace(0.0, excitation.period, 200, endpoint=False)
    frequency = np.array([sine.frequency for sine in excitation.sines])
    amplitude = np.array([sine.amplitude for sine in excitation.sines])
    phases = np.zeros(len(frequency))
    for _ in range(100):  # draws
        phases = rng.uniform(0.0, 2 * np.pi, len(frequency))
        shape = amplitude @ np.sin(2 * np.pi * frequency[:, None] * time + phases[:, None])
        if np.abs(shape).max() <= Sines.crest * np.sqrt(np.sum(amplitude**2) / 2):
            break
    sines = tuple(
        sine.model_copy(update={"phase": float(phase)}) for sine, phase in zip(excitation.sines, phases, strict=True)
    )
    return replace(excitation, sines=sines)


def velocity_setpoint(excitation: Excitation, time: Array) -> Array:
    """Velocity set-point at `time` (n,), s from standstill; rad/s (m/s)."""
    rise = np.clip(time / excitation.ramp, 0.0, 1.0)
    fall = np.clip((excitation.duration - time) / excitation.ramp, 0.0, 1.0)
    envelope = (1 - np.cos(np.pi * np.minimum(rise, fall))) / 2
    shape = np.full_like(time, excitation.offset_velocity)
    for sine in excitation.sines:
        shape += sine.amplitude * np.sin(2 * np.pi * sine.frequency * (time - excitation.measure_from) + sine.phase)
    return envelope * shape


def ripple_free_offset(axis: Axis, fastest: float, period: float, periods: int) -> float:
    """The fastest offset up to `fastest` for which cogging does not fall on the lines of `periods` (prime) periods; 0:
    none.

    rad/s (m/s), s.
    """
    orders = tuple(max(1, round(order)) for order in axis.cogging_orders)
    if not orders:
        return fastest
    common = reduce(math.gcd, orders)
    step = 2 * np.pi / (common * abs(axis.gear_ratio) * period * periods)
    for n in range(int(fastest / step), 0, -1):
        if all((order // common) * n % periods for order in orders):
            return n * step
    return 0.0


def _even_offset(axis: Axis, fastest: float, window: int) -> float:
    """The fastest offset up to `fastest` for which every ripple has an even multiple of 1/window; rad/s (m/s)."""
    orders = [max(1, round(order)) for order in axis.cogging_orders]
    if not orders:
        return fastest
    step = 4 * np.pi / (reduce(math.gcd, orders) * abs(axis.gear_ratio) * window)
    return int(fastest / step) * step


def way(excitation: Excitation, time: Array) -> Array:
    """Position set-point relative to the start at `time` (n,), s from standstill; rad (m), exact. `ramp` is not 0."""
    hold = excitation.settle + excitation.periods * excitation.period
    rising = np.clip(time, 0.0, excitation.ramp)
    holding = np.clip(time - excitation.ramp, 0.0, hold)
    falling = np.clip(time - excitation.ramp - hold, 0.0, excitation.ramp)
    total = np.zeros_like(time)
    for amplitude, omega, phase in _parts(excitation):
        start = phase - omega * excitation.measure_from
        top = start + omega * excitation.ramp
        down = top + omega * hold
        total += amplitude * (
            _edge(omega, start, rising, np.pi / excitation.ramp, -1)
            + _integral(omega, top, holding)
            + _edge(omega, down, falling, np.pi / excitation.ramp, 1)
        )
    return total


def peak_jerk(excitation: Excitation) -> float:
    """Upper bound of the set-point's second derivative, rad/s^3 (m/s^3): product rule on envelope and waves."""
    bend = np.pi / excitation.ramp
    waves = [sum(abs(a) * omega**order for a, omega, _ in _parts(excitation)) for order in range(3)]
    return bend**2 / 2 * waves[0] + bend * waves[1] + waves[2]


def _parts(excitation: Excitation) -> list[tuple[float, float, float]]:
    """Amplitude, rad/s (m/s), angular frequency, rad/s, and phase at the window's start, rad, of every part."""
    offset = (excitation.offset_velocity, 0.0, np.pi / 2)
    return [offset, *((sine.amplitude, 2 * np.pi * sine.frequency, sine.phase) for sine in excitation.sines)]


def _edge(omega: float, phase: float, time: Array, bend: float, sign: int) -> Array:
    """The integral under (1 + sign cos(bend s)) / 2."""
    sides = _integral(omega + bend, phase, time) + _integral(omega - bend, phase, time)
    return _integral(omega, phase, time) / 2 + sign * sides / 4


def _integral(omega: float, phase: float, time: Array) -> Array:
    return time * np.sin(phase + omega * time / 2) * np.sinc(omega * time / (2 * np.pi))


@dataclass(frozen=True)
class Noise:
    """How a noise run is laid out."""

    offset: float = 0.1 * 2 * np.pi / 60  # rad/s (m/s)
    share: float = 0.01  # of the rated effort
    band: tuple[float, float] = (1.0, 39.0)  # Hz
    period: float = 1.6  # s; prime by the cogging rule
    periods: int = 3
    softening: float = 0.4


@dataclass(frozen=True, slots=True)
class NoiseExcitation(Excitation):
    """One noise run, without sines; fields as in `drivers.ports.NoiseCommand`."""

    effort: float  # N m (N), RMS
    lowest: float  # Hz
    highest: float  # Hz
    seed: int
    softening: float


def design_noise(
    robot: Robot, joint: str, *, inertia: float, travel: float, seed: int, direction: int = 1
) -> NoiseExcitation:
    """The noise run of a joint whose axis inertia is about `inertia`, kg m^2 (kg), within `travel` rad (m).

    Raises BadInput if cogging falls on its lines for every offset.
    """
    noise_ramp, noise_settle = 0.5, 1.0  # s
    axis = robot.axis(joint)
    (lowest, highest), period, periods = Noise.band, Noise.period, Noise.periods
    fastest = min(Noise.offset, travel / (noise_ramp + noise_settle + periods * period))
    offset = ripple_free_offset(axis, fastest, period, periods)
    if offset <= 0:
        raise BadInput(joint, f"no offset up to {fastest:.4g} keeps the axis' cogging off the lines of its noise")
    lines = np.arange(ceil(lowest * period), floor(highest * period) + 1, dtype=np.float64) / period
    sway = float(np.sqrt(np.mean(1 / lines**2))) / (2 * np.pi * inertia)  # per N m
    effort = min(Noise.share * axis.rated_effort, 0.2 * offset / sway)  # a fifth of the offset
    return NoiseExcitation(
        direction * offset, (), period, periods, noise_ramp, noise_settle, effort, *Noise.band, seed, Noise.softening
    )
