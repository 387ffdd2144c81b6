"""The next experiment: of all that can be run, what separates the rivals best per second of machine time.

Each rival predicts a torque along the set-points, with the coefficients that the data gave it; what the rigid model
cannot take of the difference of two, in units of the noise, is their separation. As no catalogue is exact, a difference
counts for less where it is a small part of the torque that either predicts.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.fit.equations import Term
from service.diagnosis.fit.select import RIVAL, TOLERANCE, Selection
from service.diagnosis.sensitivity.design import (
    BLOCKS,
    REVISITED,
    DesignedSweep,
    full_design,
    kinds,
    machine_time,
    measured_blocks,
    once_more,
    other_poses,
    warm_up,
)
from service.diagnosis.sensitivity.predicted_sweeps import Prospect, prospect
from service.diagnosis.summary import in_words
from service.diagnosis.verdict import Verdict
from service.errors import BadInput
from service.recording import Sweep

Array = NDArray[np.float64]

TEST_MASS = "test_mass"
FULL_DESIGN = "full_design"
MORE_POSES = "more_poses"
WARM_UP = "warm_up"
BACKWARD = "backward_slow"
BY_MASS = frozenset({"torque_constant_error", "payload"})
DRIFT = "friction_temperature_drift"
ENOUGH = 100.0  # chi-squared of a clear separation
LITTLE = 10.0  # of none worth a sweep
REPEATS = 2
SET_UP = 60.0  # s that an experiment costs besides its sweeps: somebody approves and starts it
BOLTING = 600.0  # s that bolting a mass on and off takes
AT_ONCE = 4  # poses of an experiment: more take longer and tell the same
MOST_POSES = 10  # beyond, more of them tell nothing new


@dataclass(frozen=True)
class NextExperiment:
    """What to measure next: a kind, the blocks and sweeps, the machine time, s, the separation expected, and why.

    Kinds: a block of `BLOCKS`; `full_design`, several of them; `more_poses`; `warm_up`; `test_mass`, whose sweeps are
    to be run with a known mass on the last link.
    """

    kind: str
    blocks: tuple[str, ...]
    sweeps: tuple[DesignedSweep, ...]
    seconds: float
    separation: float | None
    between: tuple[str, ...]
    reason: str


@dataclass(frozen=True)
class _Proposal:
    kind: str
    blocks: tuple[str, ...]
    sweeps: tuple[DesignedSweep, ...]

    @property
    def seconds(self) -> float:
        return machine_time(self.sweeps)


def next_experiment(
    selection: Selection,
    verdict: Verdict,
    rivals: Sequence[str],
    hidden: dict[str, tuple[str, ...]],
    sweeps: Sequence[Sweep],
) -> NextExperiment | None:
    """None when nothing is open. `hidden`: what the `sweeps` cannot show, and the blocks that would."""
    campaign = _Campaign(selection, tuple(sweeps))
    if verdict in (Verdict.NONE, Verdict.UNTESTABLE):
        unseen = [name for name, blocks in hidden.items() if blocks]
        blocks = [block for block in campaign.open if any(block in hidden[name] for name in unseen)]
        return (
            campaign.missing(blocks, f"These sweeps cannot show {in_words(unseen)}; those would.") if unseen else None
        )
    if verdict is Verdict.UNKNOWN:
        if campaign.open:
            return campaign.missing(campaign.open, "The sweeps that are missing show what these cannot.")
        return campaign.poses("All kinds of sweeps were run: other poses show where it changes.")
    if verdict is not Verdict.AMBIGUOUS:
        return None
    others = [name for name in rivals if name not in BY_MASS]
    if set(rivals) >= BY_MASS and (len(others) < 2 or not campaign.open):
        return campaign.mass(rivals)
    return campaign.best(rivals) or (
        campaign.missing(campaign.open, f"No single block is sure to separate {in_words(rivals)}: the missing all may.")
        if campaign.open
        else campaign.poses(f"All kinds of sweeps were run: other poses may separate {in_words(rivals)}.")
    )


@dataclass(frozen=True)
class _Campaign:
    """What was found in which sweeps, and what could follow them."""

    selection: Selection
    sweeps: tuple[Sweep, ...]

    @property
    def open(self) -> list[str]:
        """Blocks not yet run."""
        return [block for block in BLOCKS if block not in measured_blocks(self.selection.given.tracks.specs)]

    def best(self, rivals: Sequence[str]) -> NextExperiment | None:
        """The proposal that separates best per second; None if none is likely to."""
        proposals = list(self._proposals(rivals))
        try:
            ahead = prospect(self.selection.given, self.sweeps, [s for one in proposals for s in one.sweeps])
        except BadInput:
            return None
        effort = {name: ahead.effort(explanation_with(self.selection, name)) for name in rivals}
        first, scored = 0, list[tuple[float, _Proposal]]()
        for proposal in proposals:
            numbers = range(first, first + len(proposal.sweeps))
            scored.append((_separation(ahead, effort, numbers, self.selection.rigid.cost), proposal))
            first += len(proposal.sweeps)
        warming = [one for one in scored if one[1].kind == WARM_UP and one[0] >= LITTLE]
        score, chosen = max(warming or scored, key=lambda one: one[0] / (SET_UP + one[1].seconds), default=(0.0, None))
        if chosen is None or score < LITTLE:
            return None
        reason = f"{chosen.kind} separates {in_words(rivals)} best for its time."
        return _experiment(chosen, score, rivals, reason)

    def mass(self, rivals: Sequence[str]) -> NextExperiment | None:
        """The slow sweeps with a known mass; the other direction first, where one alone would tell too little."""
        if BACKWARD in self.open:  # friction that grows with the weight looks like a gain in one direction alone
            reason = "A test mass tells the torque constant from a payload once both directions were run without it."
            return self.missing([BACKWARD], reason)
        specs, here = self.selection.given.tracks.specs, self._poses.tolist()
        slow = [
            spec
            for spec, kind in zip(specs, kinds(specs), strict=True)
            if kind in REVISITED and list(spec.pose) in here and spec.repeat < REPEATS
        ]
        sweeps = once_more(slow, self._start)
        return NextExperiment(
            TEST_MASS, tuple(REVISITED), sweeps, machine_time(sweeps) + BOLTING, None, tuple(rivals),
            "No sweep tells a wrong torque constant from an unknown payload: bolt a known mass on and measure again.",
        )  # fmt: skip

    def missing(self, blocks: Sequence[str], reason: str) -> NextExperiment | None:
        """Some blocks in the poses there are."""
        try:
            sweeps = self._designed(blocks, self._poses, revisit=len(blocks) > 1)
        except BadInput:
            return None
        kind = blocks[0] if len(blocks) == 1 else FULL_DESIGN
        return _experiment(_Proposal(kind, tuple(blocks), sweeps), None, (), reason)

    def poses(self, reason: str) -> NextExperiment | None:
        """All blocks in two other poses."""
        proposals = [] if len(self.selection.given.tracks.poses) > MOST_POSES else list(self._in_other_poses(BLOCKS))
        return _experiment(proposals[0], None, (), reason) if proposals else None

    @property
    def _poses(self) -> Array:
        """The poses measured; of many, some that differ in what gravity does."""
        motion = self.selection.given.tracks
        if len(motion.poses) <= AT_ONCE:
            return motion.poses
        first = [int(np.argmax(motion.spot == spot)) for spot in range(len(motion.poses))]
        order = np.argsort(motion.gravity[first, 0], kind="stable")
        return motion.poses[order[np.linspace(0, len(order) - 1, AT_ONCE).round().astype(int)]]

    def _proposals(self, rivals: Sequence[str]) -> Iterator[_Proposal]:
        for block in self.open:
            try:
                yield _Proposal(block, (block,), self._designed((block,), self._poses))
            except BadInput:
                continue
        measured = [block for block in REVISITED if block not in self.open]
        yield from self._in_other_poses(measured or REVISITED[:1])
        if DRIFT in rivals:
            try:
                yield _Proposal(WARM_UP, (WARM_UP,), self._warming())
            except BadInput:
                return

    def _in_other_poses(self, blocks: Sequence[str]) -> Iterator[_Proposal]:
        motion = self.selection.given.tracks
        poses = other_poses(motion.robot, motion.joint, motion.poses)
        for pair in (poses[k : k + 2] for k in range(0, len(poses), 2)):
            try:
                yield _Proposal(MORE_POSES, tuple(blocks), self._designed(blocks, pair))
            except BadInput:
                continue

    def _designed(self, blocks: Sequence[str], poses: Array, *, revisit: bool = False) -> tuple[DesignedSweep, ...]:
        motion = self.selection.given.tracks
        return full_design(
            motion.robot, motion.joint, poses, repeats=REPEATS, sample_rate=motion.specs[0].sample_rate, blocks=blocks,
            started_at=self._start, revisit=revisit,
        )  # fmt: skip

    def _warming(self) -> tuple[DesignedSweep, ...]:
        motion = self.selection.given.tracks
        rate = motion.specs[0].sample_rate
        return warm_up(motion.robot, motion.joint, motion.poses[0], sample_rate=rate, started_at=self._start)

    @property
    def _start(self) -> float:
        return max(spec.started_at for spec in self.selection.given.tracks.specs) + 30.0


def explanation_with(selection: Selection, name: str) -> tuple[Term, ...]:
    """The terms of the explanation in which an effect takes part."""
    if name in selection.chosen.names:
        return selection.chosen.terms
    with_it = [one for one in selection.tried if one.terms[-1].effect == name]
    return min(with_it, key=lambda one: one.criterion).terms


def _separation(ahead: Prospect, effort: dict[str, Array], numbers: Sequence[int], excess: float) -> float:
    """Chi-squared of the difference of each two rivals in some of the sweeps, up to `ENOUGH` each, summed.

    `excess`: what the rigid model leaves of the measured sweeps.
    """
    beyond = {name: ahead.beyond_rigid(one, numbers) for name, one in effort.items()}
    total = 0.0
    for one, other in combinations(effort, 2):
        difference = ahead.beyond_rigid(effort[one] - effort[other], numbers)
        blur = TOLERANCE * (excess + max(beyond[one], beyond[other])) / RIVAL
        total += min(difference / max(1.0, blur), ENOUGH)
    return total


def _experiment(proposal: _Proposal, separation: float | None, rivals: Sequence[str], reason: str) -> NextExperiment:
    return NextExperiment(
        proposal.kind, proposal.blocks, proposal.sweeps, proposal.seconds, separation, tuple(rivals), reason
    )
