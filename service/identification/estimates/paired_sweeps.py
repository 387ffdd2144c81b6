"""Sweeps of one axis in the same poses before and after a body was mounted: one joint fit of both.

The drive train is the same, so its uncertainty cancels in the differences.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from service.identification.axis.joint_fit import CHANCE, JointFit, fit_axis
from service.identification.axis.nominal_priors import NOISE_GUESS, pose_prior, shared_prior
from service.identification.estimates.estimate import SAME_POSITION, nominal_parameters
from service.identification.model.least_squares import Information, LeftOut
from service.identification.model.regressor import axis_rows, gravity_terms
from service.identification.spectra.frequency_response import Spectrum
from service.model.recording import SweepSpec
from service.model.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PairedFit:
    """n sweeps, those before first. `poses` (n, axes), `carried` (n,): 1 with the body mounted, `place` (n, places): 1
    if a sweep belongs to a place.
    """

    poses: Array
    carried: Array
    place: Array
    fit: JointFit

    def solve(self, added: Array) -> tuple[Information, float]:
        """Information from J = J_place + carried added x on the inertias at all places and x, for rows `added` (n, p).

        With the factor on the covariance if the residuals are larger than by chance.
        """
        columns = np.hstack([self.place, added])
        information = Information.empty(columns.shape[1]).add(columns, self.fit.inertia, self.fit.covariance)
        squares, freedom = LeftOut.of(columns, self.fit.inertia, [self.fit.covariance]).chi_squared(
            np.arange(len(columns))
        )
        worse = freedom >= 1 and squares > float(chdtri(freedom, CHANCE))
        return information, squares / freedom if worse else 1.0


def pairs(
    joint: str, before: Sequence[Spectrum], after: Sequence[Spectrum]
) -> tuple[list[Spectrum], list[Spectrum]] | None:
    """The periodic sweeps of an axis at common places; None if there are none."""
    own = [[one for one in part if one.spec.axis == joint and one.spec.periodic] for part in (before, after)]
    common = {place(one.spec) for one in own[0]} & {place(one.spec) for one in own[1]}
    kept = [[one for one in part if place(one.spec) in common] for part in own]
    return (kept[0], kept[1]) if common else None


def place(spec: SweepSpec) -> tuple[int, ...]:
    """The pose of a sweep on a grid of `SAME_POSITION`."""
    return tuple(round(position / SAME_POSITION) for position in spec.pose)


def fit_pairs(
    robot: Robot, number: int, before: Sequence[Spectrum], after: Sequence[Spectrum], body: Array
) -> PairedFit:
    """Sweeps of axis `number` at common places. `body` (10,): assumed parameters of the mounted body."""
    spectra = [*before, *after]
    poses = np.array([one.spec.pose for one in spectra])
    empty = nominal_parameters(robot, robot.chain, range(len(robot.axes)))
    mounted = np.zeros_like(empty)
    last = 10 * (len(robot.axes) - 1)
    mounted[last : last + 10] = body
    carried = (np.arange(len(spectra)) >= len(before)).astype(float)
    rows = axis_rows(robot.chain, number, poses)
    reference = rows @ empty + carried * (rows @ mounted)
    gravity = gravity_terms(robot.chain, empty, robot.gravity, number, poses)
    gravity += carried[:, None] * gravity_terms(robot.chain, mounted, robot.gravity, number, poses)
    fit = fit_axis(
        spectra,
        shared_prior(robot, number, reference, spectra),
        [pose_prior(robot, number, float(inertia), terms) for inertia, terms in zip(reference, gravity, strict=True)],
        NOISE_GUESS * robot.axes[number].rated_effort,
    )
    places = np.unique([place(one.spec) for one in spectra], axis=0, return_inverse=True)[1].ravel()
    return PairedFit(poses, carried, np.eye(int(places.max()) + 1)[places], fit)
