r"""The torque gain of each axis from a known mass: the same poses before and after it was bolted on.

A drive that tells g times the true effort shows every inertia g times too large, and no sweep can tell. The mass adds
the inertia D_p in pose p, known from its mass, place and shape alone, so for the inertias as the drive tells them

    J_before,p = J_p,    J_after,p = J_p + g D_p,

which is solved for all J_p and g at once by generalised least squares; p runs over the poses measured in both. Both
campaigns are one joint fit (`joint_fit`), because the drive train is the same one: what is not known of it drops out of
the differences.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from service.errors import BadInput
from service.identification.estimate import SAME_POSITION, nominal_parameters
from service.identification.frequency_response import Spectrum
from service.identification.joint_fit import CHANCE, fit_axis
from service.identification.least_squares import Information, LeftOut
from service.identification.nominal_priors import NOISE_GUESS, TorqueGain, pose_prior, shared_prior
from service.identification.regressor import axis_rows, gravity_terms
from service.robot import Robot
from service.urdf import transform_inertial

Array = NDArray[np.float64]


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
    """The gain of one axis; `poses` measured in both campaigns, `added` the largest inertia the mass added, kg m^2."""

    gain: TorqueGain
    poses: int
    added: float


def torque_gains(
    robot: Robot, before: Sequence[Spectrum], after: Sequence[Spectrum], mass: KnownMass
) -> dict[str, Calibration]:
    """By joint, of every axis swept with lines in one pose or more both before and after; BadInput if there is none."""
    if not mass.mass > 0:
        raise BadInput("mass", f"{mass.mass} kg is not above 0")
    found: dict[str, Calibration] = {}
    for number, joint in enumerate(robot.joints):
        pair = [[one for one in part if one.spec.axis == joint and one.spec.periodic] for part in (before, after)]
        common = set(map(_place, pair[0])) & set(map(_place, pair[1]))
        if common:
            kept = [[one for one in part if _place(one) in common] for part in pair]
            found[joint] = _axis(robot, number, kept[0], kept[1], mass)
    if not found:
        raise BadInput("test mass", "no axis was swept in the same pose before and after")
    return found


def _place(spectrum: Spectrum) -> tuple[int, ...]:
    """The pose of a sweep on a grid of `SAME_POSITION`."""
    return tuple(round(position / SAME_POSITION) for position in spectrum.spec.pose)


def _axis(
    robot: Robot, number: int, before: Sequence[Spectrum], after: Sequence[Spectrum], mass: KnownMass
) -> Calibration:
    spectra = [*before, *after]
    poses = np.array([one.spec.pose for one in spectra])
    empty = nominal_parameters(robot, robot.chain, range(len(robot.axes)))
    body = np.zeros_like(empty)
    last = 10 * (len(robot.axes) - 1)
    body[last : last + 10] = mass.parameters
    carried = (np.arange(len(spectra)) >= len(before)).astype(float)
    rows = axis_rows(robot.chain, number, poses)
    added = carried * (rows @ body)
    reference = rows @ empty + added
    gravity = gravity_terms(robot.chain, empty, robot.gravity, number, poses)
    gravity += carried[:, None] * gravity_terms(robot.chain, body, robot.gravity, number, poses)
    fit = fit_axis(
        spectra,
        shared_prior(robot, number, reference, spectra),
        [pose_prior(robot, number, float(inertia), terms) for inertia, terms in zip(reference, gravity, strict=True)],
        NOISE_GUESS * robot.axes[number].rated_effort,
    )
    places = np.unique([_place(one) for one in spectra], axis=0, return_inverse=True)[1].ravel()
    count = int(places.max()) + 1
    columns = np.hstack([np.eye(count)[places], added[:, None]])
    information = Information.empty(count + 1).add(columns, fit.inertia, fit.covariance)
    solution = information.solve(np.zeros(count + 1))
    joint = robot.joints[number]
    if not solution.determined[-1]:
        raise BadInput(joint, "the test mass adds no inertia to this axis in any of the poses")
    squares, freedom = LeftOut.of(columns, fit.inertia, [fit.covariance]).chi_squared(np.arange(len(spectra)))
    worse = freedom >= 1 and squares > float(chi2.isf(CHANCE, freedom))
    std = float(solution.std[-1]) * (np.sqrt(squares / freedom) if worse else 1.0)
    gain = TorqueGain(float(solution.values[-1]), std)
    return Calibration(gain, count, float(added.max()))
