r"""The equations of one axis: the residual effort of the rigid model is a sum of columns.

    effort - nominal = Q z + db v + effects + noise

`nominal` is the torque of CAD and data sheet along the motion. Q z is the deviation of the load (inertia and gravity of
all poses, `rigid`) from it, and db that of the viscous friction. The prior of the robot limits both; it enters as
pseudo-data. Only a residual that these cannot explain within the prior is evidence for an effect.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Model, Shape
from service.diagnosis.fit.cross_products import (
    ORDER,
    Ended,
    Gathered,
    Group,
    Pairing,
    Piece,
    Whitening,
    between_periods,
    noise_model,
    pairing,
    solve,
    symmetric,
)
from service.diagnosis.rows.rigid import Rigid, nominal_load, rigid
from service.diagnosis.rows.signals import EVERY, Complex, Tracks, through, white_covariance
from service.identification.model import finite
from service.model import Array, Mask

COLOURED = 3.0  # times the RMS of white sensor noise: flicker noise and drift give about 2


@dataclass(frozen=True)
class Term:
    """An effect of the model with its shape parameters. `ended`: how the search of the shape ended; None: not searched.
    It takes no part in comparisons.
    """

    effect: str
    shape: Shape = ()
    ended: Ended | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Equations:
    """Filtered and whitened rows of the base columns and of the right side, and methods to add columns.

    The base columns (n, rows, b) are those of the load (`rigid.basis`), followed by the velocity. In the sweeps of one
    pose, which is one fold, they are only combinations of the four rows `driving`. Products are therefore computed with
    these and `unfolded` afterwards.
    """

    tracks: Tracks
    groups: tuple[Group, ...]
    pairs: Pairing
    whitening: Whitening
    rigid: Rigid
    beyond_nominal: Array  # (n, t), see `nominal_right`
    model: Model
    coefficients: Array  # (b,) of the base columns; they define the model
    load: Array  # (3, m), of the model
    parts: Array  # (3, n, t): signals that multiply the load, see `reshaped`
    driving: Array  # (4, n, rows), whitened: `parts` and the velocity
    right: Array  # (n, rows)
    viscous_precision: float
    sensor_noise: float  # RMS in the band of the rows, N m (N)
    period_noise: float | None  # the same from differences between periods, if there are no repeats but periods
    late: float = 0.0  # s, delay of the whole torque, which also delays the columns of effects
    ends_of_steps: dict[tuple[object, ...], Any] = field(repr=False, compare=False, default_factory=dict)
    kept: dict[Term, Gathered] = field(init=False, repr=False, compare=False, default_factory=dict[Term, Gathered])
    systems: dict[tuple[Term, ...], Array] = field(init=False, repr=False, compare=False, default_factory=dict)
    recent: dict[Term, Gathered] = field(init=False, repr=False, compare=False, default_factory=dict[Term, Gathered])

    @property
    def folds(self) -> int:
        """Number of folds; each pose is one."""
        return len(self.pairs.blocks)

    @property
    def width_of_base(self) -> int:
        """b, the number of base columns."""
        return len(self.rigid.basis) + 1

    def precision(self, terms: Sequence[Term]) -> Array:
        """(b, b): the prior of the coefficients of the base columns, without the directions that the terms free."""
        result = np.zeros((self.width_of_base, self.width_of_base))
        result[:-1, :-1] = self.rigid.precision_without([term.effect for term in terms])
        result[-1, -1] = self.viscous_precision
        return result

    def freedom(self, terms: Sequence[Term]) -> int:
        """Number of parameters of terms that are not columns: shapes, and freed directions of the load."""
        return sum(len(term.shape) + self.rigid.freedom(term.effect) for term in terms)

    @cached_property
    def base(self) -> Array:
        """The base columns (n, rows, b), filtered and whitened."""
        return self._of_base(self.driving)

    @cached_property
    def plain_driving(self) -> Array:
        """As `driving`, filtered, but not whitened."""
        return np.stack([self.tracks.rows(signal) for signal in (*self.parts, self.tracks.velocity)])

    @property
    def plain_base(self) -> Array:
        """The base columns (n, rows, b), filtered, but not whitened: N m (N) for coefficients of one unit."""
        return self._of_base(self.plain_driving)

    def _of_base(self, driving: Array) -> Array:
        return of_base(self.rigid, self.tracks, driving)

    def target(self) -> Array:
        """The signal (n, t) that base and effects fit: effort minus that of CAD and data sheet; see `reshaped`."""
        return self.beyond_nominal + self.tracks.summed(self.load - self.rigid.nominal, self.parts - self.tracks.parts)

    def columns(self, term: Term) -> Sequence[Array]:
        """Signals of an effect, (n, t) each."""
        return self._as_measured(term.effect, CATALOGUE[term.effect].columns(self.tracks, self.model, term.shape))

    def _as_measured(self, name: str, columns: Sequence[Array]) -> Sequence[Array]:
        """Columns of an effect with the measurement delay of the model."""
        return columns if CATALOGUE[name].late else self.delayed(columns)

    def delayed(self, signals: Sequence[Array]) -> Sequence[Array]:
        """Signals (n, t) with the measurement delay of the model."""
        if not self.late:
            return signals
        response: Complex = np.exp(-self.tracks.laplace * self.late)
        return [through(signal, self.tracks.rate, response) for signal in signals]

    def rows(self, term: Term) -> Array:
        """Columns of an effect, filtered and whitened, (n, rows, k). BadInput with sweep and axis if not finite."""
        return np.moveaxis(self._whitened(term.effect, self.columns(term)), 0, -1)

    def _whitened(self, name: str, columns: Sequence[Array]) -> Array:
        """(k, n, rows)."""
        if not columns:
            return self.driving[:0]
        signals = np.concatenate(columns)
        if not np.isfinite(signals).all():
            for number, signal in enumerate(signals):
                spec = self.tracks.specs[number % len(self.tracks.specs)]
                finite(signal, f"sweep {spec.id} of {self.tracks.joint}", f"a column of {name}")
        rows = self.tracks.whitened(signals, self.whitening.taps)
        rows = rows.reshape(len(columns), -1, rows.shape[1])
        return self.averaged(rows) if CATALOGUE[name].of_time else rows

    def averaged(self, rows: Array) -> Array:
        """Rows (k, n, rows) of columns of time, in each repeat the mean of all. Where repeats differ, their products
        may be negative, and a column explains less than nothing.
        """
        result = rows.copy()
        for group in self.groups:
            pieces = [np.s_[:, p.sweep, p.first : p.first + p.rows] for p in group.pieces]
            mean = np.mean([rows[piece] for piece in pieces], axis=0)
            for piece in pieces:
                result[piece] = mean
        return result

    def _gathered(self, name: str, columns: Sequence[Array]) -> Gathered:
        return self.pairs.gathered(self._whitened(name, columns))

    def gathered(self, term: Term, *, keep: bool = True) -> Gathered:
        """The usable rows of these columns; the result is cached, if not `keep`, only until others are asked for."""
        found = self.kept.get(term) or self.recent.get(term) or self._gathered(term.effect, self.columns(term))
        (self.kept if keep else self.recent)[term] = found
        # 8 columns of shapes that a search has just tried
        while len(self.recent) > 8:
            del self.recent[next(iter(self.recent))]
        return found

    def scanned(self, name: str, shapes: Sequence[Shape], *, keep: bool = True) -> list[Gathered]:
        """`gathered` for many shapes of an effect."""
        terms = [Term(name, shape) for shape in shapes]
        new = [term for term in terms if term not in self.kept]
        scan = CATALOGUE[name].scan
        if scan is None or not new:
            return [self.gathered(term, keep=keep) for term in terms]
        columns = scan(self.tracks, self.model, [term.shape for term in new])
        found = {
            term: self._gathered(name, self._as_measured(name, own)) for term, own in zip(new, columns, strict=True)
        }
        if keep:
            self.kept.update(found)
        return [found.get(term) or self.kept[term] for term in terms]

    def column(self, term: Term, number: int) -> Gathered:
        """One of an effect's columns, gathered."""
        return tuple(fold[number : number + 1] for fold in self.gathered(term))

    def width(self, term: Term) -> int:
        """Number of columns of an effect."""
        known = self.kept.get(term) or self.recent.get(term)  # a weight has fewer columns than its effect
        return len(known[0] if known else CATALOGUE[term.effect].coefficients(self.tracks))

    @cached_property
    def ends(self) -> tuple[Gathered, Gathered]:
        """The driving rows of the base and the right side, gathered."""
        return self.pairs.gathered(self.driving), self.pairs.gathered(self.right[None])

    @cached_property
    def _turns(self) -> Array:
        """(folds, b, 4): the base columns of each fold as combinations of its driving rows."""
        poses = np.zeros(self.folds, dtype=int)
        for group in self.groups:
            poses[group.fold] = self.tracks.pose_index[group.pieces[0].sweep]
        turns = np.zeros((self.folds, self.width_of_base, 4))
        turns[:, :-1, :3] = np.moveaxis(self.rigid.basis[:, :, poses], -1, 0)
        turns[:, -1, 3] = 1.0
        return turns

    def unfolded(self, products: Array) -> Array:
        """Products (folds, k, 4 + l) with driving rows, then others, as products (folds, k, b + l) with the base."""
        return np.concatenate([products[..., :4] @ self._turns.transpose(0, 2, 1), products[..., 4:]], axis=2)

    def crossed(self, columns: Gathered, pairs: Pairing | None = None) -> Array:
        """(folds, k, k) products of [base, others] from [driving rows, others]; `pairs`: other ones of these groups."""
        half = self.unfolded((pairs or self.pairs).crossed(columns, columns))
        return self.unfolded(half.transpose(0, 2, 1))

    def together(self, terms: Sequence[Term], *more: Gathered) -> Gathered:
        """Gathered [driving rows, terms, more, right side]."""
        driving, right = self.ends
        return joined(driving, *(self.gathered(term) for term in terms), *more, right)

    def system_with(self, terms: Sequence[Term], *more: Gathered) -> Array:
        """(folds, k, k) products of [base, terms, more, right side]; those without `more` are cached."""
        known = None if more else self.systems.get(tuple(terms))
        if known is None:
            known = symmetric(self.crossed(self.together(terms, *more)))
            if not more:
                self.systems[tuple(terms)] = known
        return known

    def system_against(self, right: Gathered, terms: Sequence[Term]) -> Array:
        """(k, k) products of [base, terms, right] for another right side, summed over folds."""
        columns = joined(self.ends[0], *(self.gathered(term) for term in terms), right)
        return symmetric(self.crossed(columns)).sum(axis=0)

    def system_of(self, columns: Array) -> Array:
        """(folds, k, k) products of whitened columns (n, rows, k), the right side last."""
        return symmetric(self.pairs.products(columns))


