"""Predictions for sweeps not yet run, in one set of equations with the measured sweeps.

Measured and predicted sweeps share one set of columns. Therefore coefficients of the measured sweeps are valid for
the predicted ones, the poses of both determine the possible gravity errors, and the gear temperature continues.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.fit.equations import Equations, Term, equations
from service.diagnosis.fit.solving import solve
from service.diagnosis.rows.signals import Tracks, tracks
from service.identification.design.diagnosis_sweeps import DesignedSweep
from service.identification.design.excitation import Excitation, velocity_setpoint
from service.model.recording import Recording, Sweep

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PredictedSweeps:
    """Equations of measured and predicted sweeps; coefficients are fitted to the measured ones only."""

    given: Equations
    measured: int  # number of measured sweeps, which are the first ones

    @property
    def tracks(self) -> Tracks:
        return self.given.tracks

    def effort(self, terms: Sequence[Term]) -> Array:
        """Whitened rows (predicted sweeps, rows) of the torque of load, friction and terms; fitted coefficients."""
        given, rows = self.given, [self.given.rows(term) for term in terms]
        every = np.concatenate([given.base, *rows, given.right[..., None]], axis=-1)
        values = solve(given.system_of(every).sum(axis=0), given.precision(terms))[0]
        return every[self.measured :, :, :-1] @ values

    def beyond_rigid(self, effort: Array, sweeps: Sequence[int]) -> float:
        """Chi-squared of an effort (predicted sweeps, rows) in some sweeps, minus the part that load and friction can
        explain within the prior and the measured sweeps.
        """
        at = np.array(sweeps) + self.measured
        good = self.tracks.usable[at]
        columns, left = self.given.base[at][good], effort[np.array(sweeps)][good]
        known = self._known + columns.T @ columns
        across = columns.T @ left
        return float(left @ left - across @ np.linalg.solve(known, across))

    @cached_property
    def _known(self) -> Array:
        """Information matrix (b, b) of the base: prior and measured sweeps."""
        b = self.given.width_of_base
        system = self.given.system_of(self.given.base).sum(axis=0)
        return system + self.given.precision(()) + 1e-12 * np.trace(system) * np.eye(b)


def predict_sweeps(given: Equations, measured: Sequence[Sweep], designed: Sequence[DesignedSweep]) -> PredictedSweeps:
    """`measured`: the sweeps of `given`. BadInput if the designed sweeps cannot be combined with them."""
    robot, joint, index = given.tracks.robot, given.tracks.joint, given.tracks.robot.index(given.tracks.joint)
    motion = tracks(robot, joint, [*measured, *(expected(one, one.spec.pose[index]) for one in designed)])
    groups = tuple(
        replace(group, pieces=tuple(replace(piece, rows=motion.usable.shape[1]) for piece in group.pieces))
        for group in given.groups
    )
    return PredictedSweeps(equations(motion, groups, given.whitening), len(given.tracks.specs))


def expected(designed: DesignedSweep, start: float) -> Sweep:
    """A sweep that follows its set-point exactly from a position."""
    spec = designed.spec
    excitation = Excitation(
        spec.offset_velocity, spec.sines, spec.period or 1.0, spec.periods or 1, designed.ramp, designed.settle
    )
    time = np.arange(round(designed.duration * spec.sample_rate)) / spec.sample_rate
    velocity = velocity_setpoint(excitation, time)
    return Sweep(spec, Recording(time, np.zeros_like(time), velocity, start + np.cumsum(velocity) / spec.sample_rate))
