r"""Physically consistent standard parameters that are closest to a nominal model and give the base parameters.

A link is physical if some distribution of mass has its ten parameters. This holds if its pseudo-inertia
(Wensing, Kim and Slotine 2018) is positive definite, which covers mass, triangle inequalities and products of inertia:

    P = [ tr(I)/2 1 - I   mc ]
        [      mc^T        m ]  > 0,                       and Jm > 0 for a motor.

Closest: in the entropic divergence (Lee, Wensing and Park 2020), which does not depend on frame or unit,

    D(P, P0) = tr(P0^-1 P) - log det(P0^-1 P) - 4,         d(Jm, Jm0) = Jm/Jm0 - log(Jm/Jm0) - 1.

A link scaled by 1 + s has D = 2 s^2 + ..., a motor d = s^2/2 + ...; with s the relative standard deviation the weights
w = 1/(4 s^2) and 1/s^2 make both half a squared number of standard deviations. With A x = b the base parameters:

    min  sum w D   with  A x = b                     the nearest robot that has exactly these base parameters, or
    min  sum w D + |A x - b|^2 / 2   (b white)       where noise made them impossible: the most probable one

In Y = L^-1 P L^-T, P0 = L L^T, link by link, and with G(nu) the combination of the rows of A as 4 x 4 matrices, the
minimum over P is Y = (1 + G(nu)/w)^-1, positive definite by construction, and the dual is concave and smooth:

    max over nu:   sum w log det(1 + G(nu)/w) - nu.b - e |nu|^2 / 2,         gradient  A x - b - e nu,

with e = 0 for the first problem and e = 1 for the second. Newton's method solves it. If no physical x gives b, the
dual of the first has no maximum; that of the second always has one.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from service.identification.model.least_squares import finite
from service.model import Array, Mask, inertia_matrix


@dataclass(frozen=True)
class Newton:
    """When Newton's method ends and what counts as zero."""

    exact: float = 1e-10  # of a row's terms and nominal spread: A x - b below it counts as zero
    steps: int = 100  # of Newton's method, at most; about ten are used
    small: float = 1e-12  # ratio of eigenvalues below which the smaller counts as zero
    thinnest: float = 1e-4  # of a link's largest second moment about its centre of mass: least nominal one


class SearchEnded(Enum):
    """How the search for physical parameters ended."""

    EXACT = "the base parameters are reproduced"
    MOST_PROBABLE = "the most probable physical robot, given CAD and the base parameters"
    UNFINISHED = "Newton's method did not reach the most probable robot; the last physical one on the way"


@dataclass(frozen=True)
class NearestPhysical:
    """parameters (11 n,); `deviation`: Mahalanobis distance of their base parameters from those given, 0 if exact."""

    parameters: Array
    deviation: float
    ended: SearchEnded


def nearest_physical(
    nominal: Array,
    spread: tuple[float, Array],
    rows: Array,
    values: Array,
    covariance: Array,
    *,
    exactly: bool = True,
) -> NearestPhysical:
    """Parameters (11 n,) closest to `nominal` with ``rows @ parameters = values``, all links and motors physical.

    If there are none, or without `exactly`, the most probable ones given both: `deviation` is then their distance from
    `values`.

    spread: relative standard deviation of the nominal links, and (n,) of the nominal motors. rows (k, 11 n) linearly
    independent, values (k,), covariance (k, k) positive definite. Motors that are nominally 0 stay 0: they must not
    appear in the rows. What the rows do not touch stays nominal, but for links that are not physical. BadInput where
    an argument is not finite.
    """
    for name, given in (("nominal model", nominal), ("rows", rows), ("values", values), ("covariance", covariance)):
        finite(given, "base parameters", f"their {name}")
    problem = _Constraints.of(nominal, spread, rows, values)
    parameters = _exactly(problem) if exactly else None
    if parameters is not None:
        size = np.abs(rows) @ np.abs(parameters) + np.abs(values) + np.sqrt(np.diag(problem.nominal_covariance()))
        if np.all(np.abs(rows @ parameters - values) <= Newton.exact * size):
            return NearestPhysical(parameters, 0.0, SearchEnded.EXACT)
    noise = _whitening(covariance)
    white = problem.transformed(noise)
    multipliers, reached = _most_probable(white)
    parameters = problem.parameters(white.blocks(multipliers))
    ended = SearchEnded.MOST_PROBABLE if reached else SearchEnded.UNFINISHED
    return NearestPhysical(parameters, float(np.linalg.norm(noise @ (rows @ parameters - values))), ended)


