r"""From an unknown gap to a law: the residual of an axis on a small dictionary of physics, as a proposal.

The rigid model, the effects in the model and the law are fitted together, with the rows, whitening and cross-repeat
products of the diagnosis. At most two families are selected, forwards, by cross-validation over the poses, first on
coarse grids of their shapes, then on fine ones. Each pose is in turn held out from all of this; the gap that is told
is that of these held-out sweeps. As in `fit.gap`, the rigid model is fitted to all poses. A law is not an effect: it
never enters a model.

Sparse regression on a dictionary: Brunton, Proctor and Kutz, PNAS 113 (2016). PySINDy is not used: it has neither a
base with a prior nor products between repeats, without which noisy regressors select terms that are not there.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product

import numpy as np

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Shape, spread
from service.diagnosis.effects.friction import warmth
from service.diagnosis.fit.cross_products import symmetric
from service.diagnosis.fit.equations import Equations, Term, reshaped
from service.diagnosis.fit.fitted import Parameter
from service.diagnosis.fit.gap import improves, plain_columns
from service.diagnosis.rows.signals import bristles, through
from service.model import Array, Indices, Mask

MOST = 2  # families of a law
LEAST_POSES = 3
FEWER = 0.8  # of the held-out cost: a family that leaves more is not selected
WEIGHTY = 0.05  # of the first held-out cost: a family that lowers it by less is not selected
CLOSED = 0.1  # of the held-out gap, RMS: a law that closes less is not told
AGREED = 0.6  # of the selections, each without one pose: a family that is in fewer is not told
DRIVEN = 0.05  # of the energy of a friction: work on the axis above is unphysical
FINER = 4  # times as many values of the first shape parameter on the fine grid

Pairs = tuple[tuple[str, str], ...]  # names and units


@dataclass(frozen=True)
class Law:
    """A proposed law of the gap of one axis. `before`, `after`: RMS, N m (N), of `sweeps` held-out sweeps without and
    with it. `largest`: position of the axis, rad (m), in the pose where its torque is largest; `torque`: its RMS there.
    """

    kinds: tuple[str, ...]
    parameters: dict[str, Parameter]
    before: float
    after: float
    sweeps: int
    largest: float
    torque: float

    def sentence(self, joint: str, unit: str) -> str:
        words = "; besides, ".join(WORDS[kind][0] for kind in self.kinds)
        return (
            f"{joint}: a law is proposed for the gap: {words}. On held-out sweeps it closes {100 * self.closed:.0f} % "
            f"of the gap, from {self.before:.3g} {unit} to {self.after:.3g} {unit}. It is largest at "
            f"{self.largest:+.2f} rad, with {self.torque:.3g} {unit} RMS. It enters no model."
        )

    @property
    def formula(self) -> str:
        return " + ".join(WORDS[kind][1] for kind in self.kinds)

    @property
    def closed(self) -> float:
        """Part of the held-out gap that it closes."""
        return 1 - self.after / self.before

    @property
    def of_position(self) -> bool:
        """Whether other poses test it best."""
        return bool(OF_POSITION & set(self.kinds))


@dataclass(frozen=True)
class _Family:
    """Signals (n, t) of one kind, by its shape; coefficients and shape parameters with units, and grids of these."""

    kind: str
    coefficients: Pairs
    columns: Callable[[Shape], Sequence[Array]]
    shape: Pairs = ()
    grids: tuple[tuple[float, ...], ...] = ()

    def shapes(self, finer: int = 1) -> list[Shape]:
        """All shapes; on grids with `finer` times as many values of the first parameter, and half of that of others."""
        times = [finer, *(max(finer // 2, 1) for _ in self.grids[1:])]
        return list(product(*(_finer(grid, count) for grid, count in zip(self.grids, times, strict=False))))


def _finer(grid: Sequence[float], times: int) -> list[float]:
    at = np.linspace(0, len(grid) - 1, times * (len(grid) - 1) + 1)
    return [float(value) for value in np.interp(at, range(len(grid)), grid)]


@dataclass(frozen=True)
class _Member:
    """A family at one shape; `steps`: distances of neighbouring values of its parameters (one value: 0)."""

    family: _Family
    shape: Shape
    columns: Sequence[Array]
    steps: tuple[float, ...]

    @property
    def kind(self) -> str:
        return self.family.kind


WORDS = {  # in words, and as a formula
    "position": ("it changes with the position", "c0 + c1 q + c2 q^2 + c3 q^3"),
    "beyond": ("it grows beyond a position", "c max(q - q0, 0)^p"),
    "below": ("it grows below a position", "c max(q0 - q, 0)^p"),
    "lever": ("it acts like a strut on a lever", "c sin(q - q0) / sqrt(1 - k cos(q - q0))"),
    "weight": ("it acts like a weight", "a cos q + b sin q"),
    "ripple": ("it ripples with the motor's angle", "a sin(o theta) + b cos(o theta)"),
    "dry": ("it opposes the motion at every speed alike", "c sign(v)"),
    "power": ("it opposes the motion by a power of the speed", "c |v|^p sign(v)"),
    "slow": ("it opposes the motion at low speed", "c exp(-|v| / v0) sign(v)"),
    "load": ("it opposes the motion in proportion to the load", "c |T| sign(v)"),
    "dies": ("it opposes the motion and dies away from the start of a sweep", "c exp(-t / t0) sign(v)"),
    "warm": ("it opposes the motion and changes with warmth", "(c W + d W |v|) sign(v), W' = |v| - W / t0"),
    "temperature": ("it opposes the motion and changes with the temperature", "(c + d |v|) (K - K0) sign(v)"),
    "time": ("it drifts with time", "c t"),
    "since": ("it builds up on the way after a reversal", "c z, dz/dq = (1 - z sign(v)) / x0"),
    "hanging": (
        "it acts like a mass that the axis carries on a spring",
        "m J (H - 1) a, H = (w^2 + 2 d w s) / (s^2 + 2 d w s + w^2)",
    ),
}
FRICTION = {"dry", "power", "slow", "load", "dies", "since"}  # must not drive the axis
OF_POSITION = {"position", "beyond", "below", "lever", "weight"}
OF_TIME = {"warm", "temperature", "time"}  # differ between repeats
FORCE = (("c", "N m"),)


def _families(given: Equations) -> Iterator[_Family]:
    """The dictionary of an axis, with columns of the catalogue where it has them."""
    tracks, model = given.tracks, given.model
    q, v, way, s = tracks.position, tracks.velocity, tracks.direction, tracks.laplace
    yield from _of_position(q, tracks.inside, prismatic=tracks.prismatic)
    cogging = CATALOGUE["cogging_torque"]
    if cogging.applies(tracks):
        waves = cogging.columns(tracks, model, ())
        orders = [float(name.partition("_")[2]) for name, _ in cogging.coefficients(tracks)][::2]
        for k, order in enumerate(orders):
            yield _Family(
                "ripple",
                (("a", "N m"), ("b", "N m")),
                lambda _, k=k: waves[2 * k : 2 * k + 2],
                (("o", ""),),
                ((order,),),
            )
    yield _Family("dry", FORCE, lambda _: [way])
    for p in (0.5, 2.0, 3.0):
        unit = f"N m (s/rad)^{p:g}"
        yield _Family("power", (("c", unit),), lambda at: [np.sign(v) * np.abs(v) ** at[0]], (("p", ""),), ((p,),))
    paces = spread(0.1 * tracks.speed, 2.0 * tracks.speed, 4)
    yield _Family("slow", FORCE, lambda at: [way * np.exp(-np.abs(v) / at[0])], (("v0", "rad/s"),), (paces,))
    yield _Family("load", (("c", ""),), lambda _: [way * np.abs(model.transmitted(tracks.acceleration))])
    paces = spread(0.2, 5.0, 8)
    yield _Family("dies", FORCE, lambda at: [way * np.exp(-tracks.time / at[0])], (("t0", "s"),), (paces,))
    heated = (("c", "N m/rad"), ("d", "N m s/rad2"))
    paces = spread(20.0, 2e3, 4)
    yield _Family("warm", heated, lambda at: [x * warmth(tracks, at[0]) for x in (way, v)], (("t0", "s"),), (paces,))
    if tracks.temperature is not None:
        above = tracks.temperature - float(tracks.temperature[tracks.inside].mean())
        yield _Family("temperature", (("c", "N m/K"), ("d", "N m s/(rad K)")), lambda _: [way * above, v * above])
    yield _Family("time", (("c", "N m/s"),), lambda _: [tracks.clock - float(tracks.clock.mean())])
    ways = spread(0.01 * tracks.speed / (2 * np.pi), tracks.speed / (2 * np.pi), 4)
    yield _Family("since", FORCE, lambda at: [*bristles(q, at)], (("x0", "rad"),), (ways,))

    def hanging(at: Shape) -> Sequence[Array]:
        w, d = at
        carried = np.asarray((w**2 + 2 * d * w * s) / (s * s + 2 * d * w * s + w**2), dtype=np.complex128)
        return [model.load_inertia * through(tracks.acceleration, tracks.rate, carried - 1)]

    swings = tuple(2 * np.pi * f for f in spread(2.0, 20.0, 18))
    yield _Family("hanging", (("m", ""),), hanging, (("w", "rad/s"), ("d", "")), (swings, (0.02, 0.06)))


def _of_position(q: Array, inside: Mask, *, prismatic: bool) -> Iterator[_Family]:
    units = ("N m", "N m/rad", "N m/rad2", "N m/rad3")
    for degree in (1, 2, 3):
        named = tuple((f"c{k}", units[k]) for k in range(degree + 1))
        yield _Family("position", named, lambda _, degree=degree: [q**k for k in range(degree + 1)])
    low, high = float(q[inside].min()), float(q[inside].max())
    places = tuple(low + (high - low) * k / 7 for k in range(7))
    for p in (1.0, 2.0):
        named, shape = (("c", units[int(p)]),), (("q0", "rad"), ("p", ""))
        yield _Family("beyond", named, lambda at: [np.maximum(q - at[0], 0.0) ** at[1]], shape, (places, (p,)))
        yield _Family("below", named, lambda at: [np.maximum(at[0] - q, 0.0) ** at[1]], shape, (places[1:], (p,)))
    if not prismatic:
        yield _Family("weight", (("a", "N m"), ("b", "N m")), lambda _: [np.cos(q), np.sin(q)])
        around, shape = tuple(float(place) for place in np.linspace(-np.pi, np.pi, 17)), (("q0", "rad"), ("k", ""))

        def lever(at: Shape) -> Sequence[Array]:
            q0, k = at
            return [np.sin(q - q0) / np.sqrt(1 - k * np.cos(q - q0))]

        yield _Family("lever", FORCE, lever, shape, (around, (0.5, 0.8, 0.95)))


def _entries(families: Sequence[_Family], finer: int = 1) -> list[_Member]:
    result: list[_Member] = []
    for family in families:
        shapes = family.shapes(finer)
        values = [sorted(set(grid)) for grid in zip(*shapes, strict=True)]
        for shape in shapes:
            steps = [
                min((abs(other - value) for other in grid if other != value), default=0.0)
                for value, grid in zip(shape, values, strict=True)
            ]
            result.append(_Member(family, shape, family.columns(shape), tuple(steps)))
    return result


Chosen = tuple[int, ...]


class _Dictionary:
    """Products of the columns of entries on the equations of an axis, and selections from them."""

    def __init__(self, given: Equations, fixed: Sequence[Term], entries: Sequence[_Member]) -> None:
        self.entries, self._given = entries, given
        signals = np.concatenate([column for entry in entries for column in entry.columns])
        rows = given.tracks.whitened(signals, given.whitening.taps).reshape(-1, *given.right.shape)
        of_time = [entry.kind in OF_TIME for entry in entries for _ in entry.columns]
        rows[of_time] = given.averaged(rows[of_time])
        self.system = symmetric(given.crossed(given.together(fixed, given.pairs.gathered(rows))))
        self.folds = [k for k, one in enumerate(self.system) if one[-1, -1] != 0]
        ends = np.cumsum([0, *(len(entry.columns) for entry in entries)]).tolist()
        self._slots = [range(a, b) for a, b in pairwise(ends)]
        width, b = len(self.system[0]) - 1 - ends[-1], given.width_of_base
        # 1e-9 of a column's own product: what these poses do not determine
        self.prior = 1e-9 * np.diag(np.diag(self.system.sum(axis=0))[:width])
        self.prior[:b, :b] += given.precision(fixed)

    def base_of(self, folds: Sequence[int]) -> Array:
        """(b, k + 1): minus the base, fitted to some folds, of each column and of the right side."""
        b, total = len(self.prior), self.system[folds].sum(axis=0)
        return np.asarray(-np.linalg.solve(total[:b, :b] + self.prior, total[:b, b:]), dtype=np.float64)

    def trained(self, folds: Sequence[int]) -> Array:
        """(k + 1, k + 1): products of columns and right side of some folds, with the base fitted to these alone."""
        b, total = len(self.prior), self.system[folds].sum(axis=0)
        return total[b:, b:] + total[b:, :b] @ self.base_of(folds)

    @cached_property
    def held(self) -> Array:
        """(folds, k + 1, k + 1): the same of each fold, with the base fitted to all, and its part of the prior's."""
        turn = self.base_of(self.folds)
        turned = np.vstack([turn, np.eye(turn.shape[1])])
        held = turned.T @ self.system @ turned + turn.T @ self.prior @ turn / len(self.folds)
        return np.asarray(held, dtype=np.float64)

    def index(self, chosen: Chosen) -> list[int]:
        return [k for entry in chosen for k in self._slots[entry]]

    def coefficients(self, trained: Array, chosen: Chosen) -> Array:
        """(k,) of the columns of `chosen`, by least squares."""
        return _solved(trained, np.array([self.index(chosen)]))[0]

    def _costs(self, trained: dict[int, Array], sets: Sequence[Chosen]) -> Array:
        """Costs (sets,) on folds, each with coefficients of the others."""
        indices = [self.index(one) for one in sets]
        costs = np.empty(len(sets))
        for count in {len(index) for index in indices}:  # sets of equally many columns at once
            alike = [k for k, index in enumerate(indices) if len(index) == count]
            index = np.array([indices[k] for k in alike], dtype=int).reshape(len(alike), count)
            at = np.pad(index, ((0, 0), (0, 1)), constant_values=-1)
            costs[alike] = 0.0
            for out, products in trained.items():
                vectors = np.pad(-_solved(products, index), ((0, 0), (0, 1)), constant_values=1.0)
                held = self.held[out][at[:, :, None], at[:, None, :]]
                costs[alike] += np.einsum("si,sij,sj->s", vectors, held, vectors)
        return costs

    def selected(self, folds: Sequence[int], allowed: Sequence[str]) -> Chosen:
        """The entries of these kinds, at most one of each, that lower the cost on `folds`, each held out in turn."""
        trained = {out: self.trained([fold for fold in folds if fold != out]) for out in folds}
        chosen: Chosen = ()
        least = first = float(self._costs(trained, [()])[0])
        for _ in range(MOST):
            kinds = {*allowed} - {self.entries[k].kind for k in chosen}
            tried = [(*chosen, k) for k, entry in enumerate(self.entries) if entry.kind in kinds]
            costs = self._costs(trained, tried)
            if costs.min(initial=np.inf) > min(FEWER * least, least - WEIGHTY * first):
                break
            chosen, least = tried[int(np.argmin(costs))], float(costs.min())
        return tuple(sorted(chosen))

    def kinds(self, chosen: Chosen) -> tuple[str, ...]:
        return tuple(self.entries[k].kind for k in chosen)

    def torque(self, chosen: Chosen, values: Array) -> Array:
        """(n, t), N m (N), of a law before the filter."""
        columns = [column for k in chosen for column in self.entries[k].columns]
        return np.tensordot(values, np.stack(columns), axes=1)


