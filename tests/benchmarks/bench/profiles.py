"""Where the time goes: the three slowest paths of the product, and those that miss a target, under cProfile."""

import cProfile
import pstats
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from service.diagnosis import diagnose_axis
from service.identification.design.pose_selection import Criterion, select_poses
from service.identification.model.base_parameters import base_parameters
from service.planning.plan import build_plan
from simulator import run_sweeps
from tests.benchmarks.bench import selection
from tests.benchmarks.bench.diagnosis import CASES
from tests.benchmarks.bench.measured import timed
from tests.benchmarks.bench.plant import random_poses
from tests.benchmarks.bench.revisions import campaign, revision, spectra
from tests.benchmarks.planning import free_of_six
from tests.numeric.campaign import planned_at, scenario_named
from tests.numeric.second_plant.cases import make

ROOT = Path(__file__).parents[3]
LINES, SLOWEST = 8, 3
Work = Callable[[], object]


@dataclass(frozen=True)
class Line:
    """A function: calls, s in itself, s with what it called."""

    function: str
    calls: int
    own: float
    whole: float


@dataclass(frozen=True)
class Profile:
    """`processor`: s without the profiler, whose own cost is in the lines."""

    path: str
    processor: float
    lines: tuple[Line, ...]


def _whole_plan() -> Work:
    robot, cell = selection.robot_and_cell()
    return partial(build_plan, robot, selection.REQUEST, cell)


def _six() -> Work:
    robot, cell = selection.robot_and_cell()
    base, free = base_parameters(robot.chain, tuple(range(6))), free_of_six(robot, cell, selection.SIX)
    rows = np.stack([base.rows(robot.chain, axis, free) for axis in range(6)], axis=1)
    return partial(select_poses, rows, selection.POSES, Criterion.CONDITION)


def _plant() -> Work:
    scenario = scenario_named("max100-full")
    return partial(run_sweeps, scenario, planned_at(scenario, random_poses(300))[1], 0)


def _revision() -> Work:
    return partial(revision, campaign().robot, spectra()[:-1], campaign().sweeps[-1])


def _diagnosis() -> Work:
    robot, joint, sweeps, _ = make(CASES["cogging"])
    return partial(diagnose_axis, robot, joint, sweeps)


PATHS: dict[str, Callable[[], Work]] = {
    "the whole plan of 300 poses, three axes": _whole_plan,
    "selection of 300 of 20,000 poses, six axes": _six,
    "virtual plant, 900 sweeps": _plant,
    "revision 900": _revision,
    "diagnosis of one axis": _diagnosis,
}
MISSING = ("revision 900",)  # a target


def profiles() -> list[Profile]:
    """The slowest first; what misses a target last, if it is none of them."""
    works = {path: prepare() for path, prepare in PATHS.items()}
    seconds = {path: timed(work)[0] for path, work in works.items()}
    slowest = sorted(PATHS, key=lambda path: -seconds[path])[:SLOWEST]
    wanted = [*slowest, *(path for path in MISSING if path not in slowest)]
    return [Profile(path, seconds[path], _lines(works[path])) for path in wanted]


def _lines(work: Work) -> tuple[Line, ...]:
    profiler = cProfile.Profile()
    profiler.runcall(work)
    told = pstats.Stats(profiler).get_stats_profile().func_profiles
    ordered = sorted(told.items(), key=lambda item: -item[1].tottime)[:LINES]
    return tuple(
        Line(_place(name, each.file_name, each.line_number), int(each.ncalls.split("/")[0]), each.tottime, each.cumtime)
        for name, each in ordered
    )


def _place(function: str, file: str, line: int) -> str:
    if file == "~":
        return function.strip("<>{}")
    path = file.partition("site-packages/")[2] or file.removeprefix(f"{ROOT}/")
    return f"{function} ({path if not path.startswith('/') else Path(path).name}:{line})"