def nominal_factor(nominal: Array, spread: tuple[float, Array], rows: Array) -> Array:
    """F (k, j) with F F' the covariance of ``rows @ parameters`` that the nominal model's spread makes, to first order
    in its divergence: mass, centre and inertia of a link are correlated. Arguments as `nearest_physical`.
    """
    problem = _Constraints.of(nominal, spread, rows, np.zeros(len(rows)))
    links = problem.link_rows.reshape(len(rows), -1) / np.sqrt(problem.link_weight)
    return np.hstack([links, problem.motor_rows / np.sqrt(problem.motor_weight)])


def pseudo_inertia(parameters: Array) -> Array:
    """(..., 10) parameters of links -> (..., 4, 4)."""
    inertia = inertia_matrix(parameters)
    pseudo = np.empty((*parameters.shape[:-1], 4, 4))
    trace = np.trace(inertia, axis1=-2, axis2=-1)[..., None, None]
    pseudo[..., :3, :3] = trace / 2 * np.eye(3) - inertia
    pseudo[..., :3, 3] = pseudo[..., 3, :3] = parameters[..., 1:4]
    pseudo[..., 3, 3] = parameters[..., 0]
    return pseudo


def is_physical(parameters: Array) -> Mask:
    """(..., 10) -> (...): whether the pseudo-inertia is positive definite, about the link's own centre of mass."""
    mass = parameters[..., 0]
    heavy = mass > 0
    with np.errstate(over="ignore", invalid="ignore"):  # a mass close to 0 gives an infinite centre
        centre = parameters[..., 1:4] / np.where(heavy, mass, 1.0)[..., None]
        second = pseudo_inertia(parameters)[..., :3, :3] - mass[..., None, None] * _outer(centre)
    finite = np.asarray(np.isfinite(second).all((-2, -1)), dtype=bool)
    moments = np.linalg.eigvalsh(np.where(finite[..., None, None], second, 0.0))
    return heavy & finite & (moments[..., 0] > 0)


