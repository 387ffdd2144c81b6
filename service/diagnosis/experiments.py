"""The next experiment: the one that separates the rivals best per second of machine time.

Each rival predicts a torque along the set-points with its fitted coefficients. The separation of two rivals is the part
of the difference of their torques that the rigid model cannot fit, in units of the noise. Because the models are
simplified, a difference counts less if it is a small part of the predicted torques.

Only what the machine can run and what tells something new is proposed. If there is nothing, the diagnosis ends, and
says why.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from service import BadInput
from service.diagnosis.fit.equations import Term
from service.diagnosis.fit.select import RIVAL, TOLERANCE, Selection
from service.diagnosis.law import Law
from service.diagnosis.sensitivity import PredictedSweeps, UntestableEffect, predict_sweeps, shown_in
from service.diagnosis.summary import in_words
from service.diagnosis.verdict import Verdict
from service.identification.design.diagnosis_sweeps import (
    BLOCKS,
    REVISITED,
    WARMING,
    DesignedSweep,
    full_design,
    kinds,
    machine_time,
    measured_blocks,
    once_more,
    other_poses,
    warm_up,
)
from service.model import Array, Sweep, SweepSpec

Runnable = Callable[[Sequence[DesignedSweep]], tuple[tuple[DesignedSweep, ...], str]]
"""Of some sweeps, in one plan, those that the machine can run, and why the first of the others cannot ("": all can)."""

TEST_MASS = "test_mass"
FULL_DESIGN = "full_design"
MORE_POSES = "more_poses"
WARM_UP = "warm_up"
BACKWARD = "backward_slow"
BY_MASS = frozenset({"torque_constant_error", "payload"})
DRIFT = "friction_temperature_drift"
ENOUGH = 100.0  # chi-squared: the separation is clear
REPEATS = 2
MOST_EXPERIMENTS = 3  # experiments of one axis, after which it is not diagnosed further
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


def all_runnable(sweeps: Sequence[DesignedSweep]) -> tuple[tuple[DesignedSweep, ...], str]:
    """The `Runnable` of a machine that is not known."""
    return tuple(sweeps), ""


def next_experiment(
    selection: Selection,
    verdict: Verdict,
    rivals: Sequence[str],
    hidden: Mapping[str, UntestableEffect],
    sweeps: Sequence[Sweep],
    runnable: Runnable = all_runnable,
    experiments: int = 0,
    law: Law | None = None,
) -> tuple[NextExperiment | None, str]:
    """What to measure next; if that is nothing, the reason for which the diagnosis ends undecided ("": it is decided).

    `hidden`: what the `sweeps` cannot show. `experiments`: how many were run; after `MOST_EXPERIMENTS` none follows.
    `law`: proposed for an unknown gap; the experiment tests it.
    """
    campaign = _Campaign(selection, tuple(sweeps), runnable)
    wanted = _wanted(campaign, verdict, rivals, hidden, law) if experiments < MOST_EXPERIMENTS else None
    if wanted is not None or verdict in (Verdict.NONE, Verdict.NAMED):
        return wanted, ""
    if experiments >= MOST_EXPERIMENTS:
        why = f"after {experiments} experiments"
    elif campaign.refused:
        why = f"and the machine cannot run what may decide it ({campaign.refused[0]})"
    else:
        why = "and no other sweep may decide it"
    return None, f"{_left_open(verdict, rivals, hidden)} {why}"


def _left_open(verdict: Verdict, rivals: Sequence[str], hidden: Mapping[str, UntestableEffect]) -> str:
    if verdict is Verdict.AMBIGUOUS:
        return f"{in_words(rivals)} explain the sweeps alike"
    if verdict is Verdict.UNKNOWN:
        return "no effect of the catalogue explains the sweeps"
    unseen = [name for name, one in hidden.items() if one.biases]
    return f"the sweeps do not show {in_words(unseen, 'or')}" if unseen else "no repeat of a sweep tells its noise"


def _wanted(
    campaign: "_Campaign",
    verdict: Verdict,
    rivals: Sequence[str],
    hidden: Mapping[str, UntestableEffect],
    law: Law | None,
) -> NextExperiment | None:
    """The first that can be run, of what may decide it."""
    if verdict is Verdict.NAMED:
        return None
    if verdict in (Verdict.NONE, Verdict.UNTESTABLE):
        wanted = None
        if unseen := [name for name, one in hidden.items() if one.blocks]:
            blocks = [block for block in campaign.open if any(block in hidden[name].blocks for name in unseen)]
            wanted = campaign.missing(blocks, f"These sweeps cannot show {in_words(unseen)}; those would.")
        if weighty := [name for name, one in hidden.items() if one.biases]:
            other = f"No other sweep of these poses shows {in_words(weighty)}: other poses may."
            wanted = wanted or campaign.poses(other, weighty)
        if campaign.repeated:
            return wanted
        blocks = campaign.open or REVISITED
        return wanted or campaign.missing(blocks, "Nothing was repeated, so noise is not known; those are.", again=True)
    if law is not None:
        tests = "It tests the proposed law."
        first = campaign.poses(tests) if law.of_position else None
        return first or campaign.missing(campaign.open, tests) or campaign.poses(tests)
    if verdict is Verdict.UNKNOWN:
        return campaign.missing(campaign.open, "The sweeps that are missing show what these cannot.") or campaign.poses(
            "All kinds of sweeps were run: other poses show where it changes."
        )
    wanted = None
    if set(rivals) >= BY_MASS and (len([name for name in rivals if name not in BY_MASS]) < 2 or not campaign.open):
        wanted = campaign.mass(rivals)
    all_may = f"No single block is sure to separate {in_words(rivals)}: the missing all may."
    return (
        wanted
        or campaign.best(rivals)
        or campaign.missing(campaign.open, all_may)
        or campaign.poses(f"All kinds of sweeps were run: other poses may separate {in_words(rivals)}.")
    )


@dataclass(frozen=True)
class _Campaign:
    """The result, its sweeps, and the sweeps that could follow. `refused`: why some of them cannot be run."""

    selection: Selection
    sweeps: tuple[Sweep, ...]
    runnable: Runnable
    refused: list[str] = field(default_factory=list[str])

    @property
    def open(self) -> list[str]:
        """Blocks that were not run yet."""
        return [block for block in BLOCKS if block not in measured_blocks(self._specs)]

    @property
    def _specs(self) -> tuple[SweepSpec, ...]:
        return self.selection.given.tracks.specs

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
        for score, one in sorted(warming or scored, key=lambda one: -one[0] / (60.0 + one[1].seconds)):
            chosen = self._possible(one)
            if score >= little and chosen is not None:
                reason = f"{chosen.kind} separates {in_words(rivals)} best for its time."
                return _experiment(chosen, score, rivals, reason)
        return None

    def mass(self, rivals: Sequence[str]) -> NextExperiment | None:
        """The slow sweeps with a known mass; first the other direction, if one alone gives too little information."""
        if BACKWARD in self.open:  # in one direction alone, load-dependent friction looks like a gain
            reason = "A test mass tells the torque constant from a payload once both directions were run without it."
            return self.missing([BACKWARD], reason)
        specs, here = self._specs, self._poses.tolist()
        slow = [
            spec
            for spec, kind in zip(specs, kinds(specs), strict=True)
            if kind in REVISITED and list(spec.pose) in here and spec.repeat < REPEATS
        ]
        sweeps, reason = self.runnable(once_more(slow, self._start))
        if not sweeps:
            self.refused.append(reason)
            return self.missing(REVISITED, "The slow sweeps cannot be repeated with a test mass: others can.")
        return NextExperiment(
            TEST_MASS, tuple(REVISITED), sweeps, machine_time(sweeps) + BOLTING, None, tuple(rivals),
            "No sweep tells a wrong torque constant from an unknown payload: bolt a known mass on and measure again.",
        )  # fmt: skip

    def missing(self, blocks: Sequence[str], reason: str, *, again: bool = False) -> NextExperiment | None:
        """Some blocks in the existing poses; `again`: also if they were run there."""
        if not blocks:
            return None
        try:
            sweeps = self._designed(blocks, self._poses, revisit=len(blocks) > 1)
        except BadInput as error:
            self.refused.append(str(error))
            return None
        kind = blocks[0] if len(blocks) == 1 else FULL_DESIGN
        chosen = self._possible(_Proposal(kind, tuple(blocks), sweeps), again=again)
        return None if chosen is None else _experiment(chosen, None, (), reason)

    def poses(self, reason: str, unseen: Sequence[str] = ()) -> NextExperiment | None:
        """All blocks in two other poses, where one of the `unseen` effects, if there are any, would be seen."""
        given = self.selection.given
        # 10 more poses give no new information
        proposals = () if len(given.tracks.poses) > 10 else self._in_other_poses(BLOCKS)
        possible = filter(None, map(self._possible, proposals))
        chosen = next(possible, None)
        if chosen is None:
            return None
        if unseen:
            designed = [sweep for one in (chosen, *possible) for sweep in one.sweeps]
            if not shown_in(given, self.sweeps, designed, unseen):
                return None
        return _experiment(chosen, None, (), reason)

    def _possible(self, proposal: _Proposal, *, again: bool = False) -> _Proposal | None:
        """The part that the machine can run; None if that is nothing, or nothing new and not to be run `again`."""
        sweeps, reason = self.runnable(proposal.sweeps)
        self.refused.extend([reason] if reason else [])
        warms = proposal.kind == WARM_UP
        before = {_motion(spec, warms=warms) for spec in self._specs}
        new = again or any(_motion(sweep.spec, warms=warms) not in before for sweep in sweeps)
        return replace(proposal, sweeps=sweeps) if sweeps and new else None

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
        """With the slow blocks too where the measured ones are, beside those, no slower than the fast."""
        motion = self.selection.given.tracks
        slow = [block.replace("fast", "slow") for block in blocks if block in WARMING]
        for run in (blocks, list(dict.fromkeys([*slow, *blocks]))):
            sweeps = full_design(
                motion.robot, motion.joint, poses, repeats=REPEATS, sample_rate=motion.specs[0].sample_rate, blocks=run,
                started_at=self._start, revisit=revisit,
            )  # fmt: skip
            if measured_blocks([*motion.specs, *(s.spec for s in sweeps)]) >= {*blocks, *measured_blocks(motion.specs)}:
                break
        return sweeps

    def _warming(self) -> tuple[DesignedSweep, ...]:
        motion = self.selection.given.tracks
        rate = motion.specs[0].sample_rate
        return warm_up(motion.robot, motion.joint, motion.poses[0], sample_rate=rate, started_at=self._start)

    @property
    def _start(self) -> float:
        return max(spec.started_at for spec in self._specs) + 30.0


def _motion(spec: SweepSpec, *, warms: bool) -> tuple[object, ...]:
    """Equal for sweeps that tell the same; of those that only warm an axis the label counts."""
    return spec.pose, spec.offset_velocity, spec.sines, spec.block * warms


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
