r"""Records without lines: least squares on the DFT of each regressor, one record at a time.

    effort = J dv/dt + mu v + Fc sign(v) + offset + gravity        (rigid train)

holds at every instant, hence bin by bin for the DFTs of all its terms (`frequency_response`). Bins from 0 to 20 Hz are
a low-pass filter applied to every term alike, and the acceleration comes from integration by parts, so neither filter
nor difference quotient biases J.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.errors import BadInput
from service.identification.frequency_response import Spectrum

Array = NDArray[np.float64]

OPEN = 1e-7  # smallest singular value of the unit columns: below, two terms are the same but for rounding


@dataclass(frozen=True)
class FreeFit:
    """Result of one record; SI on the joint side. `residual_percent`: RMS of what is left over RMS of the effort."""

    inertia: float
    inertia_std: float
    terms: dict[str, tuple[float, float]]  # the other terms: value, std
    residual_percent: float


def fit_record(spectrum: Spectrum) -> FreeFit:
    """Fit one free record; every term that its motion excites takes part. BadInput if that leaves J open."""
    columns = {"inertia": spectrum.named("acceleration")[0], "viscous_friction": spectrum.velocity}
    for name, term in (
        ("coulomb", "coulomb_friction"),
        ("offset", "effort_offset"),
        ("gravity_torque", "gravity_torque"),
        ("gravity_stiffness", "gravity_stiffness"),
    ):
        for row in spectrum.named(name):
            columns[term] = row
    if "gravity_torque" in columns:
        # cos d is a constant to first order: it takes the offset's place
        del columns["effort_offset"]
    matrix = np.stack(list(columns.values()), -1)
    # bins above 0 Hz stand for two (f and -f)
    weight = np.where(spectrum.frequency > 0, np.sqrt(2.0), 1.0)[:, None]
    rows = np.vstack([matrix.real * weight, matrix.imag * weight])
    values = np.concatenate([spectrum.effort.real, spectrum.effort.imag]) * np.concatenate([weight, weight])[:, 0]
    scale = np.linalg.norm(rows, axis=0)
    scaled = rows / np.where(scale > 0, scale, 1.0)
    if len(values) <= len(scale) or np.linalg.svd(scaled, compute_uv=False)[-1] < OPEN:
        raise BadInput(
            f"sweep {spectrum.spec.id}",
            f"its motion of {spectrum.samples} samples does not tell inertia from {', '.join(list(columns)[1:])}",
        )
    solution = np.asarray(np.linalg.lstsq(scaled, values, rcond=None)[0], dtype=float)
    residual: Array = values - scaled @ solution
    variance = float(residual @ residual) / (len(values) - len(solution))
    covariance = np.asarray(np.linalg.inv(scaled.T @ scaled), dtype=float)
    std: Array = np.sqrt(variance * np.diag(covariance)) / scale
    result = dict(zip(columns, zip((solution / scale).tolist(), std.tolist(), strict=True), strict=True))
    inertia, inertia_std = result.pop("inertia")
    return FreeFit(inertia, inertia_std, result, 100 * float(np.linalg.norm(residual) / np.linalg.norm(values)))
