"""The estimate as the document that `sweepid identify --json` prints and the service stores."""

from collections.abc import Sequence

import numpy as np

from service.identification.axis.axis_estimate import FittedSweep
from service.identification.axis.drive_train import TwoMassTrain
from service.identification.axis.known_effects import DELAY, ELASTICITY, GAIN, HOSE, LAWS, KnownEffect, KnownEffects
from service.identification.estimates.estimate import AxisEstimate, HeldOutPoses, RobotEstimate
from service.identification.estimates.initial_analysis import TRAIN
from service.identification.estimates.standard_parameters import (
    physical_document,
    standard_document,
    standard_parameters,
)
from service.identification.model import Solution, combination_of
from service.identification.model.symbols import Dimension, symbolic_names
from service.model import Array
from service.model.results import estimate as results
from service.model.results.effect import Value

ENTERS = {
    DELAY: "effort is taken earlier by the delay",
    ELASTICITY: "prior of the spring, beside the data sheet",
    HOSE: "stiffness beside gravity's",
    GAIN: "effort is divided by the gain",
    **dict.fromkeys(LAWS, "its torque at the measured velocity is taken out of the effort"),
}


def rmse_percent(a: Array, b: Array) -> float:
    """100 sqrt(mean(((a - b) / b)^2)), as in the paper's Table 1."""
    return 100 * float(np.sqrt(np.mean(((a - b) / b) ** 2)))


def _axis_document(
    estimate: RobotEstimate, axis: AxisEstimate, workspace: Array, *, determined: bool
) -> results.EstimatedAxis:
    """The document of one axis; with a confidence if the inertias are determined."""
    measured = np.array([sweep.value for sweep in axis.sweeps])
    reference = np.array([sweep.reference for sweep in axis.sweeps])
    identified = estimate.model_at_sweeps(axis.joint)
    spread = None
    if determined:
        std = estimate.identified_std(axis.joint, workspace)
        spread = spread_document(std, estimate.identified(axis.joint, workspace))
    (squares, freedom), fit = estimate.chi_squared[axis.joint], axis.fit
    return results.EstimatedAxis(
        inertia=tuple(
            inertia_document(sweep, float(model)) for sweep, model in zip(axis.sweeps, identified, strict=True)
        ),
        rmse_percent=results.Rmse(
            reference_measured=rmse_percent(reference, measured),
            identified_measured=rmse_percent(identified, measured),
            reference_identified=rmse_percent(
                estimate.reference(axis.joint, workspace), estimate.identified(axis.joint, workspace)
            ),
        ),
        drive_train=None if fit is None else train_document(fit.train, fit.train_std),
        load_motion="direct_encoder" if axis.direct_encoder else "motor_encoder",
        torque_gain=results.TorqueGain(value=axis.gain.gain, std=axis.gain.std),
        distortion=_distortion(axis),
        effects_moved_in_std=float(np.abs(fit.moved).max()) if fit is not None and len(fit.moved) else None,
        confidence_percent=None if spread is None else spread.worst,
        workspace_std_percent=spread,
        reduced_chi_squared=squares / freedom if freedom > 0.5 else None,
        held_out=held_out_document(estimate.held_out[axis.joint], axis.values),
        cramer_rao=_cramer_rao(axis),
    )


def inertia_document(sweep: FittedSweep, identified: float) -> results.SweepInertia:
    """`terms` and `warning` only if there are any."""
    found = results.SweepInertia(
        sweep=sweep.sweep,
        value=sweep.value,
        std=sweep.std,
        std_total=sweep.std_total,
        reference=sweep.reference,
        identified=identified,
        paper_value=sweep.paper_value,
        viscous_friction=sweep.viscous_friction,
        frequency_response=_lines(sweep),
    )
    terms = {name: Value(value=value, std=std) for name, (value, std) in sweep.terms.items()}
    return found.with_nonempty(terms=terms, warning=sweep.warning)


def _lines(sweep: FittedSweep) -> tuple[results.ResponseLine, ...]:
    """Noise and distortion parts of each line's std, if the axis has several realisations of its sweeps."""
    lines = (results.ResponseLine(frequency=f, re=z.real, im=z.imag, std=std) for f, z, std in sweep.response)
    if sweep.noise is None:
        return tuple(lines)
    return tuple(
        line.model_copy(update={"noise_std": noise, "distortion_std": float(np.sqrt(max(line.std**2 - noise**2, 0.0)))})
        for line, noise in zip(lines, sweep.noise, strict=True)
    )


def spread_document(std: Array, identified: Array) -> results.Spread:
    """Standard deviation (m,) of the `identified` inertia (m,) over the workspace."""
    percent = 100 * std / np.abs(identified)
    return results.Spread(median=float(np.median(percent)), worst=float(percent.max()))


def held_out_document(held_out: HeldOutPoses, values: Array) -> results.HeldOut | None:
    """Checks the standard deviations of inertias (n,) in poses that were not used in the fit."""
    known = np.isfinite(held_out.std)
    if not known.any():
        return None
    error, z = held_out.error[known], held_out.error[known] / held_out.std[known]
    return results.HeldOut(
        sweeps=int(known.sum()),
        rmse_percent=100 * float(np.sqrt(np.mean((error / values[known]) ** 2))),
        standardized_rmse=float(np.sqrt(np.mean(z**2))),
        # 95 % of a normal error
        within_95_percent=100 * float(np.mean(np.abs(z) < 1.96)),
    )


