r"""Inertia from the frequency response of a drive's speed control loop, on the motor side.

Speed set-point r to speed v. The controller with gain K commands the torque K e of e = r - v. With

    r/v = 1 + (a s + c) e^(s tau) D(s),        a = J/K,  c = mu/K

a rigid train responds with the delay `tau` (current control, filters). D = 1 if the integral part uses the
reference model of the loop, or if there is none; D = Ti s/(1 + Ti s) if it acts on e. Without the gain, only a,
in s, can be determined, because speeds contain no absolute torque.

Torque to speed. Then J itself is determined:  torque/v = s (Jm + (J - Jm)/(1 - (f/f0)^2)) + mu,  with the rotor's
inertia Jm and the lowest antiresonance f0 (the load oscillates and the motor stands), if they are known.

The model is fitted to the lines of a band, unweighted, because the residual is far above the noise: it repeats in both
directions and from period to period. The standard deviation is therefore that of the parts: the band is divided into
G = `PARTS` stretches of lines, var = (G - 1)/G sum_g (theta_g - mean)^2 of the fits without one each, times
(t_0.975(G - 1)/1.96)^2, so that two standard deviations cover 95 %; or that of least squares, if it is larger.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from service import BadInput
from service.identification.model import finite, jackknife_factor
from service.model import Array, Complex, Indices, Mask


@dataclass(frozen=True)
class Loop:
    """What of the speed loop is fitted."""

    follows: float = 0.5  # |v/r| down to which the loop is used: beyond, structural modes and delays dominate
    parts: int = 5
    fewest: int = 12  # lines
    delay: float = 1e-3  # s, at which the fit starts


@dataclass(frozen=True)
class LoopFit:
    """`inertia`: J/K in s of a closed loop, J in kg m^2 of a torque response; `friction` c or mu.

    `band` Hz and number of `lines` used; `misfit`: RMS of the residual relative to the response. `ended`: how the
    iteration ended; empty for a linear fit.
    """

    inertia: float
    inertia_std: float
    friction: float
    friction_std: float
    delay: float | None  # s
    band: tuple[float, float]
    lines: int
    misfit: float
    converged: bool
    ended: str


@dataclass(frozen=True)
class _Solution:
    values: Array  # (p,)
    covariance: Array  # (p, p), of least squares
    misfit: float
    converged: bool = True
    ended: str = "linear: no iteration"


def fit_closed_loop(frequency: Array, response: Complex, place: str, reset_time: float | None = None) -> LoopFit:
    """From v/r (b,) at `frequency` (b,), Hz. Raises BadInput at `place` if the response is not that of a closed loop.

    BadInput also where a line is not finite, and where the fit, or one without a stretch of lines, does not converge.

    `reset_time` s: of an integral part that acts on the control error; None: it does not answer the set-point.
    """
    finite(response, place, "its response")
    inside = _band(frequency, _follows(response), place)
    f, measured = frequency[inside], response[inside]
    s: Complex = np.multiply(2j * np.pi, f, dtype=np.complex128)
    integral: Complex = np.ones_like(s) if reset_time is None else reset_time * s / (1 + reset_time * s)
    first = float(np.median(((1 / measured - 1) / integral / s).real[: Loop.fewest]))

    def solve(used: Indices) -> _Solution:
        def error(x: Array) -> Array:
            train = (x[0] * first * s[used] + x[2]) * np.exp(s[used] * x[1] * Loop.delay)
            left = 1 / (1 + train * integral[used]) - measured[used]
            return np.concatenate([left.real, left.imag])

        # steps of inertia and delay over their starts, and of c
        found = least_squares(error, np.array([1.0, 1.0, 0.0]), method="lm", x_scale=np.array((0.1, 0.1, 0.01)))
        solution = _of_jacobian(np.asarray(found.x), np.asarray(found.jac), np.asarray(found.fun), measured[used])
        return replace(solution, converged=bool(found.success), ended=" ".join(str(found.message).split()))

    whole, std = _with_parts(f, solve, place)
    if not whole.converged or not whole.values[0] * first > 0:
        raise BadInput(place, f"shows no inertia from {f[0]:.3g} to {f[-1]:.3g} Hz: {whole.ended}")
    inertia, std[0] = float(whole.values[0] * first), std[0] * abs(first)
    return _loop_fit(f, whole, std, inertia, friction=2, delay=float(whole.values[1] * Loop.delay))


def fit_torque_response(
    frequency: Array,
    response: Complex,
    place: str,
    lowest: float = 0.0,
    antiresonance: float | None = None,
    motor_inertia: float = 0.0,
) -> LoopFit:
    """From v/torque (b,), rad/s per N m, at `frequency` (b,), Hz, from `lowest` on; BadInput for too few lines, or
    one that is not finite."""
    finite(response, place, "its response")
    # the train is rigid up to half of it
    highest = np.inf if antiresonance is None else 0.5 * antiresonance
    inside = _band(frequency, (frequency >= lowest) & (frequency <= highest), place)
    f, measured = frequency[inside], response[inside]
    s: Complex = np.multiply(2j * np.pi, f, dtype=np.complex128)
    swing = np.ones_like(f) if antiresonance is None else 1 / (1 - (f / antiresonance) ** 2)
    rows: Complex = np.stack([s * swing * measured, measured], -1)
    values: Complex = 1 - s * motor_inertia * (1 - swing) * measured

    def solve(used: Indices) -> _Solution:
        matrix = np.vstack([rows[used].real, rows[used].imag])
        right = np.concatenate([values[used].real, values[used].imag])
        x = np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0], dtype=float)
        return _of_jacobian(x, matrix, matrix @ x - right, np.ones(len(used), dtype=np.complex128))

    whole, std = _with_parts(f, solve, place)
    return _loop_fit(f, whole, std, float(whole.values[0]), friction=1)


def _loop_fit(
    frequency: Array, whole: _Solution, std: Array, inertia: float, friction: int, delay: float | None = None
) -> LoopFit:
    """`friction`: its number among the parameters; the first is the inertia."""
    return LoopFit(
        inertia=inertia,
        inertia_std=float(std[0]),
        friction=float(whole.values[friction]),
        friction_std=float(std[friction]),
        delay=delay,
        band=(float(frequency[0]), float(frequency[-1])),
        lines=len(frequency),
        misfit=whole.misfit,
        converged=whole.converged,
        ended=whole.ended,
    )


def _follows(response: Complex) -> Mask:
    """Lines (b,) up to where the loop stops following: two neighbours below `FOLLOWS`."""
    weak = np.abs(response) < Loop.follows
    stop = np.flatnonzero(weak[:-1] & weak[1:])
    return np.arange(len(response)) < (stop[0] if len(stop) else len(response))


def _band(frequency: Array, wanted: Mask, place: str) -> Indices:
    inside = np.flatnonzero(wanted & (frequency > 0))
    if len(inside) < Loop.fewest:
        raise BadInput(
            place, f"has {len(inside)} lines where the train is rigid and the loop follows, needs {Loop.fewest}"
        )
    return inside


def _of_jacobian(values: Array, jacobian: Array, left: Array, measured: Complex) -> _Solution:
    """Solution from residuals `left` (m,) and their derivatives (m, p); misfit relative to the `measured` response."""
    variance = float(left @ left) / (len(left) - len(values))
    covariance = np.asarray(variance * np.linalg.pinv(jacobian.T @ jacobian), dtype=float)
    return _Solution(values, covariance, float(np.linalg.norm(left) / np.linalg.norm(measured)))


def _with_parts(frequency: Array, solve: Callable[[Indices], _Solution], place: str) -> tuple[_Solution, Array]:
    """The fit of all lines at `frequency` (b,) and its standard deviations (p,); see the module's header.

    BadInput where a fit without one stretch of lines does not converge: there is no standard deviation then.
    """
    lines = np.arange(len(frequency))
    whole = solve(lines)
    without: list[Array] = []
    for part in range(Loop.parts):
        inside = lines * Loop.parts // len(lines) != part
        found = solve(lines[inside])
        if whole.converged and not found.converged:
            first, last = frequency[~inside][[0, -1]]
            raise BadInput(place, f"the fit without its lines from {first:.3g} to {last:.3g} Hz ended: {found.ended}")
        without.append(found.values)
    by_parts = jackknife_factor(Loop.parts) ** 2 * (Loop.parts - 1) * np.var(np.array(without), axis=0)
    return whole, np.sqrt(np.maximum(by_parts, np.diag(whole.covariance)))
