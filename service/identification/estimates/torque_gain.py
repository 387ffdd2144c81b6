"""The torque gain of each axis from a known mass: the same poses before and after mounting it.

If a drive reports g times the true effort, every inertia is g times too large, and no sweep can detect it. The mass
adds the inertia D_p in pose p, known from its mass, position and shape, so for the inertias as reported by the drive

    J_before,p = J_p,    J_after,p = J_p + g D_p,

which is solved for all J_p and g together by generalised least squares; p runs over the poses measured in both. Both
campaigns are one joint fit (`joint_fit`), because the drive train is the same: its uncertainty cancels in
the differences.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from service import BadInput
from service.identification.axis.joint_fit import FitLimits, JointFit, fit_axis
from service.identification.axis.nominal_priors import NOISE_GUESS, TorqueGain, pose_prior, shared_prior
from service.identification.model import (
    SAME_POSITION,
    Information,
    LeftOut,
    axis_rows,
    gravity_terms,
    inertia_rows,
    inertial_parameters,
)
from service.identification.spectra.frequency_response import Spectrum
from service.model import Array, Robot, SweepSpec, transform_inertial


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
        worse = freedom >= 1 and squares > float(chdtri(freedom, FitLimits.chance))
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
    empty = inertial_parameters(robot)
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


@dataclass(frozen=True, slots=True)
class KnownMass:
    """A rigid body bolted to the last link, kg, m and kg m^2 in the frame of that link's joint.

    `inertia` (Ixx, Ixy, Iyy, Ixz, Iyz, Izz) about the centre of mass, along the axes of the frame.
    """

    mass: float
    center: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    @property
    def parameters(self) -> Array:
        """The ten inertial parameters (10,) at the frame's origin."""
        own = np.array([self.mass, 0.0, 0.0, 0.0, *self.inertia])
        return transform_inertial(own, np.eye(3), np.array(self.center))


@dataclass(frozen=True, slots=True)
class Calibration:
    """The gain of one axis; `poses` measured in both campaigns, `added`: largest inertia added by the mass, kg m^2."""

    gain: TorqueGain
    poses: int
    added: float


def torque_gains(
    robot: Robot, before: Sequence[Spectrum], after: Sequence[Spectrum], mass: KnownMass
) -> dict[str, Calibration]:
    """By joint, for every axis swept with lines in at least one pose both before and after. BadInput if there is
    none.
    """
    if not mass.mass > 0:
        raise BadInput("mass", f"{mass.mass} kg is not above 0")
    found: dict[str, Calibration] = {}
    for number, joint in enumerate(robot.joints):
        both = pairs(joint, before, after)
        if both is not None:
            found[joint] = _axis(robot, number, *both, mass)
    if not found:
        raise BadInput("test mass", "no axis was swept in the same pose before and after")
    return found


def _axis(
    robot: Robot, number: int, before: Sequence[Spectrum], after: Sequence[Spectrum], mass: KnownMass
) -> Calibration:
    paired = fit_pairs(robot, number, before, after, mass.parameters)
    last = 10 * (len(robot.axes) - 1)
    body = inertia_rows(robot.chain, number, paired.poses)[:, last : last + 10] @ mass.parameters
    added = paired.carried * body
    information, worse = paired.solve(added[:, None])
    solution = information.solve(np.zeros(len(information.vector)))
    if not solution.determined[-1]:
        raise BadInput(robot.joints[number], "the test mass adds no inertia to this axis in any of the poses")
    gain = TorqueGain(float(solution.values[-1]), float(solution.std[-1]) * np.sqrt(worse))
    return Calibration(gain, paired.place.shape[1], float(added.max()))
