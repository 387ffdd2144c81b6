"""Robot minutes until the model is right to 1, 0.5 and 0.3 %, against the paper's recipe and random poses.

The same sweeps of axes 1 to 3 in the same plant (max100-full); what differs is which poses come first and what is made
of them. Ours: D-optimal choice and the joint fit. The paper's: choice by condition number, its formula for J, plain
least squares. Random: the joint fit in poses of no choice. Right to x %: RMSE of J over the collision-free grid against
the truth, of the worst axis, stays at or below x % for all more poses looked at. Minutes: sweeps, and a
short way through these poses at the planner's velocity. Mean of `SEEDS` measurements each.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from service.identification import identify
from service.identification.design.pose_selection import Criterion, choices
from service.identification.model.base_parameters import base_parameters
from service.identification.model.regressor import lock
from service.planning.plan import PlanRequest
from service.recording import Sweep
from service.robot import Robot
from service.safety.travel import order_poses
from simulator import true_inertia
from tests.benchmarks.bench.measured import Measured
from tests.benchmarks.bench.revisions import anew
from tests.benchmarks.method import workspace_grid
from tests.numeric.campaign import AXES, SimulatedCampaign, max100, measure_at, planned_at, scenario_named

Array = NDArray[np.float64]

LEVELS = (1.0, 0.5, 0.3)  # %
LOOKS = (4, 5, 6, 8, 10, 12, 15, 20, 25, 30, 40, 50, 75, 100)  # poses
SEEDS = (1, 2)
VELOCITY = float(PlanRequest.model_fields["move_velocity"].default)  # rad/s
SETTLING = 1.0  # s at each end of a way
RECIPES = {"ours": Criterion.D_OPTIMAL, "the paper's recipe": Criterion.CONDITION, "random poses": None}


@cache
def grid() -> Array:
    return workspace_grid(max100())


def poses_of(criterion: Criterion | None, seed: int) -> Array:
    """`LOOKS[-1]` poses (n, 6) in the order in which they are measured."""
    robot, free = max100(), grid()
    if criterion is None:
        return free[np.random.default_rng(seed).permutation(len(free))[: LOOKS[-1]]]
    chain = lock(robot.chain, {3: 0.0, 4: 0.0, 5: 0.0})
    base = base_parameters(chain, (0, 1, 2))
    rows = np.stack([base.rows(chain, axis, free[:, :3]) for axis in range(3)], axis=1)
    picks = (pick for pick, _ in choices(rows, criterion))
    return free[[next(picks) for _ in range(LOOKS[-1])]]


def errors(campaign: SimulatedCampaign, *, paper: bool) -> Array:
    """RMSE of the worst axis over the grid, %, from the first poses of each of `LOOKS`."""
    total = len(campaign.sweeps) // len(AXES)
    spectra = campaign.spectra
    found: list[float] = []
    for poses in LOOKS:
        numbers = [axis * total + k for axis in range(len(AXES)) for k in range(poses)]
        if paper:
            found.append(_worst(_by_paper(campaign.robot, [campaign.sweeps[n] for n in numbers])))
        else:
            estimate = identify(campaign.robot, [spectra[n] for n in numbers])
            found.append(_worst({joint: estimate.identified(joint, grid()) for joint in AXES}))
    return np.array(found)


def _worst(found: Mapping[str, Array]) -> float:
    truth = _truth()
    return max(100 * float(np.sqrt(np.mean((found[joint] / truth[joint] - 1) ** 2))) for joint in AXES)


def _by_paper(robot: Robot, sweeps: Sequence[Sweep]) -> dict[str, Array]:
    chain = lock(robot.chain, {3: 0.0, 4: 0.0, 5: 0.0})
    base, values = base_parameters(chain, (0, 1, 2)), anew(robot, sweeps)
    return {joint: base.rows(chain, k, grid()[:, :3]) @ values for k, joint in enumerate(AXES)}


@cache
def _truth() -> dict[str, Array]:
    return {joint: true_inertia(scenario_named("max100-full"), joint, grid()) for joint in AXES}


def minutes(poses: Array) -> Array:
    """Of a plan of the first poses of each of `LOOKS`, over a short way through them from zero."""
    _, runs = planned_at(scenario_named("max100-full"), poses)
    sweeps = np.array([run.waveform.duration for run in runs]).reshape(len(AXES), len(poses)).sum(axis=0)
    found: list[float] = []
    for count in LOOKS:
        order = order_poses(poses[:count], np.zeros(6))
        way = np.abs(np.diff(poses[:count][order], axis=0, prepend=np.zeros((1, 6))))
        found.append(float(sweeps[:count].sum() + (way / VELOCITY + SETTLING * (way > 0)).sum()) / 60)
    return np.array(found)


def reached(percent: Array, level: float) -> int | None:
    """Number of the look from which on the error stays within the level; None: never."""
    above = np.flatnonzero(percent > level)
    first = int(above[-1]) + 1 if len(above) else 0
    return first if first < len(percent) else None


def of_recipe(name: str) -> dict[float, list[float]]:
    """Minutes to each level, a seed each; inf where the last look is not there."""
    found: dict[float, list[float]] = {level: [] for level in LEVELS}
    for seed in SEEDS:
        poses = poses_of(RECIPES[name], seed)
        campaign = measure_at(scenario_named("max100-full"), seed, poses)
        at = minutes(poses)
        percent = errors(campaign, paper=name.startswith("the paper"))
        for level in LEVELS:
            look = reached(percent, level)
            found[level].append(float("inf") if look is None else float(at[look]))
    return found


def run() -> Iterator[Measured]:
    told = {name: of_recipe(name) for name in RECIPES}
    for level in LEVELS:
        ours = float(np.mean(told["ours"][level]))
        for name in list(RECIPES)[1:]:
            each = told[name][level]
            peer = float(np.mean(each))
            never = sum(not np.isfinite(one) for one in each)
            yield Measured(
                name=f"robot minutes to {level:g} %", unit="min", ours=ours, peer=peer if np.isfinite(peer) else None,
                beside=name, repeats=len(SEEDS),
                note=f"{never} of {len(each)} not within {LOOKS[-1]} poses by {name}" if never else "",
            )  # fmt: skip
