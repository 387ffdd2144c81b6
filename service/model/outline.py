"""The silhouettes of a robot and its cell in a pose, for a picture of the machine.

Every collision shape is convex (meshes count as their hulls), so its silhouette is the convex hull of its projected
points. Spheres, cylinders and capsules are approximated by points; the error is below 2 % of their radius.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from service.model.arrays import Array
from service.model.collision import compiled
from service.model.configuration import Cell
from service.model.robot import Robot


@dataclass(frozen=True, slots=True)
class Outline:
    """One shape: its link or, of the cell, its name; corners (x, z) from the side and (x, y) from above, m."""

    name: str
    side: tuple[tuple[float, float], ...]
    above: tuple[tuple[float, float], ...]


class Outlines:
    """Deterministic; not thread-safe."""

    def __init__(self, robot: Robot, cell: Cell) -> None:
        """BadInput if a shape cannot be read, a mesh has no hull, or the cell names an unknown link."""
        self._model = compiled(robot, cell)
        self._data = mujoco.MjData(self._model)
        self._address = [int(self._model.joint(name).qposadr[0]) for name in robot.joints]
        kinds = self._model.geom_type.tolist()
        self._points = {
            geom: _points(self._model, geom) for geom, kind in enumerate(kinds) if kind != mujoco.mjtGeom.mjGEOM_PLANE
        }

    def of_robot(self, pose: Sequence[float] | Array) -> tuple[Outline, ...]:
        """Base to tip; `pose` (n,) in the order of `robot.joints`, rad (m)."""
        return tuple(self._outlines(pose, standing=False))

    def of_cell(self) -> tuple[Outline, ...]:
        """The boxes of the cell, without a floor."""
        return tuple(self._outlines(np.zeros(len(self._address)), standing=True))

    def _outlines(self, pose: Sequence[float] | Array, *, standing: bool) -> Iterator[Outline]:
        self._data.qpos[self._address] = pose
        mujoco.mj_kinematics(self._model, self._data)
        for geom, points in self._points.items():
            name, body = self._model.geom(geom).name, int(self._model.geom_bodyid[geom])
            if standing != (body == 0 and name.startswith("cell ")):
                continue
            placed = points @ self._data.geom_xmat[geom].reshape(3, 3).T + self._data.geom_xpos[geom]
            shown = name.removeprefix("cell ") if standing else str(self._model.body(body).name)
            # a view keeps two coordinates of the base frame
            yield Outline(shown, silhouette(placed[:, (0, 2)]), silhouette(placed[:, (0, 1)]))


def silhouette(points: Array) -> tuple[tuple[float, float], ...]:
    """The corners of the convex hull of points (m, 2), counter-clockwise; both end points if they are collinear."""
    digits = 4  # of a coordinate in m
    try:
        corners = points[ConvexHull(points).vertices]
    except QhullError:
        along = np.argmax(np.ptp(points, axis=0))
        corners = points[[points[:, along].argmin(), points[:, along].argmax()]]
    return tuple((round(float(x), digits), round(float(y), digits)) for x, y in corners)


def _points(model: mujoco.MjModel, geom: int) -> Array:
    """Points of a shape in its own frame, (m, 3), m."""
    kind, size, kinds = int(model.geom_type[geom]), model.geom_size[geom], mujoco.mjtGeom
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        return model.mesh_vert[first : first + count].astype(np.float64)
    if kind == kinds.mjGEOM_BOX:
        return np.array([(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]) * size
    angle = np.linspace(0, 2 * np.pi, 20, endpoint=False)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    if kind == kinds.mjGEOM_CYLINDER:
        return np.array([(x, y, z) for x, y in circle for z in (-1.0, 1.0)]) * (size[0], size[0], size[1])
    heights = np.sin(np.linspace(-np.pi / 2, np.pi / 2, len(circle) // 2 + 1))
    unit_ball = np.array([(r * x, r * y, h) for h in heights for r in (float(np.sqrt(1 - h * h)),) for x, y in circle])
    ball = unit_ball * (size if kind == kinds.mjGEOM_ELLIPSOID else size[0])
    if kind == kinds.mjGEOM_CAPSULE:
        end = np.array([0.0, 0.0, size[1]])
        return np.vstack([ball + end, ball - end])
    return ball
