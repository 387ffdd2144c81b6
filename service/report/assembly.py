"""Makes the content of a report from an estimate and its sweeps; used by the commands, the demo and the API."""

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import product

import numpy as np

from service.model.collision import reachable
from service.model.recording import Sweep, SweepSpec
from service.model.results.estimate import BaseParameter, Estimate
from service.model.robot import Robot
from service.report.content import SAME_POSITION, Array, Content, revision

DRAWN = 2000  # poses for the drawing of models, at most
FINEST = 25  # largest number of positions of one joint


def content_of(
    robot: Robot,
    estimate: Estimate,
    specs: Iterable[SweepSpec],
    read: Callable[[SweepSpec], Sweep],
    subtitle: str,
    *,
    workspace: Array | None = None,
    revisions: Iterable[tuple[int, Sequence[BaseParameter]]] = (),
) -> Content:
    """The content of a report of an estimate that has the inertia of an axis.

    `specs`: at least of the sweeps that the estimate used. `read` returns the samples of one of them, for the example.
    `workspace` (m, n): collision-free poses, if known; else a grid over the range of the sweeps. `revisions`: number of
    sweeps and base parameters of the earlier estimates.
    """
    used = used_sweeps(estimate, specs)
    names = [entry.name for entry in estimate.base_parameters]
    return Content(
        title=f"Inertias of the robot {robot.name}",
        subtitle=subtitle,
        robot=robot,
        estimate=estimate,
        specs=used,
        workspace=covered(robot, used) if workspace is None else workspace,
        revisions=tuple(revision(parameters, names, number) for number, parameters in revisions),
        example=read(example_of(used)),
    )


def used_sweeps(estimate: Estimate, specs: Iterable[SweepSpec]) -> tuple[SweepSpec, ...]:
    """The sweeps whose inertia is in the estimate, in their order."""
    used = {one.sweep for axis in estimate.axes.values() for one in axis.inertia}
    return tuple(spec for spec in specs if spec.id in used)


def example_of(used: Sequence[SweepSpec]) -> SweepSpec:
    """The sweep with the most lines, of the first measured axis."""
    return max((spec for spec in used if spec.axis == used[0].axis), key=lambda spec: len(spec.sines))


def covered(robot: Robot, used: Sequence[SweepSpec]) -> Array:
    """Poses (m, n) without self-collision, on a grid over the range of the joints that varied.

    Nothing is drawn outside the measured range. If no joint varied: the poses of the sweeps.
    """
    stood = np.unique([spec.pose for spec in used], axis=0)
    varied = np.flatnonzero(np.ptp(stood, axis=0) > SAME_POSITION)
    if not varied.size:
        return stood
    count = max(2, min(FINEST, math.floor(DRAWN ** (1 / varied.size))))
    ranges = [np.linspace(float(stood[:, k].min()), float(stood[:, k].max()), count).tolist() for k in varied]
    poses = np.tile(stood.mean(axis=0), (count**varied.size, 1))
    poses[:, varied] = list(product(*ranges))
    return reachable(robot, stood, poses)
