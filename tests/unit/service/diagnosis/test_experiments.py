"""The sweeps of a diagnosis, and each kind of experiment where it is the one to run."""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from service.diagnosis.experiments import BOLTING, NextExperiment, next_experiment
from service.diagnosis.fit.equations import Term
from service.diagnosis.fit.select import select
from service.diagnosis.rows.signals import Tracks
from service.diagnosis.sensitivity import UntestableEffect
from service.diagnosis.verdict import Verdict, tie_sets
from service.identification.design.diagnosis_sweeps import (
    BLOCKS,
    FAST,
    ROOM,
    DesignedSweep,
    full_design,
    is_partial,
    machine_time,
    measured_blocks,
    other_poses,
    paper_design,
)
from service.identification.design.excitation import Excitation, velocity_setpoint
from service.identification.estimates.torque_gain import KnownMass
from service.model import SweepSpec
from tests.numeric.campaign import max100
from tests.unit.service.diagnosis.following import (
    FORWARD,
    RATE,
    SLOW,
    carrying,
    equations_of,
    following,
    heavier,
    swept,
)

POSES = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.1, -0.5, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0]])
DRIFT = "friction_temperature_drift"


def asked(
    blocks: Sequence[str],
    hidden: Mapping[Term, Sequence[float]],
    rivals: Sequence[str],
    verdict: Verdict = Verdict.AMBIGUOUS,
    unseen: dict[str, UntestableEffect] | None = None,
    poses: np.ndarray = POSES,
    noise: float = 0.001,
    load: Callable[[Tracks], np.ndarray] | None = None,
) -> NextExperiment | None:
    """What is asked for when these blocks were run and the rivals are left."""
    robot = max100()
    sweeps = swept("joint_2", poses, hidden, noise=noise, load=load, blocks=blocks, revisit=False)
    selection = select(equations_of(robot, "joint_2", sweeps), (), list(rivals))
    return next_experiment(selection, verdict, rivals, unseen or {}, sweeps)[0]


def needed(*args: Any, **others: Any) -> NextExperiment:
    """The same, where one is."""
    wanted = asked(*args, **others)
    assert wanted is not None
    return wanted


COULOMB = {Term("coulomb_friction"): (60.0,)}


def test_coulomb_or_offset_needs_the_other_direction() -> None:
    wanted = needed(FORWARD, COULOMB, ["coulomb_friction", "effort_offset"])
    assert wanted.kind in ("backward_slow", "reversal")
    assert wanted.separation is not None
    assert wanted.separation > 50
    assert wanted.seconds == machine_time(wanted.sweeps)
    assert wanted.between == ("coulomb_friction", "effort_offset")
    assert {sweep.spec.repeat for sweep in wanted.sweeps} == {0, 1}


def test_a_power_of_the_speed_needs_another_speed() -> None:
    power = {Term("nonlinear_viscous_friction", (0.01, 0.5)): (10.0,)}
    wanted = needed(SLOW, power, ["nonlinear_viscous_friction", "coulomb_friction"], noise=0.02)
    assert wanted.kind in ("forward_fast", "backward_fast", "reversal", "wide")


def test_delay_or_elasticity_needs_the_wide_band() -> None:
    delay = {Term("measurement_delay", (1e-3,)): (4e-3,)}
    wanted = needed(("forward_slow", "reversal"), delay, ["measurement_delay", "joint_elasticity"], noise=0.02)
    assert wanted.kind == "wide"


def test_drift_needs_warmth() -> None:
    drift = {Term(DRIFT, (300.0, 1.0)): (60.0, -3.0, 0.0)}
    wanted = needed(BLOCKS, drift, [DRIFT, "coulomb_friction"], poses=POSES[:1])
    assert wanted.kind == "warm_up"
    assert wanted.seconds > 250
    starts = [sweep.spec.started_at for sweep in wanted.sweeps]
    assert starts == sorted(starts)
    assert len({sweep.spec.block for sweep in wanted.sweeps}) == len(wanted.sweeps) / 2


