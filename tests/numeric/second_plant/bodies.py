"""What MuJoCo says of the axis that moves: its inertia and the torque that weight asks of it, over its whole travel."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from tests.numeric.second_plant.robots import Mechanism, urdf

Array = NDArray[np.float64]

STANDARD = (0.0, 0.0, -9.81)


@dataclass(frozen=True)
class Curve:
    """A torque over the axis' own position, one row a sweep, on an even grid about each sweep's start."""

    start: Array  # (m,) rad, where each row's grid begins
    step: float  # rad
    values: Array  # (m, points) N m

    def at(self, position: Array) -> Array:
        """(m,) for one position a sweep, linear between grid points; outside, the last slope goes on."""
        place = (position - self.start) / self.step
        cell = np.minimum(np.maximum(place.astype(np.intp), 0), self.values.shape[1] - 2)
        row = np.arange(len(position))
        low = self.values[row, cell]
        return low + (place - cell) * (self.values[row, cell + 1] - low)


class Rigid:
    """A chain of rigid bodies in MuJoCo, by the positions of its drives; not thread-safe."""

    def __init__(self, mechanism: Mechanism, gravity: tuple[float, float, float] = STANDARD) -> None:
        self.model = mujoco.MjModel.from_xml_string(urdf(mechanism))
        self.model.opt.gravity[:] = gravity
        self.coupling = mechanism.coupling
        self.data = mujoco.MjData(self.model)

    def inertia(self, joint: int, pose: Array) -> float:
        """About one axis with the others held, kg m^2 (kg)."""
        return float(self.matrix(pose)[joint, joint])

    def matrix(self, pose: Array) -> Array:
        """The inertia as the drives feel it, (n, n)."""
        self.data.qpos[:] = self.coupling @ pose
        mujoco.mj_forward(self.model, self.data)
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        return self.coupling.T @ full @ self.coupling

    def holding(self, pose: Array) -> Array:
        """Torques that hold a pose against gravity, (n,)."""
        self.data.qpos[:] = self.coupling @ pose
        self.data.qvel[:] = 0.0
        mujoco.mj_forward(self.model, self.data)
        return self.coupling.T @ self.data.qfrc_bias

    def curve(self, joint: int, poses: Array, reach: float, step: float = 2e-3) -> Curve:
        """What holds the axis against gravity within `reach` of each pose (m, n)."""
        away = np.arange(-reach, reach + step, step)
        distinct, which = np.unique(poses, axis=0, return_inverse=True)
        values = np.empty((len(distinct), len(away)))
        for row, pose in enumerate(distinct):
            moved = pose.copy()
            for k, distance in enumerate(away):
                moved[joint] = pose[joint] + distance
                values[row, k] = self.holding(moved)[joint]
        return Curve(poses[:, joint] + away[0], step, values[which.ravel()])


@dataclass(frozen=True)
class Cylinder:
    """A spring or cylinder from a point of the body before a joint, m in its frame, to one of the joint's own."""

    joint: int
    fixed: Array
    moved: Array
    pull: Callable[[Array], Array]  # N at a length in m

    def holding(self, mechanism: Mechanism, position: Array) -> Array:
        """What the axis must hold against it, N m, at its positions (k,): force times MuJoCo's rate of a tendon."""
        spec = mujoco.MjSpec.from_string(urdf(mechanism))
        bodies = [spec.worldbody, *(spec.body(f"link_{k + 1}") for k in range(len(mechanism.joints)))]
        ends = ("fixed", bodies[self.joint], self.fixed), ("moved", bodies[self.joint + 1], self.moved)
        tendon = spec.add_tendon(name="cylinder")
        for name, body, place in ends:
            body.add_site(name=name, pos=place)
            tendon.wrap_site(name)
        model = spec.compile()
        data, step = mujoco.MjData(model), 1e-5
        lengths = np.empty((len(position), 3))
        for row, place in enumerate(position):
            for column, away in enumerate((-step, 0.0, step)):
                data.qpos[self.joint] = place + away
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_tendon(model, data)
                lengths[row, column] = data.ten_length[0]
        return self.pull(lengths[:, 1]) * (lengths[:, 2] - lengths[:, 0]) / (2 * step)
