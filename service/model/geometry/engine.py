"""The used part of MuJoCo, with types: it is a binary module without stubs. Only this module imports it."""

from collections.abc import Sequence
from typing import Protocol, cast

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int32]


class Joint(Protocol):
    """Views (1,) into the model."""

    qposadr: Integers
    bodyid: Integers


class Geom(Protocol):
    """A shape of a model."""

    name: str


class Body(Protocol):
    """A body of a model or of its specification."""

    name: str


class Model(Protocol):
    """A compiled model: sizes, and arrays by geom and by body."""

    nq: int
    nbody: int
    ngeom: int
    geom_margin: Array
    geom_pos: Array
    geom_rbound: Array
    geom_bodyid: Integers
    geom_type: Integers
    geom_size: Array
    geom_dataid: Integers
    mesh_vertadr: Integers
    mesh_vertnum: Integers
    mesh_vert: NDArray[np.float32]
    body_pos: Array
    body_weldid: Integers
    body_parentid: Integers

    def joint(self, name: str) -> Joint: ...

    def body(self, index: int) -> Body: ...

    def geom(self, index: int) -> Geom: ...


class Contacts(Protocol):
    """By contact: distance (n,), and the two geoms (n, 2)."""

    dist: Array
    geom: Integers


class Data(Protocol):
    """The state of a model; `geom_xpos` (n, 3) and `geom_xmat` (n, 9) once the kinematics were computed."""

    qpos: Array
    geom_xpos: Array
    geom_xmat: Array
    ncon: int
    contact: Contacts


class Mesh(Protocol):
    """A mesh of a specification: vertices (3 n,), used instead of its file."""

    name: str
    file: str
    uservert: Array


class World(Protocol):
    """The world of the simulation."""

    def add_geom(
        self, *, name: str, type: int, size: Sequence[float], pos: Sequence[float], quat: Sequence[float] = ...
    ) -> None: ...


class Spec(Protocol):
    """A model before it is compiled."""

    meshes: Sequence[Mesh]
    bodies: Sequence[Body]
    worldbody: World

    def add_exclude(self, *, bodyname1: str, bodyname2: str) -> None: ...

    def compile(self) -> Model:
        """ValueError if the specification is invalid."""
        ...


class Specs(Protocol):
    """The class of specifications."""

    def from_string(self, text: str) -> Spec:
        """From MJCF or URDF; ValueError if it cannot be read."""
        ...


class Shapes(Protocol):
    """Kinds of geoms."""

    mjGEOM_PLANE: int
    mjGEOM_SPHERE: int
    mjGEOM_CAPSULE: int
    mjGEOM_ELLIPSOID: int
    mjGEOM_CYLINDER: int
    mjGEOM_BOX: int
    mjGEOM_MESH: int


class Engine(Protocol):
    """The module."""

    MjSpec: Specs
    mjtGeom: Shapes

    def MjData(self, model: Model) -> Data: ...

    def mj_kinematics(self, m: Model, d: Data) -> None: ...

    def mj_collision(self, m: Model, d: Data) -> None: ...


engine = cast("Engine", mujoco)
