"""The sweeps of a case: both directions slow and fast, about standstill, a wide band; each twice, the first pose again
last; before everything two holds. All sweeps of a case last equally long, so that they are stepped side by side.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.model import Sine, SweepSpec

Array = NDArray[np.float64]
Random = np.random.Generator

RAMP = 0.5  # s, smooth
WIDE_SETS = ((3.0, 7.0, 12.0, 17.0), (3.0, 5.0, 7.0, 11.0, 13.0, 17.0), (4.0, 9.0, 13.0, 16.0))  # Hz
REVERSAL_SETS = ((1.0, 2.0, 3.0), (2.0, 3.0, 5.0))  # Hz
SLOW_LINES = (2.0, 3.0, 5.0)  # Hz


@dataclass(frozen=True)
class Plan:
    """What is run: specs, and what they have in common; s, Hz."""

    specs: tuple[SweepSpec, ...]
    rate: float
    window: float  # s
    run_out: float  # s after the measured window, 0: the record ends with it
    measure_from: float

    @property
    def duration(self) -> float:
        return self.measure_from + self.window + self.run_out

    @property
    def poses(self) -> Array:
        return np.array([spec.pose for spec in self.specs])


@dataclass(frozen=True)
class Motion:
    """Commanded speed, its derivative and its integral, (steps, sweeps)."""

    velocity: Array
    acceleration: Array
    position: Array  # from each sweep's start


def plan(
    random: Random, joint: str, index: int, limits: Array, inertia: float, rated: float, *, small: bool = False
) -> Plan:
    """A plan for one axis; `limits` (n, 2) of all; `inertia`, kg m^2, with the motor; `small`: half as many sweeps."""
    count = 3 if small else int(random.integers(4, 7))
    slow = random.uniform(0.03, 0.045)
    wide_lines = WIDE_SETS[random.integers(len(WIDE_SETS))]
    reversal_lines = REVERSAL_SETS[random.integers(len(REVERSAL_SETS))]
    wide_name = str(random.choice(["wide", "high_band"]))
    again = str(random.choice(["revisit_{}", "{}_again"]))
    amplitude = 0.8 * slow / len(SLOW_LINES)
    wide = 0.8 * slow / len(wide_lines)
    wide *= min(1.0, 0.35 * rated / (inertia * 2 * np.pi * wide * sum(wide_lines)))
    reversal = 0.8 * slow / len(reversal_lines)
    blocks = {
        "forward_slow": (slow, _sines(SLOW_LINES, amplitude, random)),
        "backward_slow": (-slow, _sines(SLOW_LINES, amplitude, random)),
        "forward_fast": (3 * slow, _sines(SLOW_LINES, 1.8 * amplitude, random)),
        "backward_fast": (-3 * slow, _sines(SLOW_LINES, 1.8 * amplitude, random)),
        "reversal": (0.0, _sines(reversal_lines, reversal, random)),
        wide_name: (slow, _sines(wide_lines, wide, random)),
    }
    poses = _poses(random, index, limits, count)
    visits = [(pose, name, name) for pose in poses for name in blocks]
    last = list(blocks) if random.random() < 0.5 and not small else ["forward_slow", "backward_slow"]
    visits += [(poses[0], name, again.format(name)) for name in last]
    rate = float(random.choice([500.0, 1000.0, 1000.0, 1000.0, 2000.0]))
    common = {"axis": joint, "sample_rate": rate, "measure_from": 1.0}

    def specs() -> Iterator[SweepSpec]:
        clock, number = 20.0, 0
        for repeat in range(2):
            number += 1
            yield SweepSpec(
                id=f"{number:04}", pose=tuple(poses[0].tolist()), offset_velocity=0.0, excitation="standstill",
                started_at=clock, repeat=repeat, block="hold", **common,
            )  # fmt: skip
            clock += 6.0
        before = None
        for pose, name, label in visits:
            clock += 15.0 if before is not pose else 0.0
            before = pose
            offset, sines = blocks[name]
            for repeat in range(2):
                number += 1
                yield SweepSpec(
                    id=f"{number:04}", pose=tuple(pose.tolist()), offset_velocity=offset, sines=sines, period=1.0,
                    periods=2, started_at=clock, repeat=repeat, block=label, **common,
                )  # fmt: skip
                clock += 8.0

    return Plan(tuple(specs()), rate, 2.0, 0.0 if random.random() < 0.5 else 0.6, 1.0)


def followed(planned: Plan, later: Sequence[SweepSpec]) -> Plan:
    """The plan with further sweeps, of any length, after its own."""
    longest = max((spec_end(spec) for spec in later), default=0.0)
    run_out = max(planned.run_out, longest - planned.measure_from - planned.window)
    return replace(planned, specs=(*planned.specs, *later), run_out=run_out)


def spec_end(spec: SweepSpec) -> float:
    """When a further sweep stands again, s."""
    return spec.measure_from + (spec.period or 0.0) * (spec.periods or 0) + RAMP


def motion(planned: Plan, step: float) -> Motion:
    """What the controls ask for at every step of `step` s."""
    time = np.arange(round(planned.duration / step) + 1) * step
    ends = [s.measure_from + (s.period or planned.window) * (s.periods or 1) for s in planned.specs]
    gates = [_smooth(time / RAMP) * (1.0 - _smooth((time - end) / RAMP)) for end in ends]
    velocity = np.array([gate * _speed(spec, time) for gate, spec in zip(gates, planned.specs, strict=True)]).T
    acceleration = np.gradient(velocity, step, axis=0)
    travel = np.cumsum((velocity[1:] + velocity[:-1]) * step / 2, axis=0)
    return Motion(velocity, acceleration, np.vstack([np.zeros(velocity.shape[1]), travel]))


def _speed(spec: SweepSpec, time: Array) -> Array:
    since = time - spec.measure_from
    waves = [s.amplitude * np.sin(2 * np.pi * s.frequency * since + s.phase) for s in spec.sines]
    return spec.offset_velocity + np.sum(waves, axis=0) + np.zeros_like(time)


def _smooth(share: Array) -> Array:
    share = np.clip(share, 0.0, 1.0)
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def _sines(lines: tuple[float, ...], amplitude: float, random: Random) -> tuple[Sine, ...]:
    return tuple(
        Sine(frequency=line, amplitude=float(amplitude), phase=round(float(random.uniform(0, 2 * np.pi)), 3))
        for line in lines
    )


def _poses(random: Random, index: int, limits: Array, count: int) -> Array:
    """The moving axis spread over its range, in any order; the others anywhere."""
    low, high = limits[:, 0] + 0.45, limits[:, 1] - 0.45
    poses = random.uniform(low, high, (count, len(limits)))
    spread = (random.permutation(count) + random.uniform(0.2, 0.8, count)) / count
    poses[:, index] = low[index] + spread * (high[index] - low[index])
    return np.round(poses, 4)
