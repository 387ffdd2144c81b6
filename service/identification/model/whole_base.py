"""The base parameters of the efforts of all axes that move."""

import numpy as np
from numpy.typing import NDArray

from service.identification.model.base_parameters import BaseParameters, joint_ranges, reduce_columns
from service.identification.model.inverse_dynamics import Motion, dynamics_names, dynamics_rows
from service.model.robot import Robot

Array = NDArray[np.float64]

SAMPLES = 200  # random motions that represent all motions


def dynamic_base(robot: Robot, ends: tuple[Array, Array] | None = None) -> BaseParameters:
    """The base parameters of the efforts of all axes that move, including friction and offsets; columns of the 14 n.

    `ends`: lower and upper (n,) positions of the joints, rad (m); a joint with equal ends stands. None: the whole
    range of every joint.
    """
    rng = np.random.default_rng(0)
    lower, upper = ends or joint_ranges(robot.chain)
    moving, shape = lower < upper, (SAMPLES, len(lower))
    motion = Motion(rng.uniform(lower, upper, shape), *(moving * rng.uniform(-1.0, 1.0, (2, *shape))))
    rows = dynamics_rows(robot.chain, robot.gravity, motion)[:, moving]
    return reduce_columns(rows.reshape(-1, rows.shape[-1]), dynamics_names(robot.chain))