@dataclass(frozen=True)
class _Constraints:
    """The constraints in the coordinates Y (n, 4, 4) of the links and y (j,) of the motors; both nominally 1."""

    factor: Array  # (n, 4, 4), L
    motors: Array  # (n,) nominal
    free: Mask  # (n,) motors that are not nominally 0
    link_weight: float
    motor_weight: Array  # (j,)
    link_rows: Array  # (k, n, 4, 4), symmetric
    motor_rows: Array  # (k, j)
    values: Array  # (k,)

    @classmethod
    def of(cls, nominal: Array, spread: tuple[float, Array], rows: Array, values: Array) -> "_Constraints":
        count = len(nominal) // 11
        pseudo = _nominal_pseudo_inertia(nominal[: 10 * count].reshape(-1, 10))
        factor = np.asarray(np.linalg.cholesky(pseudo), dtype=float)
        matrices = np.einsum("knj,jab->knab", rows[:, : 10 * count].reshape(len(rows), count, 10), _BASIS)
        motors = nominal[10 * count :]
        free = motors > 0
        return cls(
            factor=factor,
            motors=motors,
            free=free,
            link_weight=1 / (4 * spread[0] ** 2),
            motor_weight=1 / spread[1][free] ** 2,
            link_rows=np.swapaxes(factor, -1, -2) @ matrices @ factor,
            motor_rows=(rows[:, 10 * count :] * motors)[:, free],
            values=values,
        )

    def transformed(self, left: Array) -> "_Constraints":
        """The same with the constraints combined by `left` (l, k)."""
        return _Constraints(
            self.factor,
            self.motors,
            self.free,
            self.link_weight,
            self.motor_weight,
            np.einsum("lk,knab->lnab", left, self.link_rows),
            left @ self.motor_rows,
            left @ self.values,
        )

    def blocks(self, multipliers: Array) -> tuple[Array, Array]:
        """Y (n, 4, 4) and y (j,) of multipliers (k,) inside the domain."""
        links, motors = self.dual_blocks(multipliers)
        return np.asarray(np.linalg.inv(links), dtype=float), 1 / motors

    def dual_blocks(self, multipliers: Array) -> tuple[Array, Array]:
        """1 + G(nu)/w: (n, 4, 4) and (j,); the domain is where they are positive definite."""
        links = np.eye(4) + np.einsum("k,knab->nab", multipliers, self.link_rows) / self.link_weight
        return links, 1 + multipliers @ self.motor_rows / self.motor_weight

    def inside(self, multipliers: Array) -> bool:
        with np.errstate(over="ignore", invalid="ignore"):  # a trial step may overflow
            links, motors = self.dual_blocks(multipliers)
        if not np.isfinite(links).all():
            return False
        moments = np.linalg.eigvalsh(links)
        return bool(np.all(moments[:, 0] > Newton.small * moments[:, -1]) and motors.min(initial=1.0) > Newton.small)

    def impossible(self, multipliers: Array) -> bool:
        """Whether the multipliers prove that no physical x gives b: G(nu) >= 0 makes nu.Ax >= 0 for all of them, but
        nu.b < 0.
        """
        links, motors = self.dual_blocks(multipliers)
        moments = np.concatenate([np.linalg.eigvalsh(links).ravel(), motors]) - 1
        return bool(multipliers @ self.values < 0 and moments.min() >= -1e-9 * moments.max())

    def residual(self, blocks: tuple[Array, Array]) -> Array:
        """A x - b, (k,)."""
        return np.einsum("knab,nab->k", self.link_rows, blocks[0]) + self.motor_rows @ blocks[1] - self.values

    def curvature(self, blocks: tuple[Array, Array]) -> Array:
        """Minus the Hessian of the dual, (k, k)."""
        root = np.linalg.cholesky((blocks[0] + np.swapaxes(blocks[0], -1, -2)) / 2)
        turned = (np.swapaxes(root, -1, -2) @ self.link_rows @ root).reshape(len(self.values), -1)
        turned_motors = self.motor_rows * blocks[1] / np.sqrt(self.motor_weight)
        return turned @ turned.T / self.link_weight + turned_motors @ turned_motors.T

    def nominal_covariance(self) -> Array:
        """(k, k) of A x from the nominal model's spread."""
        return self.curvature(self.blocks(np.zeros(len(self.values))))

    def parameters(self, blocks: tuple[Array, Array]) -> Array:
        """(11 n,) of the links and motors."""
        pseudo = self.factor @ blocks[0] @ np.swapaxes(self.factor, -1, -2)
        motors = self.motors.copy()
        motors[self.free] *= blocks[1]
        return np.concatenate([np.einsum("jab,nab->nj", _BASIS, pseudo).ravel(), motors])


def _exactly(problem: _Constraints) -> Array | None:
    """Parameters (11 n,) that give the base parameters; None if it is proven that there are none, or none are found.

    In units in which the nominal model's uncertainty is white, the softened problem is easy; softening is reduced in
    steps.
    """
    white = problem.transformed(_whitening(problem.nominal_covariance()))
    multipliers = np.zeros(len(problem.values))
    for softness in (1.0, 1e-2, 1e-4, 1e-6, 0.0):
        found = _maximise(white, softness, multipliers)
        if found is None or white.impossible(found):
            return None
        multipliers = found
    return problem.parameters(white.blocks(multipliers))


def _most_probable(white: _Constraints) -> tuple[Array, bool]:
    """Multipliers (k,) at the maximum of the dual of the second problem, which always has one; whether it was reached.

    Values hundreds of standard deviations away (effort with the wrong sign) put it where blocks are nearly singular
    and Newton's method does not converge from far away. With increased noise, e > 1, the maximum is near; the noise
    is then reduced step by step. If that fails, the last solution is used: it is physical as well, and as far from
    the impossible values as they are from it.
    """
    nothing = np.zeros(len(white.values))
    found = _maximise(white, 1.0, nothing)
    if found is not None:
        return found, True
    multipliers = nothing
    distance = float(np.max(np.abs(white.residual(white.blocks(nothing))), initial=1.0))
    for softness in np.geomspace(distance**2, 1.0, 2 * int(np.ceil(np.log2(distance))) + 1):
        found = _maximise(white, float(softness), multipliers)
        if found is None:
            return multipliers, False
        multipliers = found
    return multipliers, True