def test_a_mass_is_asked_for_once_both_directions_were_run() -> None:
    rivals = ["payload", "torque_constant_error"]
    assert needed(FORWARD, {}, rivals, load=heavier(0.05)).kind == "backward_slow"
    then = needed(SLOW, {}, rivals, load=heavier(0.05))
    assert (then.kind, then.blocks) == ("test_mass", SLOW)
    assert then.seconds == machine_time(then.sweeps) + BOLTING
    assert {sweep.spec.pose for sweep in then.sweeps} == {tuple(pose) for pose in POSES.tolist()}


def test_the_mass_is_measured_in_sweeps_as_they_were_run_without_it() -> None:
    robot = max100()
    poses = np.array([[0.0, angle, 0.3, 0, 0, 0] for angle in np.linspace(-0.8, 0.9, 7)])
    slower = full_design(robot, "joint_2", poses, blocks=SLOW, sample_rate=RATE, travel=0.04)
    sweeps = following(robot, "joint_2", slower, load=heavier(0.05))
    rivals = ["payload", "torque_constant_error"]
    selection = select(equations_of(robot, "joint_2", sweeps), (), rivals)
    wanted, _ = next_experiment(selection, Verdict.AMBIGUOUS, rivals, {}, sweeps)
    assert wanted is not None
    assert {s.spec.offset_velocity for s in wanted.sweeps} == {s.spec.offset_velocity for s in slower}
    assert len({s.spec.pose for s in wanted.sweeps}) == 4
    assert {(s.ramp, s.settle) for s in wanted.sweeps} == {(s.ramp, s.settle) for s in slower}


def test_gravity_or_payload_needs_poses_in_which_other_joints_are_turned() -> None:
    tip = carrying(KnownMass(8.0, (0.2, 0.0, 0.0)))
    wanted = needed(BLOCKS, {}, ["payload", "gravity_error"], poses=POSES[:2], load=tip)
    assert wanted.kind == "more_poses"
    assert not {sweep.spec.pose for sweep in wanted.sweeps} & {tuple(pose) for pose in POSES.tolist()}


def test_unknown_asks_for_the_missing_blocks_then_for_other_poses() -> None:
    first = needed(FORWARD, COULOMB, ["measurement_delay"], Verdict.UNKNOWN)
    assert (first.kind, first.blocks) == ("full_design", BLOCKS[1:])
    then = needed(BLOCKS, COULOMB, ["measurement_delay"], Verdict.UNKNOWN, poses=POSES[:1])
    assert (then.kind, then.blocks) == ("more_poses", BLOCKS)
    assert tuple(POSES[0].tolist()) not in {sweep.spec.pose for sweep in then.sweeps}


def test_nothing_found_asks_for_what_shows_the_unseen() -> None:
    unseen = {"measurement_delay": UntestableEffect(("wide",), False), "backlash": UntestableEffect((), False)}
    wanted = needed(FORWARD, {}, ["coulomb_friction"], Verdict.NONE, unseen)
    assert (wanted.kind, wanted.blocks) == ("wide", ("wide",))
    assert "measurement delay" in wanted.reason
    assert asked(FORWARD, {}, ["coulomb_friction"], Verdict.NONE, {"backlash": UntestableEffect((), False)}) is None
    weighty = {"hose_spring": UntestableEffect((), True)}
    wanted = needed(BLOCKS, {}, ["coulomb_friction"], Verdict.UNTESTABLE, weighty)
    assert (wanted.kind, wanted.blocks) == ("more_poses", BLOCKS)
    assert "hose spring" in wanted.reason
    assert asked(FORWARD, COULOMB, ["coulomb_friction"], Verdict.NAMED) is None