def _cramer_rao(axis: AxisEstimate) -> results.CramerRao | None:
    bound = [(sweep.bound, sweep.std, sweep.value) for sweep in axis.sweeps if sweep.bound is not None]
    return cramer_rao_document(*np.array(bound).T) if bound else None


def cramer_rao_document(bound: Array, std: Array, values: Array) -> results.CramerRao:
    """Of sweeps (n,) with a bound."""
    return results.CramerRao(
        bound_percent=100 * float(np.median(bound / np.abs(values))), std_over_bound=float(np.median(std / bound))
    )


def train_document(train: TwoMassTrain, std: Array) -> dict[str, Value]:
    """`std` (5,) in the order of `TwoMassTrain.as_array`."""
    return {
        name: Value(value=float(value), std=float(own))
        for name, value, own in zip(TRAIN, train.as_array(), std, strict=True)
    }


def _distortion(axis: AxisEstimate) -> results.Distortion | None:
    """Amplitudes: a bin contains half of a sine's."""
    found = axis.distortion
    if found is None:
        return None
    return results.Distortion(
        realisations=found.realisations,
        poses=found.groups,
        effort=tuple(
            results.DistortedLine(
                frequency=float(frequency), noise_std=2 * float(noise), distortion_std=2 * float(distortion)
            )
            for frequency, noise, distortion in zip(found.frequency, found.noise, found.distortion, strict=True)
        ),
    )


def used_effects(known: KnownEffects, axes: Sequence[AxisEstimate]) -> tuple[results.UsedEffect, ...]:
    """Every known effect of the estimate's axes with the values used."""
    return tuple(_used(effect, axis) for axis in axes for effect in known.of(axis.joint).effects)


def _used(effect: KnownEffect, axis: AxisEstimate) -> results.UsedEffect:
    used, how = _role(effect, axis)
    parameters = {
        name: Value(value=value, std=effect.std[name], unit=effect.units[name]) for name, value in effect.values.items()
    }
    return results.UsedEffect(axis=axis.joint, effect=effect.name, parameters=parameters, used=used, how=how)


def _role(effect: KnownEffect, axis: AxisEstimate) -> tuple[bool, str]:
    """Whether it is used, and how or why not."""
    stays_out = {
        "effort_offset": "a constant torque has no component at the lines, and records without lines fit it anyway",
        "cogging_torque": "ripple of known orders is fitted in every sweep",
        "transmission_error": "ripple of known orders is fitted in every sweep",
        "gravity_error": "gravity is fitted in every sweep",
        "counterbalance": "gravity is fitted in every sweep",
        "payload": "the inertias hold whatever the robot carries",
    }
    other = "is not described for sweeps with lines"
    if effect.unusable:
        return False, effect.unusable
    if effect.name == GAIN:
        used = axis.gain.gain == 1 + effect.values.get("gain_error", 0.0)
        return used, ENTERS[GAIN] if used else "a test mass calibrated the axis"
    if effect.name in ENTERS:
        if axis.fit is None:
            return False, "the axis has no sweep with lines"
        return True, ENTERS[effect.name]
    return False, stays_out.get(effect.name, other)


def as_document(estimate: RobotEstimate, workspace: Array) -> results.Estimate:
    """All numbers of an estimate; undetermined values are None.

    `workspace` (m, all joints): the poses over which reference and identified model are compared.
    """
    standard = standard_parameters(estimate)
    symbolic, symbols = _in_words(estimate)
    determined = estimate.determines(workspace)
    return results.Estimate(
        axes={axis.joint: _axis_document(estimate, axis, workspace, determined=determined) for axis in estimate.axes},
        base_parameters=base_document(estimate, symbolic, estimate.solution, estimate.spread),
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
        prior=estimate.prior,
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


def base_document(
    estimate: RobotEstimate, symbolic: Sequence[str], solution: Solution, spread: Array
) -> tuple[results.BaseParameter, ...]:
    """The base parameters of an estimate, each in its two names; `spread` (r,) in the nominal model."""
    nominal = estimate.base.combination @ estimate.nominal
    each = zip(estimate.base.names, symbolic, solution.values, solution.std, nominal, spread, strict=True)
    return tuple(_base_parameter(name, words, *map(float, numbers)) for name, words, *numbers in each)


def _base_parameter(
    name: str, symbolic: str, value: float, std: float, reference: float, spread: float
) -> results.BaseParameter:
    """With the reason if it has no standard deviation."""
    found = results.BaseParameter(name=name, symbolic=symbolic, value=value, std=_finite(std), reference=reference)
    if found.std is not None:
        return found
    why = (
        f"the data do not determine it better than the nominal model (uncertainty {spread:.3g}); the value "
        "is biased towards that model"
    )
    return found.model_copy(update={"reason": why})


def _locked(estimate: RobotEstimate) -> dict[str, float]:
    """Positions, rad (m), of the joints that never moved: the base parameters are those of the chain without them."""
    position = estimate.poses.mean(axis=0)
    joints = estimate.robot.joints
    return {joint: float(position[k]) for k, joint in enumerate(joints) if k not in estimate.unlocked}


def _in_words(estimate: RobotEstimate) -> tuple[tuple[str, ...], tuple[Dimension, ...]]:
    """The base parameters as expressions in distances and angles of the robot."""
    axes = tuple(estimate.unlocked.index(estimate.robot.index(axis.joint)) for axis in estimate.axes)
    columns = estimate.base.columns
    return symbolic_names(
        estimate.chain, columns, estimate.base.combination, lambda chain: combination_of(chain, axes, columns)
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