def _solved(products: Array, index: Indices) -> Array:
    """(sets, k): coefficients of the columns `index` (sets, k), by least squares; the right side is the last column."""
    inner = products[index[:, :, None], index[:, None, :]]
    scale = np.sqrt(np.maximum(np.diagonal(inner, axis1=1, axis2=2), 1e-60))
    # 1e-9: combinations that these folds cannot tell apart
    scaled = inner / (scale[:, :, None] * scale[:, None, :]) + 1e-9 * np.eye(index.shape[1])
    right: Array = products[index, -1] / scale
    solution = np.asarray(np.linalg.solve(scaled, right[..., None]), dtype=np.float64)
    return solution[..., 0] / scale


def proposed_law(given: Equations, fixed: Sequence[Term]) -> Law | None:
    """The law of the residual of the rigid model and the terms `fixed`; None if there are too few poses, or if no
    physical law closes a significant part of the gap on held-out sweeps.
    """
    given = reshaped(given, fixed)
    tracks, families = given.tracks, list(_families(given))
    coarse = _Dictionary(given, fixed, _entries(families))
    folds = coarse.folds
    if len(folds) < LEAST_POSES:
        return None
    every = [family.kind for family in families]
    others = {out: [fold for fold in folds if fold != out] for out in folds}
    found = {out: coarse.kinds(coarse.selected(rest, every)) for out, rest in others.items()}
    # in the order of the selection from all
    kinds = [
        kind
        for kind in coarse.kinds(coarse.selected(folds, every))
        if sum(kind in one for one in found.values()) >= AGREED * len(folds)
    ]
    if not kinds:
        return None
    fine = _Dictionary(given, fixed, _entries([one for one in families if one.kind in kinds], FINER))
    chosen = fine.selected(folds, kinds)
    kinds = list(fine.kinds(chosen))
    apart = {out: fine.selected(rest, kinds) for out, rest in others.items() if {*kinds} <= {*found[out]}}
    apart = {out: one for out, one in apart.items() if {*fine.kinds(one)} == {*kinds}}
    if not chosen or len(apart) < AGREED * len(folds):
        return None
    values = {out: fine.coefficients(fine.trained(others[out]), one) for out, one in apart.items()}
    columns, turn = plain_columns(given, fixed), fine.base_of(folds)
    before = tracks.rows(given.target()) + columns @ turn[:, -1]
    after = before.copy()
    for out, one in apart.items():  # a pose without which another law was selected gains nothing
        taken = tracks.rows(fine.torque(one, values[out])) + columns @ (turn[:, fine.index(one)] @ values[out])
        after[tracks.pose_index == out] -= taken[tracks.pose_index == out]
    own = np.isin(tracks.pose_index, folds)
    rms, left = (float(np.sqrt(np.mean(one[own][tracks.usable[own]] ** 2))) for one in (before, after))
    if left > (1 - CLOSED) * rms or not improves(given, before, after):
        return None
    best = fine.coefficients(fine.trained(folds), chosen)
    parameters = _parameters(fine, chosen, best, apart, values)
    if parameters is None or not _physical(given, [fine.entries[k] for k in chosen], best):
        return None
    torque = tracks.rows(fine.torque(chosen, best))
    sizes = [float(np.sqrt(np.mean(torque[tracks.pose_index == fold] ** 2))) for fold in folds]
    return Law(
        kinds=fine.kinds(chosen),
        parameters=parameters,
        before=rms,
        after=left,
        sweeps=int(own.sum()),
        largest=float(tracks.poses[folds[int(np.argmax(sizes))], tracks.robot.index(tracks.joint)]),
        torque=max(sizes),
    )


