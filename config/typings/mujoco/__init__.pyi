"""Types of the part of MuJoCo that is used here: its modules are binary and have none. Views (1,) of a joint."""

from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]
_Integers = NDArray[np.int32]

class _Named:
    name: str

class _Joint(_Named):
    qposadr: _Integers
    bodyid: _Integers

class _Option:
    gravity: _Array

class MjModel:
    nq: int
    nv: int
    nbody: int
    ngeom: int
    njnt: int
    opt: _Option
    jnt_type: _Integers
    geom_margin: _Array
    geom_pos: _Array
    geom_rbound: _Array
    geom_bodyid: _Integers
    geom_type: _Integers
    geom_size: _Array
    geom_dataid: _Integers
    mesh_vertadr: _Integers
    mesh_vertnum: _Integers
    mesh_vert: NDArray[np.float32]
    body_pos: _Array
    body_weldid: _Integers
    body_parentid: _Integers
    @classmethod
    def from_xml_string(cls, xml: str) -> Self: ...
    def joint(self, name: str | int) -> _Joint: ...
    def body(self, index: int) -> _Named: ...
    def geom(self, index: int) -> _Named: ...

class _Contacts:
    dist: _Array  # (n,)
    geom: _Integers  # (n, 2)

class MjData:
    qpos: _Array
    qvel: _Array
    qfrc_spring: _Array
    geom_xpos: _Array  # (n, 3)
    geom_xmat: _Array  # (n, 9)
    ncon: int
    contact: _Contacts
    def __init__(self, model: MjModel) -> None: ...

class _Mesh(_Named):
    file: str
    uservert: _Array  # (3 n,), used instead of its file

class _Geom(_Named):
    margin: float

class _World:
    def add_geom(
        self, *, name: str, type: int, size: Sequence[float], pos: Sequence[float], quat: Sequence[float] = ...
    ) -> None: ...

class MjSpec:
    meshes: Sequence[_Mesh]
    bodies: Sequence[_Named]
    geoms: Sequence[_Geom]
    worldbody: _World
    @classmethod
    def from_string(cls, xml: str) -> Self: ...
    def add_exclude(self, *, bodyname1: str, bodyname2: str) -> None: ...
    def compile(self) -> MjModel: ...

class mjtGeom:
    mjGEOM_PLANE: int
    mjGEOM_CAPSULE: int
    mjGEOM_ELLIPSOID: int
    mjGEOM_CYLINDER: int
    mjGEOM_BOX: int
    mjGEOM_MESH: int

class mjtJoint:
    mjJNT_SLIDE: int
    mjJNT_HINGE: int

def mj_forward(m: MjModel, d: MjData) -> None: ...
def mj_kinematics(m: MjModel, d: MjData) -> None: ...
def mj_collision(m: MjModel, d: MjData) -> None: ...
def mj_geomDistance(m: MjModel, d: MjData, geom1: int, geom2: int, distmax: float, fromto: _Array | None) -> float: ...
def mj_comPos(m: MjModel, d: MjData) -> None: ...
def mj_comVel(m: MjModel, d: MjData) -> None: ...
def mj_crb(m: MjModel, d: MjData) -> None: ...
def mj_fullM(m: MjModel, d: MjData, dst: _Array) -> None: ...
def mj_rne(m: MjModel, d: MjData, flg_acc: int, result: _Array) -> None: ...
