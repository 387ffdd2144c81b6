"""The estimate as the document that `sweepid identify --json` prints and the service stores."""

import numpy as np
from numpy.typing import NDArray

from service.identification.estimates.axis_document import axis_document, used_effects
from service.identification.estimates.estimate import Estimate
from service.identification.estimates.standard_document import physical_document, standard_document
from service.identification.estimates.standard_parameters import standard_parameters
from service.identification.model.base_parameters import combination_of
from service.identification.model.symbols import Dimension, symbolic_names
from service.model.results import estimate as results

Array = NDArray[np.float64]


def as_document(estimate: Estimate, workspace: Array) -> results.Estimate:
    """All numbers of an estimate; undetermined values are None.

    `workspace` (m, all joints): the poses over which reference and identified model are compared.
    """
    standard = standard_parameters(estimate)
    symbolic, symbols = _in_words(estimate)
    return results.Estimate(
        axes={axis.joint: axis_document(estimate, axis, workspace) for axis in estimate.axes},
        base_parameters=tuple(
            _base_parameter(name, words, float(value), float(std), float(spread))
            for name, words, value, std, spread in zip(
                estimate.base.names,
                symbolic,
                estimate.solution.values,
                estimate.solution.std,
                estimate.spread,
                strict=True,
            )
        ),
        base=results.Base(
            locked=_locked(estimate), covariance=tuple(map(tuple, estimate.solution.covariance.tolist()))
        ),
        symbols={
            symbol.symbol: results.Symbol(value=symbol.value, unit=symbol.unit, meaning=symbol.meaning)
            for symbol in symbols
        },
        condition_number=_finite(estimate.condition_number),
        standard_parameters=standard_document(estimate.robot, standard),
        physical=physical_document(standard),
        suspect=estimate.suspects,
        effects=used_effects(estimate.known, estimate.axes),
        model=estimate.known.source,
    )


def nothing_known() -> results.Estimate:
    """Document without axes, while only noise runs and stepped sines were recorded."""
    return results.Estimate(
        axes={},
        base_parameters=(),
        base=results.Base(locked={}, covariance=()),
        symbols={},
        condition_number=None,
        standard_parameters=results.StandardParameters(links={}, motor_inertias={}),
        physical=results.Physical(deviation_in_std=None),
        suspect=(),
        effects=(),
        model=None,
    )


def _base_parameter(name: str, symbolic: str, value: float, std: float, spread: float) -> results.BaseParameter:
    """With the reason if it has no standard deviation."""
    found = results.BaseParameter(name=name, symbolic=symbolic, value=value, std=_finite(std))
    if found.std is not None:
        return found
    why = (
        f"the data do not determine it better than the nominal model (uncertainty {spread:.3g}); the value "
        "is biased towards that model"
    )
    return found.model_copy(update={"reason": why})


def _locked(estimate: Estimate) -> dict[str, float]:
    """Positions, rad (m), of the joints that never moved: the base parameters are those of the chain without them."""
    position = estimate.poses.mean(axis=0)
    joints = estimate.robot.joints
    return {joint: float(position[k]) for k, joint in enumerate(joints) if k not in estimate.unlocked}


def _in_words(estimate: Estimate) -> tuple[tuple[str, ...], tuple[Dimension, ...]]:
    """The base parameters as expressions in distances and angles of the robot."""
    axes = tuple(estimate.unlocked.index(estimate.robot.index(axis.joint)) for axis in estimate.axes)
    columns = estimate.base.columns
    return symbolic_names(
        estimate.chain, columns, estimate.base.combination, lambda chain: combination_of(chain, axes, columns)
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
