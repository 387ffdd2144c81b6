"""The same axis with all joints free in MuJoCo's own step, the others in stiff position loops: what the stepping of
`machine` is compared with.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray

from tests.numeric.second_plant.bodies import STANDARD, Rigid
from tests.numeric.second_plant.machine import STEP, Controls, Raw
from tests.numeric.second_plant.plans import Motion
from tests.numeric.second_plant.robots import Mechanism

Array = NDArray[np.float64]

GEARED = 1e5  # kg m^2: rotors of the axes that hold, so heavy that what they yield is below a thousandth
HELD = 2 * np.pi * 10.0  # rad/s of their loops


def run_free(
    mechanism: Mechanism,
    index: int,
    motor: float,
    viscous: float,
    controls: Controls,
    poses: Array,
    wanted: Motion,
    gravity: tuple[float, float, float] = STANDARD,
) -> Raw:
    """Sweeps one after the other, poses (m, n); a rigid gear with viscous friction and nothing hidden."""
    rigid = Rigid(mechanism, gravity)
    model, data = rigid.model, rigid.data
    model.opt.timestep, model.opt.integrator = STEP, mujoco.mjtIntegrator.mjINT_RK4
    model.dof_armature[:] = GEARED
    model.dof_armature[index] = motor
    model.dof_damping[index] = viscous
    model.jnt_limited[:] = 0
    steps, count = wanted.velocity.shape
    torque, velocity, position = (np.empty((steps, count)) for _ in range(3))
    for k, pose in enumerate(poses):
        held = rigid.holding(pose)
        mujoco.mj_resetData(model, data)
        data.qpos[:] = pose
        integral = held[index]
        for n in range(steps):
            wants = wanted.velocity[n, k] + controls.position * (wanted.position[n, k] - data.qpos[index] + pose[index])
            error = wants - data.qvel[index]
            integral += STEP * controls.reset * controls.speed * error
            asked = controls.inertia * wanted.acceleration[n, k] + controls.viscous * wanted.velocity[n, k]
            asked += controls.speed * error + integral
            torque[n, k], velocity[n, k], position[n, k] = asked, data.qvel[index], data.qpos[index]
            data.qfrc_applied[:] = held + GEARED * (HELD**2 * (pose - data.qpos) - 2 * HELD * data.qvel)
            data.qfrc_applied[index] = np.clip(asked, -controls.limit, controls.limit)
            mujoco.mj_step(model, data)
    told = torque.copy()
    told[1:] = (torque[1:] + torque[:-1]) / 2
    return Raw(told, velocity, position, position)
