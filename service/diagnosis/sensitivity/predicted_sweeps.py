"""What the model expects of sweeps not yet run: the measured ones and those that follow their set-points, as one.

Measured and expected sweeps share one set of columns, so that coefficients which the measured ones give hold for the
expected, the poses of both count for what gravity may do, and the warmth goes on where it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.fit.equations import Equations, Term, equations
from service.diagnosis.fit.solving import solve
from service.diagnosis.rows.signals import Tracks, tracks
from service.diagnosis.sensitivity.design import DesignedSweep
from service.identification.design.excitation import Excitation, velocity_setpoint
from service.recording import Recording, Sweep

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prospect:
    """Equations over measured and expected sweeps, of which the measured alone give coefficients."""

    given: Equations
    measured: int  # the first so many sweeps

    @property
    def tracks(self) -> Tracks:
        return self.given.tracks

    def effort(self, terms: Sequence[Term]) -> Array:
        """Whitened rows (expected sweeps, rows) of what load, friction and terms need, as the data give them."""
        given, rows = self.given, [self.given.rows(term) for term in terms]
        every = np.concatenate([given.base, *rows, given.right[..., None]], axis=-1)
        values = solve(given.system_of(every).sum(axis=0), given.precision(terms))[0]
        return every[self.measured :, :, :-1] @ values

    def beyond_rigid(self, effort: Array, sweeps: Sequence[int]) -> float:
        """Chi-squared of an effort (expected sweeps, rows) in some of the sweeps, besides what load and friction may be
        by the prior and the measured sweeps.
        """
        at = np.array(sweeps) + self.measured
        good = self.tracks.usable[at]
        columns, left = self.given.base[at][good], effort[np.array(sweeps)][good]
        known = self._known + columns.T @ columns
        across = columns.T @ left
        return float(left @ left - across @ np.linalg.solve(known, across))

    @cached_property
    def _known(self) -> Array:
        """Information (b, b) on the base: prior and measured sweeps."""
        b = self.given.width_of_base
        system = self.given.system_of(self.given.base).sum(axis=0)
        return system + self.given.precision(()) + 1e-12 * np.trace(system) * np.eye(b)


def prospect(given: Equations, measured: Sequence[Sweep], designed: Sequence[DesignedSweep]) -> Prospect:
    """`measured` are the sweeps of `given`; BadInput where the designed cannot stand beside them."""
    robot, joint, index = given.tracks.robot, given.tracks.joint, given.tracks.robot.index(given.tracks.joint)
    motion = tracks(robot, joint, [*measured, *(expected(one, one.spec.pose[index]) for one in designed)])
    groups = tuple(
        replace(group, pieces=tuple(replace(piece, rows=motion.usable.shape[1]) for piece in group.pieces))
        for group in given.groups
    )
    return Prospect(equations(motion, groups, given.whitening), len(given.tracks.specs))


def expected(designed: DesignedSweep, start: float) -> Sweep:
    """A sweep that follows its set-point from a position."""
    spec = designed.spec
    excitation = Excitation(
        spec.offset_velocity, spec.sines, spec.period or 1.0, spec.periods or 1, designed.ramp, designed.settle
    )
    time = np.arange(round(designed.duration * spec.sample_rate)) / spec.sample_rate
    velocity = velocity_setpoint(excitation, time)
    return Sweep(spec, Recording(time, np.zeros_like(time), velocity, start + np.cumsum(velocity) / spec.sample_rate))
