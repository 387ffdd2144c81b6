r"""Collision detection by MuJoCo with the collision shapes of the URDF and the obstacles of the cell.

Meshes count as their convex hulls, which are in the URDF (`service.model.urdf`); no file is opened.

Pairs checked: every link against the floor, the boxes and every other link but its neighbours in the chain and the
cell's `ignored_pairs`. A pose is free when every checked pair is at least `cell.clearance` apart.

Legs move one axis. A leg is sampled in steps of ``clearance / reach``; reach is an upper bound of the distance of any
point of the links after the axis from it: between two samples no point is farther than half the clearance from a
sampled position, so at least half of the clearance is left everywhere in between.

Inertial parameters are not needed and are removed from the model, so a URDF without them can also be checked.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence

import mujoco
import numpy as np

from service import BadInput
from service.model.arrays import Array, Mask
from service.model.configuration import Cell
from service.model.robot import Robot
from service.model.urdf import collision_meshes, joint_end, read_hull


class CollisionChecker:
    """Poses are arrays (m, n) in the order of `robot.joints`, rad (m). Deterministic; not thread-safe."""

    def __init__(self, robot: Robot, cell: Cell) -> None:
        """BadInput if a shape cannot be read, a mesh has no hull, or the cell names an unknown link."""
        self._clearance = cell.clearance
        self._model = compiled(robot, cell)
        self._data = mujoco.MjData(self._model)
        self._address = [int(self._model.joint(name).qposadr[0]) for name in robot.joints]
        self._step = np.array([cell.clearance / reach for reach in _reaches(robot, self._model)])

    @property
    def step(self) -> Array:
        """Sampling step of a leg of each joint, (n,), rad (m)."""
        return self._step

    def collision_free(self, poses: Array) -> Mask:
        """True if every checked pair keeps the clearance; (m, n) -> (m,). About 5 microseconds per pose."""
        model, data, clearance = self._model, self._data, self._clearance
        qpos = np.zeros((len(poses), model.nq))
        qpos[:, self._address] = poses
        free = np.ones(len(qpos), dtype=bool)
        for i, q in enumerate(qpos):
            data.qpos[:] = q
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            # MuJoCo reports pairs closer than the sum of both margins; the clearance is the nearer limit
            if data.ncon and data.contact.dist.min() < clearance:
                free[i] = False
        return free

    def touching(self, poses: Array) -> set[tuple[str, str]]:
        """Pairs of links that come closer than the clearance in any of the poses (m, n)."""
        model, data = self._model, self._data
        bodies: set[tuple[int, int]] = set()
        for q in np.atleast_2d(poses):
            data.qpos[self._address] = q
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            if data.ncon:
                near = data.contact.geom[data.contact.dist < self._clearance]
                bodies.update(map(tuple, model.geom_bodyid[near].tolist()))
        return {(str(model.body(one).name), str(model.body(other).name)) for one, other in bodies}

    def leg_free(self, pose: Sequence[float] | Array, joint: int, target: float) -> bool:
        """Whether the motion of one joint from `pose` to `target` is free, including both ends."""
        start = float(pose[joint])
        count = int(np.ceil(abs(target - start) / self._step[joint])) + 1
        poses = np.tile(np.asarray(pose, dtype=float), (max(count, 2), 1))
        poses[:, joint] = np.linspace(start, target, len(poses))
        return bool(self.collision_free(poses).all())

    def path_free(self, path: Array) -> bool:
        """Whether the motion through these poses (m, n), all joints moving at the same time, is free.

        Looked at where the steps of all joints together are one of `step`, and at both ends; this leaves half of the
        clearance everywhere as for a leg.
        """
        way: Array = np.append(0.0, (np.abs(np.diff(path, axis=0)) / self._step).sum(axis=1).cumsum())
        places = np.linspace(0.0, way[-1], math.ceil(way[-1]) + 1, dtype=np.float64)
        poses: list[Array] = [np.interp(places, way, own) for own in path.T]
        return bool(self.collision_free(np.stack(poses, axis=1)).all())

    def travel_free(self, poses: Array, joint: int, travel: float) -> Mask:
        """`leg_free` for many poses at once, each moving `joint` by the signed `travel`; (m, n) -> (m,)."""
        free = np.ones(len(poses), dtype=bool)
        count = int(np.ceil(abs(travel) / self._step[joint])) + 1
        for offset in np.linspace(0.0, travel, max(count, 2)):
            left = np.flatnonzero(free)
            moved = poses[left].copy()
            moved[:, joint] += offset
            free[left] = self.collision_free(moved)
        return free


def reachable(robot: Robot, stood: Array, poses: Array) -> Array:
    """Those of `poses` (m, n) without self-collision; the cell is not considered here.

    Shapes that overlap in a pose where the robot `stood` (k, n) overlap by construction and are ignored. A URDF with
    unreadable shapes (meshes without hulls) counts as without shapes: the result is not used to move.
    """
    bare = Cell(name="none", clearance=1e-3)
    try:
        nested = CollisionChecker(robot, bare).touching(stood)
    except BadInput:
        return poses
    checker = CollisionChecker(robot, bare.model_copy(update={"ignored_pairs": tuple(sorted(nested))}))
    return poses[checker.collision_free(poses)]


def compiled(robot: Robot, cell: Cell) -> mujoco.MjModel:
    """MuJoCo's model of the collision shapes of robot and cell; BadInput if a shape cannot be read."""
    place = f"robot {robot.name} urdf"
    text, hulls = _shapes_only(robot.urdf_text, place)
    try:
        spec = mujoco.MjSpec.from_string(text)
    except ValueError as error:
        raise BadInput(place, f"collision shapes cannot be read: {_line(error)}") from None
    for mesh in spec.meshes:
        mesh.uservert, mesh.file = hulls[str(mesh.name)].ravel(), ""
    links = {str(body.name) for body in spec.bodies}
    if cell.floor is not None:
        spec.worldbody.add_geom(
            name="cell floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], pos=[0, 0, cell.floor]
        )
    for box in cell.boxes:
        spec.worldbody.add_geom(
            name=f"cell {box.name}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[edge / 2 for edge in box.size],
            pos=list(box.center),
            quat=[np.cos(box.yaw / 2), 0, 0, np.sin(box.yaw / 2)],
        )
    # MuJoCo ignores neighbours in the chain, unless the neighbour is fixed to the world
    first = robot.chain.joints[0].link
    for pair in [(link, first) for link in _standing_links(robot.urdf_text)] + list(cell.ignored_pairs):
        for link in pair:
            if link not in links:
                raise BadInput(
                    f"cell {cell.name} ignored_pairs",
                    f"robot {robot.name} has no link {link}: choose the cell of this robot, or delete the pair",
                )
        spec.add_exclude(bodyname1=pair[0], bodyname2=pair[1])
    for geom in spec.geoms:
        geom.margin = cell.clearance  # set later, it would not reach the bodies' margin, by which MuJoCo excludes pairs
    try:
        return spec.compile()
    except ValueError as error:
        raise BadInput(place, f"collision shapes cannot be read: {_line(error)}") from None


