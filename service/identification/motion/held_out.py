"""Prediction error of a fit of free motions on held-out parts of them.

Each of `FOLDS` parts in turn is left out of all records and predicted from the rest. The noise floor, below which no
model error can fall, is the difference between runs of the same motion, half of its power in each; None if no motion
was run twice.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from service.identification.model.least_squares import Information
from service.identification.motion.equations import AxisEquations
from service.identification.motion.fit import FreeFit
from service.identification.motion.free_motion import FreeMotion
from service.robot import Robot

Array = NDArray[np.float64]

FOLDS = 5


@dataclass(frozen=True)
class HeldOut:
    """RMS of one axis below the band's end, N m (N): `residual` of the fit, `error` of parts held out, `floor`."""

    residual: float
    error: float
    floor: float | None


def held_out(
    robot: Robot, records: Sequence[FreeMotion], fit: FreeFit, others: Information, start: Array
) -> dict[str, HeldOut]:
    """By joint. `others`: information without the free motions, including the nominal model's prior."""
    values = fit.information.plus(others).solve(start).values
    errors: dict[str, list[Array]] = {}
    for fold in range(FOLDS):
        left = others
        for each, white in zip(fit.equations, fit.white, strict=True):
            kept = _fold(white.time, each) != fold
            rows = white.rows[kept]
            left = left.plus(Information(rows.T @ rows, rows.T @ white.values[kept]))
        without = left.solve(start).values
        for each in fit.equations:
            out = each.sound & (_fold(each.time, each) == fold)
            errors.setdefault(each.joint, []).append(each.values[out] - each.rows[out] @ without)
    return {
        joint: HeldOut(
            residual=_rms([each.values - each.rows @ values for each in _of(fit, joint)], _of(fit, joint)),
            error=float(np.sqrt(np.mean(np.concatenate(parts) ** 2))),
            floor=_floor(records, _of(fit, joint), values),
        )
        for joint, parts in errors.items()
        if any(len(part) for part in parts)
    }


def _of(fit: FreeFit, joint: str) -> list[AxisEquations]:
    return [each for each in fit.equations if each.joint == joint]


def _fold(time: Array, each: AxisEquations) -> NDArray[np.int_]:
    return np.minimum((FOLDS * time / each.time[-1]).astype(int), FOLDS - 1)


def _rms(signals: Sequence[Array], parts: Sequence[AxisEquations]) -> float:
    kept = np.concatenate([signal[each.sound] for signal, each in zip(signals, parts, strict=True)])
    return float(np.sqrt(np.mean(kept**2)))


def _floor(records: Sequence[FreeMotion], parts: Sequence[AxisEquations], values: Array) -> float | None:
    """Difference between runs of the same motion, minus the modelled effect of the difference of their paths."""
    squares: list[Array] = []
    for one, other in combinations(parts, 2):
        if records[one.record].same_motion(records[other.record]):
            both = one.sound & other.sound
            difference = one.values - other.values - (one.rows - other.rows) @ values
            squares.append(difference[both] ** 2 / 2)
    kept = np.concatenate(squares) if squares else np.zeros(0)
    return float(np.sqrt(np.mean(kept))) if len(kept) else None