@pytest.mark.parametrize(
    ("blocks", "name", "values", "left_out", "ties"),
    [
        (FORWARD, "coulomb_friction", (60.0,), "", {"asymmetric_friction", "effort_offset"}),
        (BLOCKS, "coulomb_friction", (60.0,), "", set[str]()),
        (BLOCKS, "asymmetric_friction", (60.0, 20.0, 300.0), "effort_offset", set[str]()),  # it contains the other
        (FORWARD, "effort_offset", (-60.0,), "asymmetric_friction", {"coulomb_friction"}),  # friction never pushes
    ],
)
def test_one_direction_leaves_ties_that_all_blocks_settle(
    blocks: Sequence[str], name: str, values: tuple[float, ...], left_out: str, ties: set[str]
) -> None:
    sweeps = swept("joint_2", POSES[:2], {Term(name): values}, blocks=blocks)
    candidates = [one for one in ("coulomb_friction", "asymmetric_friction", "effort_offset") if one != left_out]
    selection = select(equations_of(max100(), "joint_2", sweeps), (), candidates)
    assert tie_sets(selection, (), candidates) == {name: ties}


def test_the_papers_sweeps_can_be_followed_by_any_block() -> None:
    robot = max100()
    sweeps = following(robot, "joint_2", paper_design(robot, "joint_2", POSES, sample_rate=RATE), COULOMB)
    given = equations_of(robot, "joint_2", sweeps)
    selection = select(given, (), ["coulomb_friction", "effort_offset"])
    wanted, _ = next_experiment(selection, Verdict.AMBIGUOUS, ["coulomb_friction", "effort_offset"], {}, sweeps)
    assert wanted is not None
    assert min(sweep.spec.started_at for sweep in wanted.sweeps) > max(s.spec.started_at for s in sweeps)


TOO_NEAR = "and the machine cannot run what may decide it (too near)"
UNEXPLAINED = "no effect of the catalogue explains the sweeps"
ALIKE = "Coulomb friction and effort offset explain the sweeps alike"


@pytest.mark.parametrize(
    ("verdict", "free", "experiments", "kind", "ended"),
    [
        (Verdict.UNKNOWN, lambda spec: spec.block != "wide", 0, "full_design", ""),
        (Verdict.UNKNOWN, lambda spec: spec.pose != tuple(POSES[0].tolist()), 0, "more_poses", ""),
        (Verdict.UNKNOWN, lambda spec: False, 0, "", f"{UNEXPLAINED} {TOO_NEAR}"),
        (Verdict.AMBIGUOUS, lambda spec: False, 0, "", f"{ALIKE} {TOO_NEAR}"),
        (Verdict.UNTESTABLE, lambda spec: False, 0, "", f"the sweeps do not show hose spring {TOO_NEAR}"),
        (Verdict.UNKNOWN, lambda spec: True, 3, "", f"{UNEXPLAINED} after 3 experiments"),
        (Verdict.NONE, lambda spec: False, 0, "", ""),
        (Verdict.NAMED, lambda spec: True, 0, "", ""),
    ],
)  # fmt: skip
def test_what_is_proposed_can_be_run_or_the_end_says_why(
    verdict: Verdict, free: Callable[[SweepSpec], bool], experiments: int, kind: str, ended: str
) -> None:
    def runnable(sweeps: Sequence[DesignedSweep]) -> tuple[tuple[DesignedSweep, ...], str]:
        kept = tuple(sweep for sweep in sweeps if free(sweep.spec))
        return kept, "" if len(kept) == len(sweeps) else "too near"

    rivals = ["coulomb_friction", "effort_offset"]
    sweeps = swept("joint_2", POSES[:1], COULOMB, blocks=FORWARD, revisit=False)
    selection = select(equations_of(max100(), "joint_2", sweeps), (), rivals)
    unseen = {"hose_spring": UntestableEffect((), True)}
    wanted, why = next_experiment(selection, verdict, rivals, unseen, sweeps, runnable, experiments)
    assert ("" if wanted is None else wanted.kind, why) == (kind, ended)
    assert wanted is None or all(free(sweep.spec) for sweep in wanted.sweeps)


