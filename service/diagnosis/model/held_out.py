"""The residual of the simulator: the fitted model is written into a scenario and simulated along the recorded motion.

The columns of the catalogue are simpler than the physics of the simulator. This test shows whether the resulting model
behaves like the columns. Load and viscous friction are fitted again, because the gear of the simulator may distribute
the torque differently between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.fit.equations import Equations
from service.diagnosis.fit.fitted import Point, expressible
from service.diagnosis.fit.solving import solve
from service.diagnosis.model.link_deviations import gravity_of_fit
from service.diagnosis.model.scenario import axis_entry
from service.diagnosis.model.twin import Run, torques, ways
from service.diagnosis.rows.signals import laid_out
from service.model.recording import Sweep

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Simulated:
    """Residual of the twin (n, rows), N m, and a description of values that its limits changed."""

    residual: Array
    held: tuple[str, ...]


def simulated(given: Equations, sweeps: Sequence[Sweep], point: Point) -> Simulated:
    """The twin of a model; Inexpressible if no scenario can contain it."""
    tracks = given.tracks
    load: Array = point.load[:, tracks.pose_index]
    inertia, torque, slope = (np.asarray(part, dtype=np.float64) for part in load)
    entry = axis_entry(tracks.robot, tracks.joint, float(np.mean(inertia)), point.viscous, expressible(point))
    pull = gravity_of_fit(tracks.poses[tracks.pose_index], tracks.robot.index(tracks.joint), torque, slope)
    if tracks.prismatic:
        pull = np.stack([torque, np.zeros_like(torque)], axis=-1)
    pulls: list[list[float]] = (pull / entry.scale).tolist()
    runs = [Run(k, entry, float(inertia[k]), (cosine, sine)) for k, (cosine, sine) in enumerate(pulls)]
    own = [sweep for sweep in sweeps if sweep.spec.axis == tracks.joint and sweep.spec.moves]
    needed = torques(tracks.robot, tracks.joint, ways(own), runs)
    left = tracks.rows(tracks.effort - laid_out(tracks, needed))
    system = given.system_of(np.concatenate([given.base, given.whitening(left)[..., None]], axis=-1)).sum(axis=0)
    values = solve(system, given.precision(point.terms))[0]
    return Simulated(left - given.plain_base @ values, entry.held)
