"""The estimate as the JSON object that `sweepid identify --json` prints and the service stores (DESIGN.md)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.identification.axis.axis_estimate import SweepInertia
from service.identification.estimates.effects_document import effects_document
from service.identification.estimates.estimate import AxisEstimate, Estimate
from service.identification.estimates.standard_parameters import standard_parameters
from service.identification.model.base_parameters import combination_of
from service.identification.model.symbols import Dimension, symbolic_names
from service.robot import INERTIAL_NAMES

Array = NDArray[np.float64]

WITHIN = 1.96  # standard deviations: 95 % of a normal error


def rmse_percent(a: Array, b: Array) -> float:
    """100 sqrt(mean(((a - b) / b)^2)), as in the paper's Table 1."""
    return 100 * float(np.sqrt(np.mean(((a - b) / b) ** 2)))


def as_document(estimate: Estimate, workspace: Array) -> dict[str, Any]:
    """All numbers of an estimate; what the data do not determine is null.

    `workspace` (m, all joints): the poses over which reference and identified model are compared.
    """
    standard = standard_parameters(estimate)
    symbolic, symbols = _in_words(estimate)
    return {
        "axes": {axis.joint: _axis(estimate, axis, workspace) for axis in estimate.axes},
        "base_parameters": [
            {"name": name, "symbolic": words, "value": float(value), "std": _finite(std), **_open(std, spread)}
            for name, words, value, std, spread in zip(
                estimate.base.names,
                symbolic,
                estimate.solution.values,
                estimate.solution.std,
                estimate.spread,
                strict=True,
            )
        ],
        "base": {
            "locked": _locked(estimate),
            "covariance": estimate.solution.covariance.tolist(),
        },
        "symbols": {
            symbol.symbol: {"value": symbol.value, "unit": symbol.unit, "meaning": symbol.meaning} for symbol in symbols
        },
        "condition_number": _finite(estimate.condition_number),
        "standard_parameters": _standard(estimate, standard.parameters),
        "physical": {"deviation_in_std": standard.deviation},
        "suspect": [
            {"axis": one.axis, "sweep": one.sweep, "why": one.why, "weight": one.weight} for one in estimate.suspects
        ],
        **effects_document(estimate.known, estimate.axes),
    }


def _locked(estimate: Estimate) -> dict[str, float]:
    """Positions, rad (m), of the joints that never moved: the base parameters are those of the chain without them."""
    position = estimate.poses.mean(axis=0)
    joints = estimate.robot.joints
    return {joint: float(position[k]) for k, joint in enumerate(joints) if k not in estimate.unlocked}


def _axis(estimate: Estimate, axis: AxisEstimate, workspace: Array) -> dict[str, Any]:
    measured = np.array([sweep.value for sweep in axis.sweeps])
    reference = np.array([sweep.reference for sweep in axis.sweeps])
    identified = estimate.model_at_sweeps(axis.joint)
    return {
        "inertia": [
            {
                "sweep": sweep.sweep,
                "value": sweep.value,
                "std": sweep.std,
                "std_total": sweep.std_total,
                "reference": sweep.reference,
                "identified": float(model),
                "paper_value": sweep.paper_value,
                "viscous_friction": sweep.viscous_friction,
                "frequency_response": [
                    {"frequency": frequency, "re": z.real, "im": z.imag, "std": std, **parts}
                    for (frequency, z, std), parts in zip(sweep.response, _parts(sweep), strict=True)
                ],
                **({"terms": _terms(sweep.terms)} if sweep.terms else {}),
                **({"warning": sweep.warning} if sweep.warning else {}),
            }
            for sweep, model in zip(axis.sweeps, identified, strict=True)
        ],
        "rmse_percent": {
            "reference_measured": rmse_percent(reference, measured),
            "identified_measured": rmse_percent(identified, measured),
            "reference_identified": rmse_percent(
                estimate.reference(axis.joint, workspace), estimate.identified(axis.joint, workspace)
            ),
        },
        "drive_train": _train(axis),
        "load_motion": "direct_encoder" if axis.direct_encoder else "motor_encoder",
        "torque_gain": {"value": axis.gain.gain, "std": axis.gain.std},
        "distortion": _distortion(axis),
        "effects_moved_in_std": None if axis.fit is None or not len(axis.fit.moved) else _largest(axis.fit.moved),
        **_confidence(estimate, axis, workspace),
        **_quality(estimate, axis),
    }


