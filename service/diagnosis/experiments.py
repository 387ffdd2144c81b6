"""The next experiment: the one that separates the rivals best per second of machine time.

Each rival predicts a torque along the set-points with its fitted coefficients. The separation of two rivals is the part
of the difference of their torques that the rigid model cannot fit, in units of the noise. Because the models are
simplified, a difference counts less if it is a small part of the predicted torques.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.fit.equations import Term
from service.diagnosis.fit.select import RIVAL, TOLERANCE, Selection
from service.diagnosis.sensitivity import PredictedSweeps, UntestableEffect, predict_sweeps
from service.diagnosis.summary import in_words
from service.diagnosis.verdict import Verdict
from service.identification.design.diagnosis_sweeps import (
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
from service.model.errors import BadInput
from service.model.recording import Sweep

Array = NDArray[np.float64]

TEST_MASS = "test_mass"
FULL_DESIGN = "full_design"
MORE_POSES = "more_poses"
WARM_UP = "warm_up"
BACKWARD = "backward_slow"
BY_MASS = frozenset({"torque_constant_error", "payload"})
DRIFT = "friction_temperature_drift"
ENOUGH = 100.0  # chi-squared: the separation is clear
REPEATS = 2
BOLTING = 600.0  # s to mount and remove a test mass


@dataclass(frozen=True)
class NextExperiment:
    """What to measure next: kind, blocks and sweeps, machine time in s, expected separation, and the reason.

    Kinds: a block of `BLOCKS`; `full_design`, several blocks; `more_poses`; `warm_up`; `test_mass`: sweeps with a
    known mass on the last link.
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
    hidden: Mapping[str, UntestableEffect],
    sweeps: Sequence[Sweep],
) -> NextExperiment | None:
    """None if nothing is undecided. `hidden`: what the `sweeps` cannot show."""
    campaign = _Campaign(selection, tuple(sweeps))
    if verdict in (Verdict.NONE, Verdict.UNTESTABLE):
        unseen = [name for name, one in hidden.items() if one.blocks]
        blocks = [block for block in campaign.open if any(block in hidden[name].blocks for name in unseen)]
        if unseen:
            return campaign.missing(blocks, f"These sweeps cannot show {in_words(unseen)}; those would.")
        if weighty := [name for name, one in hidden.items() if one.biases]:
            return campaign.poses(f"No other sweep of these poses shows {in_words(weighty)}: other poses may.")
        if not campaign.repeated:
            return campaign.missing(
                campaign.open or REVISITED, "Nothing was repeated, so noise is not known; those are."
            )
        return None
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
    """The result, its sweeps, and the sweeps that could follow."""

    selection: Selection
    sweeps: tuple[Sweep, ...]

    @property
    def open(self) -> list[str]:
        """Blocks that were not run yet."""
        return [block for block in BLOCKS if block not in measured_blocks(self.selection.given.tracks.specs)]

    @property
    def repeated(self) -> bool:
        """Whether sweeps were repeated, so that there is a noise floor."""
        return any(len(group.pieces) > 1 for group in self.selection.given.groups)

    def best(self, rivals: Sequence[str]) -> NextExperiment | None:
        """The proposal with the best separation per second; None if none is likely to separate the rivals."""
        little = 10.0  # chi-squared: below, a sweep is not worth its time
        proposals = list(self._proposals(rivals))
        try:
            ahead = predict_sweeps(self.selection.given, self.sweeps, [s for one in proposals for s in one.sweeps])
        except BadInput:
            return None
        effort = {name: ahead.effort(explanation_with(self.selection, name)) for name in rivals}
        first, scored = 0, list[tuple[float, _Proposal]]()
        for proposal in proposals:
            numbers = range(first, first + len(proposal.sweeps))
            scored.append((_separation(ahead, effort, numbers, self.selection.rigid.cost), proposal))
            first += len(proposal.sweeps)
        warming = [one for one in scored if one[1].kind == WARM_UP and one[0] >= little]
        # 60.0 s of each experiment in addition to its sweeps: approval and start by a person
        score, chosen = max(warming or scored, key=lambda one: one[0] / (60.0 + one[1].seconds), default=(0.0, None))
        if chosen is None or score < little:
            return None
        reason = f"{chosen.kind} separates {in_words(rivals)} best for its time."
        return _experiment(chosen, score, rivals, reason)

    def mass(self, rivals: Sequence[str]) -> NextExperiment | None:
        """The slow sweeps with a known mass; first the other direction, if one alone gives too little information."""
        if BACKWARD in self.open:  # in one direction alone, load-dependent friction looks like a gain
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
        """Some blocks in the existing poses."""
        try:
            sweeps = self._designed(blocks, self._poses, revisit=len(blocks) > 1)
        except BadInput:
            return None
        kind = blocks[0] if len(blocks) == 1 else FULL_DESIGN
        return _experiment(_Proposal(kind, tuple(blocks), sweeps), None, (), reason)

    def poses(self, reason: str) -> NextExperiment | None:
        """All blocks in two other poses."""
        # 10 more poses give no new information
        proposals = [] if len(self.selection.given.tracks.poses) > 10 else list(self._in_other_poses(BLOCKS))
        return _experiment(proposals[0], None, (), reason) if proposals else None

    @property
    def _poses(self) -> Array:
        """The measured poses; if there are many, a subset with different gravity torques."""
        at_once = 4  # poses of one experiment: more poses take longer without more information
        motion = self.selection.given.tracks
        if len(motion.poses) <= at_once:
            return motion.poses
        first = [int(np.argmax(motion.pose_index == pose_index)) for pose_index in range(len(motion.poses))]
        order = np.argsort(motion.gravity[first, 0], kind="stable")
        return motion.poses[order[np.linspace(0, len(order) - 1, at_once).round().astype(int)]]

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
    """The terms of the explanation that contains an effect."""
    if name in selection.chosen.names:
        return selection.chosen.terms
    with_it = [one for one in selection.tried if one.terms[-1].effect == name]
    return min(with_it, key=lambda one: one.criterion).terms


def _separation(ahead: PredictedSweeps, effort: dict[str, Array], numbers: Sequence[int], excess: float) -> float:
    """Sum over all pairs of rivals of the chi-squared of their difference in some sweeps, at most `ENOUGH` per pair.

    `excess`: residual of the rigid model on the measured sweeps.
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
