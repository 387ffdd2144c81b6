"""Visibility of an effect in the existing sweeps, together with other effects and at all, and in sweeps not yet run.

Measured and predicted sweeps share one set of columns. Therefore coefficients of the measured sweeps are valid for
the predicted ones, the poses of both determine the possible gravity errors, and the gear temperature continues.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from service import BadInput
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.fit.cross_products import Gathered, solve
from service.diagnosis.fit.equations import Equations, Term, equations, grouped
from service.diagnosis.rows.signals import Tracks, tracks
from service.identification.design.diagnosis_sweeps import BLOCKS, DesignedSweep, full_design, measured_blocks
from service.identification.design.excitation import Excitation, velocity_setpoint
from service.model import Array, Recording, Sweep


@dataclass(frozen=True)
class PredictedSweeps:
    """Equations of measured and predicted sweeps; coefficients are fitted to the measured ones only."""

    given: Equations
    measured: int  # number of measured sweeps, which are the first ones

    @property
    def tracks(self) -> Tracks:
        return self.given.tracks

    def effort(self, terms: Sequence[Term]) -> Array:
        """Whitened rows (predicted sweeps, rows) of the torque of load, friction and terms; fitted coefficients."""
        given, rows = self.given, [self.given.rows(term) for term in terms]
        every = np.concatenate([given.base, *rows, given.right[..., None]], axis=-1)
        values = solve(given.system_of(every).sum(axis=0), given.precision(terms))[0]
        return every[self.measured :, :, :-1] @ values

    def beyond_rigid(self, effort: Array, sweeps: Sequence[int]) -> float:
        """Chi-squared of an effort (predicted sweeps, rows) in some sweeps, minus the part that load and friction can
        explain within the prior and the measured sweeps.
        """
        at = np.array(sweeps) + self.measured
        good = self.tracks.usable[at]
        columns, left = self.given.base[at][good], effort[np.array(sweeps)][good]
        known = self._known + columns.T @ columns
        across = columns.T @ left
        return float(left @ left - across @ np.linalg.solve(known, across))

    @cached_property
    def _known(self) -> Array:
        """Information matrix (b, b) of the base: prior and measured sweeps."""
        b = self.given.width_of_base
        system = self.given.system_of(self.given.base).sum(axis=0)
        return system + self.given.precision(()) + 1e-12 * np.trace(system) * np.eye(b)


def predict_sweeps(given: Equations, measured: Sequence[Sweep], designed: Sequence[DesignedSweep]) -> PredictedSweeps:
    """`measured`: the sweeps of `given`. BadInput if the designed sweeps cannot be combined with them."""
    motion = tracks(given.tracks.robot, given.tracks.joint, [*measured, *_followed(given, designed)])
    groups = tuple(
        replace(group, pieces=tuple(replace(piece, rows=motion.usable.shape[1]) for piece in group.pieces))
        for group in given.groups
    )
    return PredictedSweeps(equations(motion, groups, given.whitening), len(given.tracks.specs))


def _followed(given: Equations, designed: Sequence[DesignedSweep]) -> Iterator[Sweep]:
    index = given.tracks.robot.index(given.tracks.joint)
    return (expected(one, one.spec.pose[index]) for one in designed)


def expected(designed: DesignedSweep, start: float) -> Sweep:
    """A sweep that follows its set-point exactly from a position."""
    spec = designed.spec
    excitation = Excitation(
        spec.offset_velocity, spec.sines, spec.period or 1.0, spec.periods or 1, designed.ramp, designed.settle
    )
    time = np.arange(round(designed.duration * spec.sample_rate)) / spec.sample_rate
    velocity = velocity_setpoint(excitation, time)
    return Sweep(spec, Recording(time, np.zeros_like(time), velocity, start + np.cumsum(velocity) / spec.sample_rate))


TESTABLE = 25.0  # chi-squared that an effect of `TYPICAL` size must cause to be testable
TYPICAL = 0.01  # of the rated effort
BIASED = 1.0  # chi-squared of an unseen effect that the rigid model takes: its change in standard deviations, squared


@dataclass(frozen=True, slots=True)
class UntestableEffect:
    """An effect that is not visible in the sweeps. `blocks`: those not yet run in which it would be visible.

    `biases`: whether it has weight: at `TYPICAL` size it would change the estimate by more than its standard deviation.
    """

    blocks: tuple[str, ...]
    biases: bool


def grid(given: Equations, name: str) -> list[tuple[float, ...]]:
    """A few shapes of an effect: the first parameter takes all values of its grid, the others the middle one."""
    shapes = CATALOGUE[name].shape(given.tracks, given.model)
    if not shapes:
        return [()]
    middle = [shape.grid[len(shape.grid) // 2] for shape in shapes[1:]]
    return [(first, *middle) for first in shapes[0].grid[:: max(1, len(shapes[0].grid) // 3)]]


def left(given: Equations, terms: Sequence[Term], column: Gathered) -> tuple[float, float]:
    """Fraction and power of a gathered column that rigid model and terms cannot represent."""
    raw = float(np.sum(given.pairs.crossed(column, column)))
    power = solve(given.system_against(column, terms), given.precision(terms))[1]
    return (power / raw if raw > 0 else 0.0), power


def visible_part(given: Equations, terms: Sequence[Term], name: str) -> float:
    """Fraction of the power of an effect's essential column that rigid model and terms cannot represent; best shape."""
    effect, most = CATALOGUE[name], 0.0
    for shape in grid(given, name):
        most = max(most, left(given, terms, given.column(Term(name, shape), effect.essential))[0])
    return most


