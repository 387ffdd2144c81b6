"""The next experiment: of all blocks not yet measured, the one that separates the rivals best per second.

Each rival predicts a torque along the block's set-point, with the coefficients that the data gave it; what the rigid
model cannot take of the difference, in units of the noise, is the separation.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.design import BLOCKS, DesignedSweep, full_design
from service.diagnosis.effects import CATALOGUE
from service.diagnosis.effects.effect import Model
from service.diagnosis.equations import Equations, Term, solve
from service.diagnosis.select import Selection
from service.diagnosis.signals import tracks
from service.diagnosis.verdict import Verdict
from service.errors import BadInput
from service.identification.excitation import Excitation, velocity_setpoint
from service.recording import Recording, Sweep

Array = NDArray[np.float64]

TEST_MASS = "test_mass"
STANDSTILL = "standstill"
ENOUGH = 100.0  # chi-squared of a clear separation
MINUTES = 600.0  # s that bolting a mass on takes


@dataclass(frozen=True)
class NextExperiment:
    """What to measure next: a kind, the blocks and poses, the machine time, s, the separation expected, and why."""

    kind: str
    blocks: tuple[str, ...]
    sweeps: tuple[DesignedSweep, ...]
    seconds: float
    separation: float | None
    between: tuple[str, ...]
    reason: str


def next_experiment(
    selection: Selection, verdict: Verdict, rivals: Sequence[str], hidden: Sequence[str]
) -> NextExperiment | None:
    """None when nothing is open."""
    if verdict not in (Verdict.AMBIGUOUS, Verdict.UNKNOWN, Verdict.UNTESTABLE):
        return None
    given = selection.given
    by_mass = [name for name in rivals if CATALOGUE[name].by_test_mass]
    measured = {spec.block for spec in given.tracks.specs}
    open_blocks = [block for block in BLOCKS if block not in measured]
    others = [name for name in rivals if name not in by_mass]
    if by_mass and (not open_blocks or len(others) < 2):
        return NextExperiment(
            TEST_MASS, (), (), MINUTES, None, tuple(rivals),
            "No sweep tells a wrong torque constant from an unknown payload: bolt a known mass on and measure again.",
        )  # fmt: skip
    if not open_blocks:
        return _more(given, "more_poses", BLOCKS, "All kinds of sweeps were run: other poses show where it changes.")
    if len(rivals) < 2:
        return _more(given, "full_design", open_blocks, "The sweeps that are missing show what these cannot.")
    try:
        scored = [(*_separation(selection, rivals, block), block) for block in open_blocks]
    except BadInput:
        return None
    score, seconds, best = max(scored, key=lambda one: one[0] / one[1])
    return NextExperiment(
        best, (best,), _designed(given, [best]), seconds, score, tuple(rivals),
        f"Block {best} separates {', '.join(rivals)} best for its time.",
    )  # fmt: skip


def _more(given: Equations, kind: str, blocks: Sequence[str], reason: str) -> NextExperiment | None:
    try:
        sweeps = _designed(given, blocks)
    except BadInput:
        return None
    return NextExperiment(kind, tuple(blocks), sweeps, sum(s.duration for s in sweeps), None, (), reason)


def _designed(given: Equations, blocks: Sequence[str]) -> tuple[DesignedSweep, ...]:
    motion = given.tracks
    last = max(spec.started_at for spec in motion.specs)
    return full_design(
        motion.robot, motion.joint, motion.poses, sample_rate=motion.specs[0].sample_rate, blocks=blocks,
        started_at=last + 30.0,
    )  # fmt: skip


def _separation(selection: Selection, rivals: Sequence[str], block: str) -> tuple[float, float]:
    """Chi-squared by which a block in all poses separates each two rivals, summed up to `ENOUGH` each; its seconds."""
    given = selection.given
    # a hold alone has no motion to be judged by
    blocks = [BLOCKS[0], block] if block == STANDSTILL else [block]
    designed, index = _designed(given, blocks), given.tracks.robot.index(given.tracks.joint)
    motion = tracks(given.tracks.robot, given.tracks.joint, [expected(s, s.spec.pose[index]) for s in designed])
    there = replace(given, tracks=motion, model=_model(given, motion.spot))
    torque = {name: _torque(given, there, explanation_with(selection, name)) for name in rivals}
    base = np.stack([given.whitening(motion.rows(c)) for c in (motion.acceleration, motion.velocity)], axis=-1)
    total = 0.0
    for one, other in combinations(rivals, 2):
        rows = np.concatenate([base, (torque[one] - torque[other])[..., None]], axis=-1)[motion.usable]
        total += min(solve(rows.T @ rows, 0.0)[1], ENOUGH)
    return total, sum(sweep.duration for sweep in designed)


def explanation_with(selection: Selection, name: str) -> tuple[Term, ...]:
    """The terms of the explanation in which an effect takes part."""
    if name in selection.chosen.names:
        return selection.chosen.terms
    return next(one.terms for one in selection.tried if one.terms[-1].effect == name)


def _torque(given: Equations, there: Equations, terms: Sequence[Term]) -> Array:
    """Whitened rows of what terms, with the coefficients that the data give them, would need along another motion."""
    system = given.system_of(
        np.concatenate([given.base, *(given.rows(t) for t in terms), given.right[..., None]], axis=-1)
    )
    values = solve(system, given.viscous_precision)[0][1:]
    return np.concatenate([there.rows(term) for term in terms], axis=-1) @ values


def _model(given: Equations, spot: "NDArray[np.int_]") -> Model:
    """The fitted model in the same poses, for other sweeps."""
    of_spot = {int(k): inertia for k, inertia in zip(given.tracks.spot, given.model.inertia.tolist(), strict=True)}
    return replace(given.model, inertia=np.array([of_spot[int(k)] for k in spot]))


def expected(designed: DesignedSweep, start: float) -> Sweep:
    """A sweep that follows its set-point from a position."""
    spec = designed.spec
    excitation = Excitation(
        spec.offset_velocity, spec.sines, spec.period or 1.0, spec.periods or 1, designed.ramp, designed.settle
    )
    time = np.arange(round(designed.duration * spec.sample_rate)) / spec.sample_rate
    velocity = velocity_setpoint(excitation, time)
    return Sweep(spec, Recording(time, np.zeros_like(time), velocity, start + np.cumsum(velocity) / spec.sample_rate))