def joined(*parts: Gathered) -> Gathered:
    """Gathered columns side by side."""
    return tuple(np.concatenate(fold) for fold in zip(*parts, strict=True))


def of_base(model: Rigid, tracks: Tracks, driving: Array) -> Array:
    """Base columns (n, t, b) from the signals, or rows (4, n, t), that drive them."""
    return np.concatenate([model.along(tracks.pose_index, driving[:3]), driving[3][..., None]], axis=-1)


def equations(tracks: Tracks, groups: Sequence[Group], whitening: Whitening | None = None) -> Equations:
    """The equations of the base model. The whitening is computed from the repeats unless it is given.

    BadInput with sweep and axis if squares of the effort overflow.
    """
    axis, prior = tracks.robot.axis(tracks.joint), tracks.robot.prior
    beyond = nominal_right(tracks)
    remaining = tracks.rows(beyond)
    for spec, own in zip(tracks.specs, remaining, strict=True):
        # as a sum over all rows may be
        finite(remaining.size * np.square(own), f"sweep {spec.id} of {tracks.joint}", "the squares of its effort")
    model = rigid(tracks.robot, tracks.joint, tracks.poses, tracks.sizes)
    viscous = axis.viscous_friction or 0.0
    driving = np.stack([tracks.rows(signal) for signal in (*tracks.parts, tracks.velocity)])
    alone = white_covariance(tracks.effort, tracks.inside, tracks.rate, ORDER)
    left = _refitted(tracks, of_base(model, tracks, driving), remaining)
    periods = None if any(len(group.pieces) > 1 for group in groups) else _between_periods(tracks, left, alone)
    if whitening is None:
        whitening = noise_model(left, tracks.usable, groups, alone if periods is None else periods)
    # 0.1 of the axis' inertia: assumed motor inertia if the robot file does not contain it
    given = Equations(
        tracks=tracks,
        groups=tuple(groups),
        pairs=pairing(tracks.usable, groups, ORDER, 1 + max(group.fold for group in groups)),
        whitening=whitening,
        rigid=model,
        beyond_nominal=beyond,
        model=_model(
            tracks,
            model.nominal,
            axis.reflected_motor_inertia or 0.1 * float(model.nominal[0].mean()),
            viscous,
        ),
        coefficients=np.zeros(len(model.basis) + 1),
        load=model.nominal,
        parts=tracks.parts,
        driving=np.stack([whitening(rows) for rows in driving]),
        right=whitening(remaining),
        viscous_precision=(prior.viscous_friction * viscous) ** -2.0 if viscous else 0.0,
        sensor_noise=float(np.sqrt(alone[0])),
        period_noise=None if periods is None else float(np.sqrt(periods[0])),
    )
    return remodelled(given, ())