def _physical(given: Equations, chosen: Sequence[_Member], values: Array) -> bool:
    """Whether friction takes energy in each sweep, and a mass is positive."""
    tracks, rest = given.tracks, values.tolist()
    friction = np.zeros_like(tracks.velocity)
    for entry in chosen:
        own, rest = rest[: len(entry.columns)], rest[len(entry.columns) :]
        if entry.kind == "hanging" and own[0] <= 0:
            return False
        if entry.kind in FRICTION:
            friction = friction + sum(c * column for c, column in zip(own, entry.columns, strict=True))
    energy = np.sum(friction * tracks.velocity * tracks.inside, axis=1)
    return bool(energy.min() >= -DRIVEN * np.abs(energy).max())


def _parameters(
    fine: _Dictionary, chosen: Chosen, best: Array, apart: dict[int, Chosen], values: dict[int, Array]
) -> dict[str, Parameter] | None:
    """Coefficients and shapes by name (of a second family, with a 2 where both have the name); std by the jackknife
    over poses, of a shape at least that of the grid. None if no coefficient of a family is two std from 0.
    """
    alike = [out for out, own in values.items() if len(own) == len(best)]
    spreads = np.sqrt(max(len(alike) - 1, 1)) * np.std([values[out] for out in alike], axis=0)
    numbers = ((float(value), float(std)) for value, std in zip(best, spreads, strict=True))
    result: dict[str, Parameter] = {}
    for place, entry in enumerate(fine.entries[k] for k in chosen):
        found = [(name, *next(numbers), unit) for name, unit in entry.family.coefficients]
        if all(std > abs(value) / 2 for _, value, std, _ in found):
            return None
        for k, ((name, unit), value) in enumerate(zip(entry.family.shape, entry.shape, strict=True)):
            others = [fine.entries[one[place]].shape[k] for one in apart.values()]
            grid = entry.steps[k] / np.sqrt(12)
            found.append((name, value, max(grid, float(np.sqrt(len(others) - 1) * np.std(others))), unit))
        for name, value, std, unit in found:
            result[f"{name}_2" if name in result else name] = Parameter(value, float(std), unit)
    return result