@pytest.mark.parametrize("measured", [FORWARD, SLOW])
def test_where_fast_sweeps_are_no_other_speed_slower_ones_are_proposed_once(measured: Sequence[str]) -> None:
    robot, hidden = max100(), {Term("coulomb_friction"): (60.0,)}
    designed = full_design(robot, "joint_2", POSES[:1], blocks=measured, sample_rate=RATE, travel=0.14, revisit=False)
    sweeps = following(robot, "joint_2", designed, hidden)
    for kind in ("full_design", "more_poses"):
        selection = select(equations_of(robot, "joint_2", sweeps), (), ["measurement_delay"])
        wanted, _ = next_experiment(selection, Verdict.UNKNOWN, (), {}, sweeps)
        assert wanted is not None
        assert wanted.kind == kind
        sweeps = following(robot, "joint_2", [*designed, *wanted.sweeps], hidden)
        assert measured_blocks([sweep.spec for sweep in sweeps]) == set(BLOCKS)


THREE = np.array([[0.0, -0.8, 0.3, 0, 0, 0], [0.0, 0.0, -0.5, 0, 0, 0], [0.0, 0.9, 0.9, 0, 0, 0]])
TRAVEL = float(np.radians(4.0))


def test_every_block_twice_back_to_back_and_the_first_pose_once_more() -> None:
    designed = full_design(max100(), "joint_2", THREE)
    again = ("revisit_forward_slow", "revisit_backward_slow")
    wanted = [(block, repeat) for block in (*BLOCKS * len(THREE), *again) for repeat in (0, 1)]
    assert [(sweep.spec.block, sweep.spec.repeat) for sweep in designed] == wanted
    assert designed[-1].spec.pose == designed[0].spec.pose
    for before, after in pairwise(designed):
        assert after.spec.started_at > before.spec.started_at + before.duration
    assert machine_time(designed[:2]) > sum(sweep.duration for sweep in designed[:2]) + 2 * 2.0  # with the way back


def test_only_reversal_reverses_and_travel_stays_small() -> None:
    for sweep in full_design(max100(), "joint_3", THREE[:1]):
        spec = sweep.spec
        excitation = Excitation(
            spec.offset_velocity, spec.sines, spec.period or 1.0, spec.periods or 1, sweep.ramp, sweep.settle
        )
        velocity = velocity_setpoint(excitation, np.arange(0, sweep.duration, 0.001))
        assert (velocity.min() >= -1e-12 or velocity.max() <= 1e-12) == (spec.block != "reversal")
        assert abs(np.sum(velocity) * 0.001) <= 1.01 * FAST * TRAVEL
        assert spec.measure_from == sweep.ramp + sweep.settle


def test_blocks_are_told_by_what_the_sweeps_are() -> None:
    robot = max100()
    designed = full_design(robot, "joint_2", THREE[:1])
    specs = [one.spec.model_copy(update={"block": "of another day"}) for one in designed]
    assert (measured_blocks(specs), is_partial(specs)) == (set(BLOCKS), False)
    paper = [one.spec for one in paper_design(robot, "joint_2", THREE)]
    assert [(spec.block, spec.repeat) for spec in paper] == [("forward_slow", 0)] * 3
    assert {sine.frequency for spec in paper for sine in spec.sines} == {2.0, 3.0, 4.0, 5.0}
    assert (measured_blocks(paper), is_partial(paper)) == ({"forward_slow"}, True)
    record = paper[0].model_copy(update={"excitation": "trajectory", "sines": ()})
    assert (measured_blocks([record]), is_partial([record])) == (set(), False)


def test_other_poses_are_new_and_have_room() -> None:
    robot = max100()
    poses = other_poses(robot, "joint_2", THREE)
    assert len(poses) > 4
    assert np.abs(poses[:, None] - THREE).max(axis=2).min() > 0.1
    np.testing.assert_array_equal(poses[:, 0], 0.0)  # what lies before the axis turns nothing
    limits = np.array([(joint.lower, joint.upper) for joint in robot.chain.joints])
    moved = poses != 0
    assert ((poses >= limits[:, 0] + ROOM) | ~moved).all()
    assert ((poses <= limits[:, 1] - ROOM) | ~moved).all()
