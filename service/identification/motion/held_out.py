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
from service.identification.motion.fit import FOLDS, FreeFit
from service.identification.motion.free_motion import FreeMotion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeldOut:
    """RMS of one axis below the band's end, N m (N): `residual` of the fit, `error` of parts held out, `floor`."""

    residual: float
    error: float
    floor: float | None


def held_out(records: Sequence[FreeMotion], fit: FreeFit, others: Information, start: Array) -> dict[str, HeldOut]:
    """By joint. `others`: information without the free motions, including the nominal model's prior."""
    values = fit.evidence.honest.plus(others).solve(start).values
    return {
        joint: HeldOut(
            residual=_rms([each.values - each.rows @ values for each in _of(fit, joint)], _of(fit, joint)),
            error=error,
            floor=_floor(records, _of(fit, joint), values),
        )
        for joint, error in held_out_errors(fit, others, start).items()
    }


def held_out_errors(fit: FreeFit, others: Information, start: Array) -> dict[str, float]:
    """RMS of what the rest of the records leaves unpredicted in each fold, N m (N), by joint."""
    errors: dict[str, list[Array]] = {}
    for fold in range(FOLDS):
        without = fit.without(fold).plus(others).solve(start).values
        for each, white in zip(fit.equations, fit.white, strict=True):
            out = white.block % FOLDS == fold
            errors.setdefault(each.joint, []).append((each.values - each.rows @ without)[each.sound][out])
    return {joint: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for joint, parts in errors.items()}


def _of(fit: FreeFit, joint: str) -> list[AxisEquations]:
    return [each for each in fit.equations if each.joint == joint]


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