def _shapes_only(urdf: str, place: str) -> tuple[str, dict[str, Array]]:
    """The URDF reduced to collision, and its hulls by the names of its meshes in the result.

    Static links stay bodies of their own.
    """
    root = ET.fromstring(urdf)
    for element in [child for child in root if child.tag not in ("link", "joint")]:
        root.remove(element)
    for link in root.findall("link"):
        for tag in ("visual", "inertial"):
            for element in link.findall(tag):
                link.remove(element)
    hulls: dict[str, Array] = {}
    for link, mesh in collision_meshes(root):
        name = f"hull_{len(hulls)}"
        hulls[name] = read_hull(mesh, f"{place} link {link}")
        mesh.clear()
        mesh.set("filename", f"{name}.stl")  # never opened
    extension = ET.SubElement(root, "mujoco")
    ET.SubElement(extension, "compiler", {"fusestatic": "false", "boundmass": "1", "boundinertia": "1"})
    return ET.tostring(root, encoding="unicode"), hulls


def _line(error: ValueError) -> str:
    return " ".join(str(error).split())


def _standing_links(urdf: str) -> list[str]:
    """Links that cannot move: the root and what is fixed to it."""
    root = ET.fromstring(urdf)
    joints = root.findall("joint")
    ends = [(one.get("type"), joint_end(one, "parent", "urdf"), joint_end(one, "child", "urdf")) for one in joints]
    carried = {child for _, _, child in ends}
    standing = [name for link in root.findall("link") if (name := link.get("name", "")) not in carried]
    for link in standing:  # extended during the loop: fixed children are added
        standing.extend(child for kind, parent, child in ends if kind == "fixed" and parent == link)
    return standing


def _reaches(robot: Robot, model: mujoco.MjModel) -> list[float]:
    """For each joint an upper bound of the distance from its axis to any point of the links after it, m.

    Sum of all joint offsets plus the farthest shape of each link. A prismatic joint moves
    every point by its own travel: 1.
    """
    joints = robot.chain.joints
    extent: list[float] = []
    for joint in joints:
        own = _welded(model, int(model.joint(joint.name).bodyid[0]))
        extent.append(
            max((_geom_reach(model, g, own) for g in range(model.ngeom) if model.geom_bodyid[g] in own), default=0.0)
        )
    reaches: list[float] = []
    for k, joint in enumerate(joints):
        reach, offset = extent[k], 0.0
        for i in range(k + 1, len(joints)):
            offset += float(np.linalg.norm(joints[i].translation))
            if joints[i].kind == "prismatic":
                offset += max(abs(joints[i].lower), abs(joints[i].upper))
            reach = max(reach, offset + extent[i])
        reaches.append(1.0 if joint.kind == "prismatic" else max(reach, 0.1))
    return reaches


def _welded(model: mujoco.MjModel, body: int) -> list[int]:
    """A moving body and the bodies fixed to it."""
    return [b for b in range(model.nbody) if model.body_weldid[b] == body]


def _geom_reach(model: mujoco.MjModel, geom: int, own: list[int]) -> float:
    """Upper bound of the distance of a geom's points from the frame of the moving body it is fixed to, m."""
    reach = float(np.linalg.norm(model.geom_pos[geom]) + model.geom_rbound[geom])
    body = int(model.geom_bodyid[geom])
    while body != own[0]:
        reach += float(np.linalg.norm(model.body_pos[body]))
        body = int(model.body_parentid[body])
    return reach