def nominal_right(tracks: Tracks) -> Array:
    """Effort minus the torque of CAD, counterbalance and data sheet, (n, t)."""
    viscous = tracks.robot.axis(tracks.joint).viscous_friction or 0.0
    return (
        tracks.effort
        - tracks.balance
        - tracks.along(nominal_load(tracks.robot, tracks.joint, tracks.poses))
        - viscous * tracks.velocity
    )


def _refitted(tracks: Tracks, rows: Array, right: Array) -> Array:
    """Residual of rows (n, rows) for the best rigid model: noise equal at all frequencies, no prior."""
    matrix, target = rows[tracks.usable], right[tracks.usable]
    return right - rows @ np.linalg.lstsq(matrix, target, rcond=None)[0]


def _between_periods(tracks: Tracks, left: Array, alone: Array) -> Array | None:
    """Autocovariance of the noise from differences between the periods of each sweep; limited to that of sensor noise
    `alone`, because a larger difference is a different motion in the next period. None without periods.
    """
    lengths = {spec.period for spec in tracks.specs}
    period = lengths.pop() if len(lengths) == 1 else None
    if period is None:
        return None
    found = between_periods(left, tracks.usable, round(period * tracks.rate / EVERY))
    if found is None:
        return None
    return found * min(1.0, COLOURED**2 * alone[0] / found[0])