def _confidence(estimate: Estimate, axis: AxisEstimate, workspace: Array) -> dict[str, Any]:
    """Standard deviation of the identified inertia over the workspace; null while a base parameter is open."""
    if not estimate.solution.determined.all():
        return {"confidence_percent": None, "workspace_std_percent": None}
    percent = 100 * estimate.identified_std(axis.joint, workspace) / np.abs(estimate.identified(axis.joint, workspace))
    return {
        "confidence_percent": float(percent.max()),
        "workspace_std_percent": {"median": float(np.median(percent)), "worst": float(percent.max())},
    }


def _quality(estimate: Estimate, axis: AxisEstimate) -> dict[str, Any]:
    """Do the standard deviations keep what they promise? J = W beta, poses held out, Cramer and Rao."""
    squares, freedom = estimate.chi_squared[axis.joint]
    held_out = estimate.held_out[axis.joint]
    told = np.isfinite(held_out.std)
    error, z = held_out.error[told], held_out.error[told] / held_out.std[told]
    bound = [(sweep.bound, sweep.std, sweep.value) for sweep in axis.sweeps if sweep.bound is not None]
    return {
        "reduced_chi_squared": squares / freedom if freedom > 0.5 else None,
        "held_out": {
            "sweeps": int(told.sum()),
            "rmse_percent": 100 * float(np.sqrt(np.mean((error / axis.values[told]) ** 2))),
            "standardized_rmse": float(np.sqrt(np.mean(z**2))),
            "within_95_percent": 100 * float(np.mean(np.abs(z) < WITHIN)),
        }
        if told.any()
        else None,
        "cramer_rao": {
            "bound_percent": 100 * float(np.median([limit / abs(value) for limit, _, value in bound])),
            "std_over_bound": float(np.median([std / limit for limit, std, _ in bound])),
        }
        if bound
        else None,
    }


def _open(std: float, spread: float) -> dict[str, str]:
    """Why a base parameter has no standard deviation."""
    if np.isfinite(std):
        return {}
    why = f"the data tell it no better than the nominal model, which leaves {spread:.3g}; it is drawn to that model"
    return {"reason": why}


def _terms(terms: dict[str, tuple[float, float]]) -> dict[str, dict[str, float]]:
    return {name: {"value": value, "std": std} for name, (value, std) in terms.items()}


def _train(axis: AxisEstimate) -> dict[str, Any] | None:
    if axis.fit is None:
        return None
    names = ("motor_inertia", "motor_friction", "load_friction", "compliance", "damping_time")
    values = axis.fit.train.as_array()
    return {
        name: {"value": float(value), "std": float(std)}
        for name, value, std in zip(names, values, axis.fit.train_std, strict=True)
    }


def _in_words(estimate: Estimate) -> tuple[tuple[str, ...], tuple[Dimension, ...]]:
    """The base parameters with distances and angles of the robot in place of numbers."""
    axes = tuple(estimate.unlocked.index(estimate.robot.index(axis.joint)) for axis in estimate.axes)
    columns = estimate.base.columns
    return symbolic_names(
        estimate.chain, columns, estimate.base.combination, lambda chain: combination_of(chain, axes, columns)
    )


def _standard(estimate: Estimate, parameters: Array) -> dict[str, Any]:
    """Parameters (11 n,) of all links and motors of the robot, by name."""
    joints = estimate.robot.chain.joints
    count = 10 * len(joints)
    return {
        "links": {
            joint.link: dict(zip(INERTIAL_NAMES, values.tolist(), strict=True))
            for joint, values in zip(joints, parameters[:count].reshape(-1, 10), strict=True)
        },
        "motor_inertias": {
            f"Jm({joint.name})": float(value) for joint, value in zip(joints, parameters[count:], strict=True)
        },
    }


def _parts(sweep: SweepInertia) -> list[dict[str, float]]:
    """What of each line's std is noise and what distortion, where the axis has several realisations of its sweeps."""
    if sweep.noise is None:
        return [{} for _ in sweep.response]
    return [
        {"noise_std": noise, "distortion_std": float(np.sqrt(max(std**2 - noise**2, 0.0)))}
        for (_, _, std), noise in zip(sweep.response, sweep.noise, strict=True)
    ]


def _distortion(axis: AxisEstimate) -> dict[str, Any] | None:
    """Amplitudes: a bin holds half of a sine's."""
    found = axis.distortion
    if found is None:
        return None
    return {
        "realisations": found.realisations,
        "poses": found.groups,
        "effort": [
            {"frequency": float(frequency), "noise_std": 2 * float(noise), "distortion_std": 2 * float(distortion)}
            for frequency, noise, distortion in zip(found.frequency, found.noise, found.distortion, strict=True)
        ],
    }


def _largest(moved: Array) -> float:
    return float(np.abs(moved).max())


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
