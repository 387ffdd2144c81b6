r"""The torque gain of each axis from a known mass: the same poses before and after mounting it.

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
from numpy.typing import NDArray

from service.identification.axis.nominal_priors import TorqueGain
from service.identification.estimates.paired_sweeps import fit_pairs, pairs
from service.identification.model.regressor import inertia_rows
from service.identification.spectra.frequency_response import Spectrum
from service.model.errors import BadInput
from service.model.robot import Robot
from service.model.urdf import transform_inertial

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
