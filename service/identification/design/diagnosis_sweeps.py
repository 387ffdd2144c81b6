"""The sweeps needed for a diagnosis: both directions, two speeds, reversal, a wide band, each repeated.

Purpose of each block: the other direction separates Coulomb friction from an offset and from springs. The second speed
separates friction that depends on speed from friction that drifts. Reversal shows effects near standstill
(presliding, backlash). Lines from 3 to 17 Hz separate a delay from elasticity. Repeats run back to back, so their
difference is noise without drift. The first pose is measured again at the end to show drift. An axis at standstill
gives no information: its dry friction may hold any torque (decision 0009).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.identification.design.excitation import RAMP, Excitation, design_sweep
from service.identification.model import inertia_rows
from service.model import Array, Robot, Sine, SweepSpec

SLOW = float(np.radians(4.0))  # rad (m), travel of the slow sweeps
FAST = 3.0  # times the travel of the slow sweeps
WIDE = 2.0  # times the travel of the slow sweeps, for the wide band
WIDE_LINES = (3.0, 5.0, 7.0, 11.0, 13.0, 17.0)  # Hz
WIDEST = 9.0  # Hz: a sweep with a line above is of the wide band
REVERSAL_LINES = (1.0, 2.0, 3.0)  # Hz: low, so that the distance between two reversals is much longer than presliding
EFFORT = 0.4  # of the rated effort for the sines
BETWEEN = 2.0  # s from one sweep to the next, in addition to the way back
WAY_BACK = np.radians(2.0)  # rad/s (m/s)
BLOCKS = ("forward_slow", "backward_slow", "forward_fast", "backward_fast", "reversal", "wide")
REVISITED = ("forward_slow", "backward_slow")
REVISIT = "revisit_"
WARMING = ("forward_fast", "backward_fast")  # the most travel per second
WARMED = 300.0  # s of these sweeps
TURNED = 0.8  # rad (m): change of a joint for a new pose
ROOM = 0.25  # rad (m) from a limit, needed for the sweeps


@dataclass(frozen=True, slots=True)
class DesignedSweep:
    """A sweep to run; the sum of `ramp` and `settle`, s, is `measure_from` of the spec."""

    spec: SweepSpec
    ramp: float
    settle: float

    @property
    def duration(self) -> float:
        """From standstill to standstill, s."""
        return 2 * self.ramp + self.settle + (self.spec.period or 0.0) * (self.spec.periods or 0)


def full_design(
    robot: Robot,
    joint: str,
    poses: Array,
    *,
    repeats: int = 2,
    travel: float = SLOW,
    sample_rate: float = 1000.0,
    blocks: Sequence[str] = BLOCKS,
    started_at: float = 0.0,
    revisit: bool = True,
) -> tuple[DesignedSweep, ...]:
    """All blocks in each of `poses` (m, n), `repeats` times back to back; `revisit`: the first pose again at the end.

    The poses should contain at least three angles of the axis to gravity. `travel`, rad (m), is that of the slow
    blocks; fast sweeps travel three times as far. `started_at`: s since the campaign began. BadInput if none fits.
    """
    poses = np.atleast_2d(poses)
    visits = [(pose, block, block) for pose in poses for block in blocks]
    if revisit:
        visits += [(poses[0], block, REVISIT + block) for block in REVISITED if block in blocks]
    return tuple(_in_order(robot, joint, visits, repeats, travel, sample_rate, started_at))


def paper_design(
    robot: Robot, joint: str, poses: Array, *, travel: float = SLOW, sample_rate: float = 1000.0
) -> tuple[DesignedSweep, ...]:
    """The measurement of the paper: one direction, offset and 2 to 5 Hz, once in each of `poses` (m, n)."""
    visits = [(pose, "forward_slow", "forward_slow") for pose in np.atleast_2d(poses)]
    return tuple(_in_order(robot, joint, visits, 1, travel, sample_rate, 0.0))


def warm_up(
    robot: Robot, joint: str, pose: Array, *, sample_rate: float = 1000.0, started_at: float = 0.0
) -> tuple[DesignedSweep, ...]:
    """Fast sweeps in both directions in a pose (n,), back to back for `WARMED` s, to warm up the friction.

    Each pair of repeats is a block of its own, so drift between pairs does not count as noise.
    """
    result: list[DesignedSweep] = []
    while not result or machine_time(result) < WARMED:
        start = _free_at(result[-1]) if result else started_at
        visits = [(pose, block, f"warming_{len(result) // 4 + 1}_{block}") for block in WARMING]
        result.extend(_in_order(robot, joint, visits, 2, SLOW, sample_rate, start, len(result)))
    return tuple(result)


def once_more(specs: Sequence[SweepSpec], started_at: float) -> tuple[DesignedSweep, ...]:
    """The same sweeps again, one after the other."""
    result: list[DesignedSweep] = []
    for number, spec in enumerate(specs, 1):
        start = _free_at(result[-1]) if result else started_at
        again = spec.model_copy(update={"id": f"{number:04}", "started_at": round(start, 3)})
        ramp = min(RAMP, spec.measure_from) or RAMP
        result.append(DesignedSweep(again, ramp, max(spec.measure_from - ramp, 0.0)))
    return tuple(result)


def other_poses(robot: Robot, joint: str, poses: Array) -> Array:
    """New poses (m, n): one joint, this axis or one after it, changed by `TURNED`, if its limits allow that."""
    result: list[Array] = []
    for number in range(robot.index(joint), len(robot.joints)):
        for sign in (1.0, -1.0):
            pose = poses[len(result) % len(poses)].copy()
            pose[number] += sign * TURNED
            limits = robot.chain.joints[number]
            away = np.abs(poses - pose).max(axis=1).min()
            if limits.lower + ROOM < pose[number] < limits.upper - ROOM and away > 0.1:
                result.append(pose)
    return np.array(result).reshape(-1, poses.shape[1])


def machine_time(designed: Sequence[DesignedSweep]) -> float:
    """Time from the start of the first sweep until the axis is back at the start of the last one, s."""
    return _free_at(designed[-1]) - designed[0].spec.started_at


def measured_blocks(specs: Sequence[SweepSpec]) -> set[str]:
    """The blocks that were run, recognised by the motion and not by the name of the block."""
    return {kind for kind in kinds(specs) if kind is not None}


def kinds(specs: Sequence[SweepSpec]) -> list[str | None]:
    """The block of each sweep; None for recordings that belong to none."""
    turning = [abs(s.offset_velocity) for s in specs if s.excitation == "multisine" and s.offset_velocity]
    slowest = min(turning, default=0.0)
    return [_kind(spec, slowest) for spec in specs]


def is_partial(specs: Sequence[SweepSpec]) -> bool:
    """Whether multisine sweeps were run, but not all blocks."""
    return any(s.excitation == "multisine" for s in specs) and not measured_blocks(specs) >= set(BLOCKS)


def _kind(spec: SweepSpec, slowest: float) -> str | None:
    if spec.excitation != "multisine":
        return None
    if not spec.offset_velocity:
        return "reversal"
    if max(sine.frequency for sine in spec.sines) > WIDEST:
        return "wide"
    way = "forward" if spec.offset_velocity > 0 else "backward"
    return f"{way}_{'fast' if abs(spec.offset_velocity) > np.sqrt(FAST) * slowest else 'slow'}"


def _free_at(sweep: DesignedSweep) -> float:
    """Earliest start of the next sweep, s."""
    spec = sweep.spec
    travel = abs(spec.offset_velocity) * (sweep.duration - sweep.ramp)
    return spec.started_at + sweep.duration + travel / WAY_BACK + BETWEEN


def _in_order(
    robot: Robot,
    joint: str,
    visits: Sequence[tuple[Array, str, str]],
    repeats: int,
    travel: float,
    sample_rate: float,
    started_at: float,
    number: int = 0,
) -> Iterator[DesignedSweep]:
    index = robot.index(joint)
    for pose, block, label in visits:
        load = float(inertia_rows(robot.chain, index, pose[None])[0] @ robot.chain.inertial.ravel())
        excitation = _excitation(robot, joint, pose, block, load, travel)
        for repeat in range(repeats):
            number += 1
            spec = SweepSpec(
                id=f"{number:04}",
                axis=joint,
                pose=tuple(pose.tolist()),
                offset_velocity=excitation.offset_velocity,
                sines=excitation.sines,
                period=excitation.period,
                periods=excitation.periods,
                measure_from=excitation.measure_from,
                sample_rate=sample_rate,
                started_at=round(started_at, 3),
                repeat=repeat,
                block=label,
            )
            sweep = DesignedSweep(spec, excitation.ramp, excitation.settle)
            yield sweep
            started_at = _free_at(sweep)


def _excitation(robot: Robot, joint: str, pose: Array, block: str, load: float, travel: float) -> Excitation:
    """The sweep of one block; sines and speeds are those of `design_sweep`, which takes ripple into account."""
    limit = EFFORT * robot.axis(joint).rated_effort
    fast, wide = block.endswith("fast"), block == "wide"
    sweep = design_sweep(
        robot,
        joint,
        pose,
        load_inertia=load,
        lines=WIDE_LINES if wide else None,
        direction=-1 if block.startswith("backward") else 1,
        travel=travel * (FAST if fast else WIDE if wide else 1.0),
        effort_limit=limit,
    )
    if block == "reversal":
        return _about_standstill(sweep)
    return sweep


def _about_standstill(sweep: Excitation) -> Excitation:
    """The sweep with the same peak speed, without the offset."""
    number = np.arange(len(REVERSAL_LINES))
    amplitude = abs(sweep.offset_velocity) / len(REVERSAL_LINES)
    phases = (-np.pi * number * (number + 1) / len(number)) % (2 * np.pi)
    sines = tuple(
        Sine(frequency=f, amplitude=amplitude, phase=p) for f, p in zip(REVERSAL_LINES, phases.tolist(), strict=True)
    )
    return replace(sweep, offset_velocity=0.0, sines=sines)