def _maximise(problem: _Constraints, softness: float, start: Array) -> Array | None:
    """Multipliers (k,) at the maximum of the dual, softness = e; None if there is none (or none is found).

    Near the maximum full steps are made until rounding stops the progress.
    """
    multipliers, last = start, np.inf
    for _ in range(Newton.steps):
        if softness == 0 and problem.impossible(multipliers):
            return None
        blocks = problem.blocks(multipliers)
        gradient = problem.residual(blocks) - softness * multipliers
        curvature = problem.curvature(blocks) + softness * np.eye(len(gradient))
        scale = np.sqrt(np.diag(curvature))
        if not np.isfinite(curvature).all() or not scale.all():
            return None
        step = np.asarray(np.linalg.lstsq(curvature / np.outer(scale, scale), gradient / scale, rcond=None)[0]) / scale
        slope = float(gradient @ step)
        if slope < 1e-12:  # full Newton steps from here on
            if slope >= last / 100:
                return multipliers
            length = 1.0
        else:
            length = _length(problem, softness, multipliers, step, slope)
        last, before = slope, multipliers
        multipliers = multipliers + length * step
        if length == 1.0 and not problem.inside(multipliers):  # rounding, beside the edge
            return before
    return None


def _length(problem: _Constraints, softness: float, start: Array, step: Array, slope: float) -> float:
    """Length of a step: up to where the dual's slope, which only decreases, is less than half of `slope`."""
    shortest, longest, length = 0.0, np.inf, 1.0
    for _ in range(60):  # halvings
        there = start + length * step
        now = -np.inf
        if problem.inside(there):
            now = float((problem.residual(problem.blocks(there)) - softness * there) @ step)
        if abs(now) <= slope / 2:
            return length
        shortest, longest = (length, longest) if now > 0 else (shortest, length)
        length = 2 * length if np.isinf(longest) else (shortest + longest) / 2
    return shortest


def _whitening(covariance: Array) -> Array:
    """(k, k) that transforms values with this covariance into white noise of standard deviation 1."""
    scale = np.sqrt(np.diag(covariance))
    moments, directions = np.linalg.eigh(covariance / np.outer(scale, scale))
    return (directions / np.sqrt(np.maximum(moments, Newton.small * moments[-1]))).T / scale


def _nominal_pseudo_inertia(links: Array) -> Array:
    """(n, 4, 4) of nominal links (n, 10); non-physical ones are raised to the least mass and second moments."""
    # kg: least nominal mass, by the heaviest link's
    mass = np.maximum(links[:, 0], 1e-6 * (links[:, 0].max(initial=0.0) or 1.0))
    centre = links[:, 1:4] / mass[:, None]
    pseudo = pseudo_inertia(links)
    moments, axes = np.linalg.eigh(pseudo[:, :3, :3] - mass[:, None, None] * _outer(centre))
    # a smaller one is lost in rounding beside the centre's distance
    distant = 1e-9 * mass * (centre**2).sum(-1)
    # a radius of gyration of 1 mm at least
    least = np.maximum(np.maximum(Newton.thinnest * moments[:, -1], 1e-3**2 * mass), distant)
    lifted = np.maximum(moments, least[:, None])
    second = (axes * lifted[:, None, :]) @ np.swapaxes(axes, -1, -2) + mass[:, None, None] * _outer(centre)
    pseudo[:, :3, :3] = np.where((moments[:, 0] < least)[:, None, None], second, pseudo[:, :3, :3])
    pseudo[:, 3, 3] = mass
    return pseudo


def _outer(vectors: Array) -> Array:
    return vectors[..., :, None] * vectors[..., None, :]


def _basis() -> Array:
    """(10, 4, 4) symmetric matrices E with parameter j of a link = <E_j, P>."""
    basis = np.zeros((10, 4, 4))
    basis[0, 3, 3] = 1.0
    for k in range(3):
        basis[1 + k, k, 3] = basis[1 + k, 3, k] = 0.5
    for j, (a, b) in zip(range(4, 10), ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)), strict=True):
        if a == b:
            basis[j, :3, :3] = np.eye(3)
            basis[j, a, a] = 0.0
        else:
            basis[j, a, b] = basis[j, b, a] = -0.5
    return basis


_BASIS = _basis()
