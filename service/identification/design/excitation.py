r"""Designs one sweep: a slow motion with superposed sines, within a few degrees of travel.

The set-point is e(t) (v0 + sum a_i sin(2 pi f_i (t - t0) + phi_i)) with a raised-cosine envelope e over `ramp`.

It follows from three rules (FRF measurement practice: Pintelon and Schoukens, System Identification, 2012, ch. 2 and
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
a line then has a random phase as well and scatters between realisations (`distortion`). The sum of the amplitudes,
which is limited by the no-reversal rule and the envelope, does not depend on phases.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from service.model.errors import BadInput
from service.model.recording import Sine
from service.model.robot import Axis, Robot

Array = NDArray[np.float64]

LINES = (2.0, 3.0, 4.0, 5.0)  # Hz, the paper's sweep frequencies
WINDOWS = (3, 5, 7)  # whole periods of 1 s; prime by the cogging rule
TRAVEL = math.radians(4.0)  # rad (m), most that a sweep may turn
RAMP = 0.5  # s
SETTLE = 0.5  # s
LOAD_MARGIN = 0.8  # of the offset that the sines may use on motor and load
CREST = 2.4  # highest crest factor of a random realisation; 4 lines of any phases have at most 2.83
DRAWS = 100  # of random phases
CREST_SAMPLES = 200  # of a period, in which the crest factor is looked at
LINE_MARGIN = 0.75  # of the locked-rotor frequency: no line above, but for the lowest


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
    travel: float = TRAVEL,
    velocity_limit: float = np.inf,
    effort_limit: float = np.inf,
) -> Excitation:
    """The sweep of `joint` in `pose` within `travel` rad (m). Raises BadInput if the limits leave no room for one.

    `load_inertia`: predicted inertia behind the spring, kg m^2 (kg); `locked_rotor_frequency`: predicted one at that
    inertia, Hz (None: the drive train is treated as stiff). `effort_limit`: limit of the effort of the sines alone,
    N m (N), after gravity and friction. `lines`, whole Hz, are used as given; None: those of the paper, without
    those too close to the locked-rotor frequency.
    """
    axis = robot.axis(joint)
    if not effort_limit > 0:
        raise BadInput(joint, f"effort limit {effort_limit:.4g} leaves no effort for the sines")
    if locked_rotor_frequency is not None and not locked_rotor_frequency > LINES[0]:
        raise BadInput(joint, f"locked rotor at {locked_rotor_frequency:.4g} Hz is not above {LINES[0]:.4g} Hz")
    highest = np.inf if locked_rotor_frequency is None else LINE_MARGIN * locked_rotor_frequency
    frequency = np.array(lines or [line for line in LINES if line <= highest] or LINES[:1])
    gain = np.ones_like(frequency)
    if locked_rotor_frequency is not None:
        gain = np.maximum(1.0, 1.0 / np.abs(1.0 - (frequency / locked_rotor_frequency) ** 2))
    share = LOAD_MARGIN / len(frequency) / gain  # amplitude of each line relative to the offset

    speed_limit = velocity_limit / (1.0 + float(share.sum()))
    periods, offset = max(
        (
            (periods, ripple_free_offset(axis, min(travel / (RAMP + SETTLE + periods), speed_limit), 1.0, periods))
            for periods in WINDOWS
        ),
        key=lambda choice: choice[1] ** 2 * choice[0],
    )
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
    return Excitation(direction * offset, sines, 1.0, periods, RAMP, SETTLE)


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
    time = np.linspace(0.0, excitation.period, CREST_SAMPLES, endpoint=False)
    frequency = np.array([sine.frequency for sine in excitation.sines])
    amplitude = np.array([sine.amplitude for sine in excitation.sines])
    phases = np.zeros(len(frequency))
    for _ in range(DRAWS):
        phases = rng.uniform(0.0, 2 * np.pi, len(frequency))
        shape = amplitude @ np.sin(2 * np.pi * frequency[:, None] * time + phases[:, None])
        if np.abs(shape).max() <= CREST * np.sqrt(np.sum(amplitude**2) / 2):
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
