"""Spring and damping of a drive train from its direct encoder, after the inertias are known without them.

The spring transmits the torque of the load, so at every line, with E = Omega - Omega_l,

    E (1 + s h) = s c T,    T = s J_l Omega_l + mu_l Omega_l + G0 R0 + k_g (R1 + Omega_l / s) + t0

which is linear in c and h. mu_l is poorly separated from mu_m; its possible error is added to the standard
deviations.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from service.identification.axis.sweep_model import Stack, stack_residual
from service.identification.spectra.frequency_response import Complex

Array = NDArray[np.float64]


def spring(
    parts: Sequence[Stack], shared: Array, own: Sequence[Array], load_friction_std: float
) -> tuple[Array, Array]:
    """Compliance and damping time [c, h] and their standard deviations, (2,) each; parameters as in `sweep_model`."""
    values, covariance = _solve(parts, shared, own)
    other = shared.copy()
    other[2] += load_friction_std
    moved = _solve(parts, other, own)[0] - values
    return values, np.sqrt(np.diag(covariance) + moved**2)


def _solve(parts: Sequence[Stack], shared: Array, own: Sequence[Array]) -> tuple[Array, Array]:
    columns, values = zip(*(_rows(stack, shared, one) for stack, one in zip(parts, own, strict=True)), strict=True)
    rows, right = np.concatenate(columns), np.concatenate(values)
    scale = np.linalg.norm(rows, axis=0)
    solution = np.asarray(np.linalg.lstsq(rows / scale, right, rcond=None)[0], dtype=float)
    left = right - rows / scale @ solution
    variance = float(left @ left) / max(len(right) - 2, 1)
    gram = rows.T @ rows / np.outer(scale, scale)
    return solution / scale, variance * np.asarray(np.linalg.inv(gram), dtype=float) / np.outer(scale, scale)


def _rows(stack: Stack, shared: Array, own: Array) -> tuple[Array, Array]:
    """Rows (m, 2) and right sides (m,) of the lines of one stack."""
    _, by_shared, by_own = stack_residual(stack, shared, own)
    load_velocity = by_shared[:, 2]
    torque: Complex = shared[2] * load_velocity + np.einsum("nk,nkb->nb", own[:, :4], by_own[:, :4])
    twist = (stack.velocity - load_velocity)[stack.line]
    s = stack.s[stack.line]
    rows = np.stack([s * torque[stack.line], -s * twist], -1)
    return np.concatenate([rows.real, rows.imag]), np.concatenate([twist.real, twist.imag])