def _model(tracks: Tracks, load: Array, motor_inertia: float, viscous: float) -> Model:
    """The rigid model from which columns are computed, for a load (3, m)."""
    inertia, torque, slope = load[:, tracks.pose_index]
    weight = tracks.along(np.stack([0 * load[0], load[1], load[2]])) + tracks.balance
    return Model(inertia, motor_inertia, viscous, weight, torque, slope, beside=np.zeros_like(tracks.effort))


def grouped(tracks: Tracks) -> tuple[Group, ...]:
    """Groups of repeats: same pose, block and measured motion. Each pose is a fold."""
    motion, width = tracks.rows(tracks.velocity), tracks.usable.shape[1]
    collected: list[tuple[int, str, list[int]]] = []
    for number, spec in enumerate(tracks.specs):
        pose_index = int(tracks.pose_index[number])
        for other, block, numbers in collected:
            if (other, block) == (pose_index, spec.block) and _same_motion(motion, tracks.usable, numbers[0], number):
                numbers.append(number)
                break
        else:
            collected.append((pose_index, spec.block, [number]))
    return tuple(Group(tuple(Piece(k, 0, width) for k in numbers), pose_index) for pose_index, _, numbers in collected)


def held_back(tracks: Tracks, groups: Sequence[Group]) -> int | None:
    """Index of the pose that is not used to select effects: the one of median weight; None if too few poses."""
    folds = sorted({group.fold for group in groups})
    # 4 with so many poses, one may be held back
    if len(folds) < 4:
        return None
    weight = {fold: float(tracks.gravity[tracks.pose_index == fold].mean()) for fold in folds}
    return sorted(folds, key=lambda fold: weight[fold])[len(folds) // 2]


def applies(given: Equations, name: str) -> bool:
    """Whether the effect is possible for this axis."""
    effect = CATALOGUE[name]
    return name in given.rigid.freed if effect.by_load else effect.applies(given.tracks)


def _same_motion(motion: Array, usable: Mask, one: int, other: int) -> bool:
    """Whether two sweeps have the same motion where both are usable; names may be missing or wrong."""
    both = usable[one] & usable[other]
    first, second = motion[one][both], motion[other][both]
    # 0.2 of the velocity, RMS: largest difference between repeats
    return bool(both.any() and np.sum((first - second) ** 2) < 0.2**2 * np.sum(first**2))


def remodelled(given: Equations, terms: Sequence[Term]) -> Equations:
    """The equations with load and friction from a fit with these terms; some columns are computed from them."""
    values = solve(given.system_with(terms).sum(axis=0), given.precision(terms))[0]
    return with_values(given, terms, values)


def with_values(given: Equations, terms: Sequence[Term], values: Array) -> Equations:
    """The equations with load, friction, delay and torque beside the gear of the coefficients `values`."""
    moved = _delayed(with_base(given, values[: given.width_of_base]), terms, values)
    return reshaped(_driven(moved, terms, values), terms)


def _driven(given: Equations, terms: Sequence[Term], values: Array) -> Equations:
    """The equations with the torque of the terms that a spring does not transmit; coefficients `values` (k,)."""
    if not any(CATALOGUE[term.effect].parts for term in terms):
        return given
    beside, first = np.zeros_like(given.beyond_nominal), given.width_of_base
    for term in terms:
        own = values[first : first + given.width(term)]
        first += len(own)
        on_load = np.resize(CATALOGUE[term.effect].on_load, len(own))
        if not on_load.all():
            on_motor = np.where(on_load, 0.0, own).tolist()
            beside += sum(value * column for value, column in zip(on_motor, given.columns(term), strict=True))
    # 0.01 of the noise
    if np.abs(beside - given.model.beside).max() < 0.01 * given.sensor_noise:
        return given
    return _with_model(given, replace(given.model, beside=beside))


def _with_model(given: Equations, model: Model, **changes: Array) -> Equations:
    moved = replace(given, model=model, **changes)
    moved.kept.update({term: rows for term, rows in given.kept.items() if not CATALOGUE[term.effect].of_model})
    return moved


def _delayed(given: Equations, terms: Sequence[Term], values: Array) -> Equations:
    """The equations with all columns delayed by the delay terms of `terms`, if any; coefficients `values` (k,)."""
    late, first = 0.0, given.width_of_base
    for term in terms:
        late += float(values[first]) if CATALOGUE[term.effect].late else 0.0
        first += given.width(term)
    # 2e-6 s
    if abs(late - given.late) < 2e-6:
        return given
    moved = replace(given, late=late)
    moved.kept.update({term: rows for term, rows in given.kept.items() if CATALOGUE[term.effect].late})
    return moved


def reshaped(given: Equations, terms: Sequence[Term]) -> Equations:
    """The equations with the base columns that result from these terms.

    Behind a spring, a load change dz causes another torque than with a rigid gear. Columns E for it, and the matching
    target, give a Gauss-Newton step from the load z0 of the model:

        effort - nominal + (E - Q) z0 = E z + effects(z0),      the same as  Q z + effects(z0)  at z = z0
    """
    bent = [(CATALOGUE[term.effect].parts, term.shape) for term in terms]
    found = [make(given.tracks, given.model, shape) for make, shape in bent if make is not None]
    parts = found[0] if found else given.tracks.parts
    if given.late:
        parts = np.stack(given.delayed(list(parts)))
    if parts is given.parts:
        return given
    moved = replace(given, parts=parts)
    signals = np.concatenate([*parts, moved.target()])
    *driving, right = given.tracks.whitened(signals, given.whitening.taps).reshape(4, *given.right.shape)
    moved = replace(moved, driving=np.stack([*driving, given.driving[3]]), right=right)
    moved.kept.update(given.kept)
    moved.recent.update(given.recent)
    return moved


def with_base(given: Equations, values: Array) -> Equations:
    """The equations with the load and friction of base coefficients (b,)."""
    tracks = given.tracks
    viscous = (tracks.robot.axis(tracks.joint).viscous_friction or 0.0) + float(values[-1])
    load = given.rigid.load(values[:-1])
    # 0.05 of the inertia in CAD
    load[0] = np.maximum(load[0], 0.05 * given.rigid.nominal[0])
    model = _model(tracks, load, given.model.motor_inertia, max(viscous, 0.0))
    if _alike(model, given.model, tracks.robot.axis(tracks.joint).rated_effort):
        return given
    return _with_model(given, replace(model, beside=given.model.beside), load=load, coefficients=values)


def _alike(one: Model, other: Model, rated: float) -> bool:
    same = 1e-3  # relative change of the model below which it counts as unchanged
    inertia = np.allclose(one.inertia, other.inertia, rtol=same, atol=0.0)
    torque = np.allclose(one.torque, other.torque, rtol=0.0, atol=same * rated)
    return bool(inertia and torque and np.isclose(one.viscous, other.viscous, rtol=same, atol=0.0))
