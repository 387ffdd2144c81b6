r"""One axis at a time along a motion of all axes: the effort of the rigid robot, split as for a sweep of one axis.

    effort_k = J_k(t) a_k + gravity_k(t) + coupling_k(t) + friction + other torques on the axis

    J_k = M_kk(q) + Jm_k,    gravity_k = g_k(q),    coupling_k = sum_(j != k) M_kj a_j + (C(q, v) v)_k

so that methods for a single axis (a diagnosis, a fit of its friction) can use  effort - coupling.  a_k is the
motor's: if a direct encoder measures how the load differs from it, M_kk times the difference is in the coupling.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.model.base_parameters import BaseParameters
from service.identification.model.inverse_dynamics import Motion, link_rows
from service.identification.model.regressor import inertia_rows
from service.identification.motion.equations import CHUNK, load_and_motor
from service.identification.motion.free_motion import FreeMotion
from service.identification.spectra.low_pass import memory
from service.model.robot import Robot

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AlongAxis:
    """One axis along a record, all (m,) at the record's samples, SI on the joint side.

    `velocity`, `acceleration` of the motor, smoothed; `inertia` including the motor; `gravity` and `coupling` N m
    (N). `sound`: False near the ends of the record, where the acceleration is unknown unless the axis rested.
    """

    joint: str
    velocity: Array
    acceleration: Array
    inertia: Array
    gravity: Array
    coupling: Array
    sound: NDArray[np.bool_]

    @property
    def rigid(self) -> Array:
        """Effort of links and motor, (m,) N m (N)."""
        return self.inertia * self.acceleration + self.gravity + self.coupling


def whole_parameters(robot: Robot, base: BaseParameters, values: Array) -> Array:
    """Parameters (14 n,) with the same efforts as base parameters (r,); all that are not in the base are 0."""
    parameters = np.zeros(14 * len(robot.axes))
    parameters[list(base.columns)] = values
    return parameters


def rigid_along(robot: Robot, parameters: Array, records: Sequence[FreeMotion]) -> tuple[Mapping[str, AlongAxis], ...]:
    """For every record, by joint. `parameters` (14 n,) as in `inverse_dynamics`; friction is not included."""
    return tuple(_along(robot, parameters, record) for record in records)


def _along(robot: Robot, parameters: Array, record: FreeMotion) -> dict[str, AlongAxis]:
    count = len(robot.axes)
    links, motors = parameters[: 10 * count], parameters[10 * count : 11 * count]
    load, motor = load_and_motor(robot, record)
    samples = len(load.position)
    efforts, gravity = np.zeros((2, samples, count))
    for first in range(0, samples, CHUNK):
        part = slice(first, first + CHUNK)
        there = load.position[part]
        moved = Motion(there, load.velocity[part], load.acceleration[part])
        efforts[part] = link_rows(robot.chain, robot.gravity, moved) @ links
        gravity[part] = link_rows(robot.chain, robot.gravity, Motion(there, 0 * there, 0 * there)) @ links
    time = np.arange(samples) / record.rate
    sound = (time > memory(record.motion_cut)) & (time < time[-1] - memory(record.motion_cut))
    found: dict[str, AlongAxis] = {}
    for joint in record.joints:
        k = robot.index(joint)
        own = inertia_rows(robot.chain, k, load.position) @ links
        found[joint] = AlongAxis(
            joint=joint,
            velocity=motor.velocity[:, k],
            acceleration=motor.acceleration[:, k],
            inertia=own + motors[k],
            gravity=gravity[:, k],
            coupling=efforts[:, k] - gravity[:, k] - own * motor.acceleration[:, k],
            sound=sound,
        )
    return found
