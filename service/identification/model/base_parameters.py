r"""The base parameters: combinations of inertial parameters that can be identified from the inertias about the axes.

With W (rows of all measured axes over the workspace, columns scaled to unit length) of rank r, r columns span the
rest,

    W = W_b [1  R1^-1 R2] P^T     so     W x = W_b beta,   beta = K x                    (Gautier 1991, QR)

The independent columns are selected greedily in the order of the parameters, base to tip, so that a dependent
parameter is regrouped into the ones before it, as in the symbolic rules of Gautier and Khalil (1990). Rank:
eigenvalues of the Gram matrix (fast, but squaring halves the digits), confirmed by the singular values of the
selected columns.
"""

from dataclasses import dataclass
from itertools import count, islice

import numpy as np

from service import BadInput
from service.identification.model.regressor import axis_rows, parameter_names
from service.model import Array, Chain


@dataclass(frozen=True)
class Independence:
    """When a column of the regressor is independent."""

    tolerance: float = 1e-9  # of a unit column: minimum of its part outside the span of the selected columns
    samples: int = 400  # random poses that represent the workspace
    clear: float = 1e3  # times `TOLERANCE`: the residual of a dependent column over all samples is far below


@dataclass(frozen=True)
class BaseParameters:
    """The base set of a chain for the measured axes.

    names (r,); `columns` (r,) of the parameter vector that are kept; `combination` (r, 11 n) with beta = K x.
    """

    names: tuple[str, ...]
    columns: tuple[int, ...]
    combination: Array

    def rows(self, chain: Chain, joint: int, poses: Array) -> Array:
        """Rows (m, r) of axis `joint` in the base parameters."""
        return axis_rows(chain, joint, poses)[:, list(self.columns)]


def base_parameters(chain: Chain, axes: tuple[int, ...]) -> BaseParameters:
    """The base parameters determined by the inertias about `axes`, over the chain's whole joint range."""
    return reduce_columns(_sampled_rows(chain, axes, Independence.samples, seed=0), parameter_names(chain))


def combination_of(chain: Chain, axes: tuple[int, ...], columns: tuple[int, ...]) -> Array | None:
    """`BaseParameters.combination` for given columns; None if they are not a base of this chain."""
    rows = _sampled_rows(chain, axes, 60, seed=1)  # few samples suffice: the rank is known
    scale = _scale(rows)
    combination = _combination(rows / scale, scale, list(columns))
    left = (rows - rows[:, list(columns)] @ combination) / scale
    return combination if np.abs(left).max() < Independence.clear * Independence.tolerance else None


def joint_ranges(chain: Chain) -> tuple[Array, Array]:
    """Lower and upper position limits (n,) of the joints, rad (m); one revolution for joints with a larger range."""
    ends = np.array([(joint.lower, joint.upper) for joint in chain.joints])
    once = np.array([(-np.pi, np.pi) for _ in chain.joints])
    turns = [joint.kind == "revolute" and joint.upper - joint.lower > 2 * np.pi for joint in chain.joints]
    lower, upper = np.where(np.array(turns)[:, None], once, ends).T
    return lower, upper


def reduce_columns(rows: Array, names: tuple[str, ...]) -> BaseParameters:
    """The base set of an observation matrix (m, p) with column names `names`."""
    scale = _scale(rows)
    scaled = rows / scale
    if len(scaled) > scaled.shape[1]:
        # the columns of R have the same lengths and angles, and are short
        scaled = np.asarray(np.linalg.qr(scaled, mode="r"), dtype=float)
    chosen = _independent(scaled)
    singular = np.linalg.svd(scaled[:, chosen], compute_uv=False)
    if singular[-1] < Independence.tolerance:
        raise BadInput("base parameters", f"the chosen columns are dependent to {singular[-1]:.1e}")
    combination = _combination(scaled, scale, chosen)
    return BaseParameters(
        tuple(_name(row, names, column) for row, column in zip(combination, chosen, strict=True)),
        tuple(chosen),
        combination,
    )


def condition_number(rows: Array) -> float:
    """Condition number of an observation matrix (m, r) with columns scaled to unit length; inf if rank deficient."""
    length = np.linalg.norm(rows, axis=0)
    if len(rows) < rows.shape[1] or not length.all():
        return float("inf")
    singular = np.linalg.svd(rows / length, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > Independence.tolerance * singular[0] else float("inf")


def _sampled_rows(chain: Chain, axes: tuple[int, ...], samples: int, seed: int) -> Array:
    """Rows (m, 11 n) of all `axes` in random poses over the joints' ranges."""
    lower, upper = joint_ranges(chain)
    poses = np.random.default_rng(seed).uniform(lower, upper, (samples, len(lower)))
    return np.vstack([axis_rows(chain, axis, poses) for axis in axes])


def _scale(rows: Array) -> Array:
    """Lengths (p,) of the columns; 1 for those that are zero."""
    length = np.linalg.norm(rows, axis=0)
    return np.where(length > Independence.tolerance * length.max(initial=0.0), length, 1.0)


def _combination(scaled: Array, scale: Array, chosen: list[int]) -> Array:
    """K (r, p) with ``rows = rows[:, chosen] @ K`` for ``rows = scaled * scale``."""
    share = np.linalg.lstsq(scaled[:, chosen], scaled, rcond=None)[0]
    # rounding
    share[np.abs(share) < 1e-8 * np.abs(share).max(axis=1, keepdims=True, initial=1.0)] = 0.0
    return share * scale / scale[chosen][:, None]


def _independent(scaled: Array) -> list[int]:
    """Columns, first to last, that are not in the span of those selected before (Gram-Schmidt, twice)."""
    span = np.zeros((len(scaled), 0))
    chosen: list[int] = []
    for column in range(scaled.shape[1]):
        rest = scaled[:, column]
        for _ in range(2):
            rest = rest - span @ (span.T @ rest)
        length = np.linalg.norm(rest)
        if length > Independence.clear * Independence.tolerance:
            span = np.hstack([span, (rest / length)[:, None]])
            chosen.append(column)
    return chosen


def _name(row: Array, names: tuple[str, ...], leader: int) -> str:
    """``Izz(link_2) + Jm(joint_2) + 1.44 m(link_3)``: the kept parameter first, then those regrouped into it."""
    parts = [names[leader]]
    for column in np.flatnonzero(row):
        if column == leader:
            continue
        size = abs(row[column])
        factor = "" if abs(size - 1) < 1e-6 else f"{size:.4g} "
        parts.append(f"{'-' if row[column] < 0 else '+'} {factor}{names[column]}")
    return " ".join(parts)


def spread_evenly(number: int, lower: Array, upper: Array) -> Array:
    """`number` points (number, n) of the box from `lower` to `upper` (n,), in their units; the first is `lower`."""
    unit = np.stack([_mirrored(number, prime) for prime in _primes(len(lower))], axis=1)
    return unit * (upper - lower) + lower


def _mirrored(number: int, base: int) -> Array:
    """Of 0 to `number` - 1, in [0, 1)."""
    values, rest, place = np.zeros(number), np.arange(number), 1.0 / base
    while rest.any():
        rest, digit = np.divmod(rest, base)
        values += digit * place
        place /= base
    return values


def _primes(number: int) -> tuple[int, ...]:
    return tuple(islice((n for n in count(2) if all(n % k for k in range(2, n))), number))
