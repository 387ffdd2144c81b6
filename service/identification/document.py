"""The estimate as the JSON object that `sweepid identify --json` prints and the service stores (DESIGN.md)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.identification.estimate import AxisEstimate, Estimate
from service.identification.regressor import parameter_names
from service.robot import INERTIAL_NAMES

Array = NDArray[np.float64]


def rmse_percent(a: Array, b: Array) -> float:
    """100 sqrt(mean(((a - b) / b)^2)), as in the paper's Table 1."""
    return 100 * float(np.sqrt(np.mean(((a - b) / b) ** 2)))


def as_document(estimate: Estimate, workspace: Array) -> dict[str, Any]:
    """All numbers of an estimate; what the data do not determine is null.

    `workspace` (m, all joints): the poses over which reference and identified model are compared.
    """
    return {
        "axes": {axis.joint: _axis(estimate, axis, workspace) for axis in estimate.axes},
        "base_parameters": [
            {"name": name, "value": float(value), "std": _finite(std)}
            for name, value, std in zip(
                estimate.base.names, estimate.solution.values, estimate.solution.std, strict=True
            )
        ],
        "condition_number": _finite(estimate.condition_number),
        "standard_parameters": _standard(estimate),
    }


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
                    {"frequency": frequency, "re": z.real, "im": z.imag, "std": std}
                    for frequency, z, std in sweep.response
                ],
                **({"terms": _terms(sweep.terms)} if sweep.terms else {}),
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
    }


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


def _standard(estimate: Estimate) -> dict[str, Any]:
    """Link parameters nearest to the nominal model, in units of its prior, that reproduce the base parameters.

    x = x0 + S K' (K S K')^-1 (beta - K x0) with S the prior covariance. Not yet constrained to be physical.
    """
    count = len(estimate.chain.joints)
    links = estimate.nominal[: 10 * count].reshape(-1, 10)
    mass = np.maximum(links[:, :1], 1e-9)
    length = np.sqrt(np.maximum(links[:, [4, 6, 9]].sum(-1, keepdims=True), 0) / 2 / mass) + 1e-3
    size = np.hstack([mass, np.repeat(mass * length, 3, 1), np.repeat(mass * length**2, 6, 1)]).ravel()
    prior = estimate.robot.prior
    spread = np.concatenate([prior.inertia * size, _motor_spread(estimate)]) ** 2
    combination = estimate.base.combination
    missing = estimate.solution.values - combination @ estimate.nominal
    weighted = combination * spread
    scale = np.sqrt(np.einsum("ij,ij->i", weighted, combination))
    normal = weighted @ combination.T / np.outer(scale, scale)
    step = np.asarray(np.linalg.solve(normal, missing / scale), dtype=float)
    values = estimate.nominal + weighted.T @ (step / scale)
    names = parameter_names(estimate.chain)
    return {
        "links": {
            joint.link: dict(zip(INERTIAL_NAMES, values[10 * k : 10 * k + 10].tolist(), strict=True))
            for k, joint in enumerate(estimate.chain.joints)
        },
        "motor_inertias": dict(zip(names[10 * count :], values[10 * count :].tolist(), strict=True)),
    }


def _motor_spread(estimate: Estimate) -> Array:
    """One sigma (n,) of the reflected motor inertias; one the data sheet leaves out may be all that was measured."""
    measured = {axis.joint: float(np.median([sweep.value for sweep in axis.sweeps])) for axis in estimate.axes}
    motors = [estimate.robot.axes[number] for number in estimate.unlocked]
    known = [estimate.robot.prior.motor_inertia * (axis.reflected_motor_inertia or 0.0) for axis in motors]
    return np.array(
        [sigma or abs(measured.get(axis.joint, 0.0)) or 1e-9 for sigma, axis in zip(known, motors, strict=True)]
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
