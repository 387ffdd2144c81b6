"""Sweeps by formula: the motion of an offset with sines, and the effort that a law makes of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.model import Recording, Sine, Sweep, SweepSpec

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Turning:
    """s, rad, rad/s, rad/s^2"""

    time: Array
    position: Array
    velocity: Array
    acceleration: Array


def turning(time: Array, offset: float, sines: Sequence[Sine], start: float = 0.0, place: float = 0.0) -> Turning:
    """`start`: when the phases are those of the sines, s; `place`, rad: what the sines swing about at time 0."""
    turn = 2 * np.pi * np.array([sine.frequency for sine in sines])
    amplitude, phase = (np.array([getattr(sine, name) for sine in sines]) for name in ("amplitude", "phase"))
    angle = np.outer(time - start, turn) + phase
    position = place + offset * time - np.cos(angle) @ (amplitude / turn)
    return Turning(time, position, offset + np.sin(angle) @ amplitude, np.cos(angle) @ (amplitude * turn))


def lines(frequencies: Sequence[float], amplitude: float) -> tuple[Sine, ...]:
    """Sines of one size, with phases of their own."""
    return tuple(Sine(frequency=f, amplitude=amplitude, phase=f) for f in frequencies)


def by_formula(
    effort: Callable[[Turning], Array], duration: float, swinging: Sequence[Sine] | None = None, place: float = 0.0,
    **fields: Any,
) -> Sweep:  # fmt: skip
    """`fields` of its entry in a bundle; `swinging`: the sines of the motion, where the entry has others."""
    spec = SweepSpec.model_validate(
        {"id": "0001", "offset_velocity": 0.0, "period": 1.0, "sample_rate": 500.0} | fields
    )
    time = np.arange(round(duration * spec.sample_rate)) / spec.sample_rate
    motion = turning(time, spec.offset_velocity, spec.sines if swinging is None else swinging, spec.measure_from, place)
    return Sweep(spec, Recording(time, effort(motion), motion.velocity, motion.position))