def shows_beside(given: Equations, terms: Sequence[Term], term: Term) -> bool:
    """Whether an effect of `TYPICAL` size and this shape has a column visibly different from the terms."""
    size = TYPICAL * given.tracks.robot.axis(given.tracks.joint).rated_effort
    for number, column in enumerate(given.columns(term)):
        peak = float(np.abs(column).max())
        if peak > 0 and left(given, terms, given.column(term, number))[1] * (size / peak) ** 2 > TESTABLE:
            return True
    return False


def untestable(given: Equations, names: Sequence[str], sweeps: Sequence[Sweep]) -> dict[str, UntestableEffect]:
    """Effects that are not visible in these sweeps.

    The assumed size of an effect is `TYPICAL` of the rated effort in the sweeps of a full design. Its whitened column y
    is split by the least squares of the rigid model, X with information A = X'X + prior. What the model cannot take
    (y'y - v'Av, v = A^-1 X'y) makes the effect visible. What it takes, v'Av, is the change v of the estimate in units
    of its covariance A^-1: above `BIASED`, some combination of its parameters changes by more than its standard
    deviation (Cauchy-Schwarz). Frequent effects of every gear, such as Coulomb friction, therefore need no list: where
    an axis turns, their columns are large, so they are either visible or of weight. Play on a flank that gravity never
    lets go has no column in these sweeps, and no weight for them.
    """
    ahead = _missing(given, sweeps)
    result: dict[str, UntestableEffect] = {}
    for name in names:
        if CATALOGUE[name].by_load or CATALOGUE[name].as_weight:  # what the rigid model takes of it is weight
            continue
        shown = [_shown(given, ahead, Term(name, shape)) for shape in grid(given, name)]
        if max(here for here, _, _ in shown) < TESTABLE:
            blocks = {block for _, _, there in shown for block, square in there.items() if square >= TESTABLE}
            biases = max(taken for _, taken, _ in shown) > BIASED
            result[name] = UntestableEffect(tuple(block for block in BLOCKS if block in blocks), biases)
    return result


def shown_in(
    given: Equations, measured: Sequence[Sweep], designed: Sequence[DesignedSweep], names: Sequence[str]
) -> bool:
    """Whether one of these effects would be testable once the designed sweeps are measured, too."""
    motion = tracks(given.tracks.robot, given.tracks.joint, [*measured, *_followed(given, designed)])
    both = equations(motion, grouped(motion), given.whitening)
    return any(_shown(both, None, Term(name, shape))[0] >= TESTABLE for name in names for shape in grid(both, name))


def _missing(given: Equations, sweeps: Sequence[Sweep]) -> PredictedSweeps | None:
    """Predictions for the blocks not yet run, in one of the poses."""
    motion = given.tracks
    blocks = [block for block in BLOCKS if block not in measured_blocks(motion.specs)]
    if not blocks:
        return None
    try:
        return predict_sweeps(given, sweeps, once(given, blocks, motion.poses[:1]))
    except BadInput:
        return None  # they do not fit between the limits


def once(given: Equations, blocks: Sequence[str], poses: Array) -> tuple[DesignedSweep, ...]:
    """Blocks run once in poses, after all measured sweeps."""
    motion = given.tracks
    return full_design(
        motion.robot, motion.joint, poses, repeats=1, sample_rate=motion.specs[0].sample_rate, blocks=blocks,
        started_at=max(spec.started_at for spec in motion.specs) + 30.0, revisit=False,
    )  # fmt: skip


def _shown(given: Equations, ahead: PredictedSweeps | None, term: Term) -> tuple[float, float, dict[str, float]]:
    """Chi-squared of an effect's essential column that the rigid model cannot take and that it takes, in the existing
    sweeps; and of the first in each block not yet run.
    """
    essential = CATALOGUE[term.effect].essential
    size = TYPICAL * given.tracks.robot.axis(given.tracks.joint).rated_effort
    here = given.columns(term)[essential]
    column = here if ahead is None else ahead.given.columns(term)[essential]
    peak = float(np.abs(column).max())
    if peak == 0:
        return 0.0, 0.0, {}
    blocks: dict[str, float] = {}
    if ahead is not None:
        rows = given.whitening(ahead.tracks.rows(column))[ahead.measured :] * size / peak
        for number, spec in enumerate(ahead.tracks.specs[ahead.measured :]):
            square = ahead.beyond_rigid(rows, [number])
            blocks[spec.block] = max(square, blocks.get(spec.block, 0.0))
    gathered = given.column(term, essential)
    visible, scale = left(given, (), gathered)[1], (size / peak) ** 2
    taken = float(np.sum(given.pairs.crossed(gathered, gathered))) - visible
    return visible * scale, taken * scale, blocks
