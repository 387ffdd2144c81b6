"""What the model expects of sweeps not yet run: the measured ones and those that follow their set-points, as one.

Measured and expected sweeps share one set of columns, so that coefficients which the measured ones give hold for the
expected, the poses of both count for what gravity may do, and the warmth goes on where it is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.design import DesignedSweep
from service.diagnosis.equations import Equations, Term, nominal_inertia, nominal_right, solve
from service.diagnosis.grams import ORDER, pairing
from service.diagnosis.signals import Tracks, tracks
from service.identification.excitation import Excitation, velocity_setpoint
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
        """Whitened rows (expected sweeps, rows) of what terms need, with the coefficients that the data give them."""
        given, rows = self.given, [self.given.rows(term) for term in terms]
        system = given.system_of(np.concatenate([given.base, *rows, given.right[..., None]], axis=-1))
        values = solve(system, given.viscous_precision)[0][1:]
        return np.concatenate(rows, axis=-1)[self.measured :] @ values

    def beyond_rigid(self, effort: Array, sweeps: Sequence[int]) -> float:
        """Chi-squared of an effort (expected sweeps, rows) in some of the sweeps, besides any inertia and friction."""
        at = np.array(sweeps) + self.measured
        motion, good = self.tracks, self.tracks.usable[np.array(sweeps) + self.measured]
        base = self.given.base[at]
        own = [base[..., 0] * (motion.spot[at] == spot)[:, None] for spot in np.unique(motion.spot[at])]
        columns = np.stack([*own, base[..., 1]], axis=-1)[good]
        left = effort[np.array(sweeps)][good]
        left = left - columns @ np.linalg.lstsq(columns, left, rcond=None)[0]
        return float(left @ left)


def prospect(given: Equations, measured: Sequence[Sweep], designed: Sequence[DesignedSweep]) -> Prospect:
    """`measured` are the sweeps of `given`; BadInput where the designed cannot stand beside them."""
    robot, joint, index = given.tracks.robot, given.tracks.joint, given.tracks.robot.index(given.tracks.joint)
    motion = tracks(robot, joint, [*measured, *(expected(one, one.spec.pose[index]) for one in designed)])
    count, width = len(given.tracks.specs), motion.usable.shape[1]
    groups = tuple(
        replace(group, pieces=tuple(replace(piece, rows=width) for piece in group.pieces)) for group in given.groups
    )
    rows = [motion.rows(column) for column in (motion.acceleration, motion.velocity)]
    there = replace(
        given,
        tracks=motion,
        groups=groups,
        pairs=pairing(motion.usable, groups, ORDER, len(given.inertia_precision)),
        model=replace(given.model, inertia=np.append(given.model.inertia, _inertia(given, motion, count))),
        base=np.stack([given.whitening(row) for row in rows], axis=-1),
        right=given.whitening(motion.rows(nominal_right(motion))),
    )
    return Prospect(there, count)


def expected(designed: DesignedSweep, start: float) -> Sweep:
    """A sweep that follows its set-point from a position."""
    spec = designed.spec
    excitation = Excitation(
        spec.offset_velocity, spec.sines, spec.period or 1.0, spec.periods or 1, designed.ramp, designed.settle
    )
    time = np.arange(round(designed.duration * spec.sample_rate)) / spec.sample_rate
    velocity = velocity_setpoint(excitation, time)
    return Sweep(spec, Recording(time, np.zeros_like(time), velocity, start + np.cumsum(velocity) / spec.sample_rate))


def _inertia(given: Equations, motion: Tracks, count: int) -> Array:
    """Of the expected sweeps: as fitted where the pose was measured, else CAD's with the typical change."""
    nominal = nominal_inertia(motion.robot, motion.robot.index(motion.joint), motion.poses)
    typical = float(np.median(given.model.inertia / nominal[motion.spot[:count]]))
    fitted = dict(zip(motion.spot[:count].tolist(), given.model.inertia.tolist(), strict=True))
    return np.array([fitted.get(spot, typical * nominal[spot]) for spot in motion.spot[count:].tolist()])
