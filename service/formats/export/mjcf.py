"""The robot as a MuJoCo model: one body per moving link, armature = motor inertia, damping and frictionloss
= identified viscous and dry friction.

Collision shapes that are boxes, cylinders or spheres become visual geoms without collision, because shapes
of neighbours may overlap. Meshes are omitted.
"""

import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from service.formats.export.model import Body, IdentifiedModel
from service.formats.export.shapes import Shape, shapes
from service.model.urdf import Joint

Array = NDArray[np.float64]


def as_mjcf(model: IdentifiedModel) -> str:
    """The text of the file. Angles in radian; joint ranges as in the URDF, none for a continuous joint."""
    root = ET.Element("mujoco", model=model.robot.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(root, "option", gravity=_text(model.robot.gravity))
    carrier = ET.SubElement(root, "worldbody")
    found = shapes(model.robot.urdf_text)
    _add_shapes(carrier, found.get(None, []))
    frictions = zip(model.friction, model.dry_friction, strict=True)
    parts = zip(model.robot.chain.joints, model.bodies, model.motor_inertias, frictions, strict=True)
    for joint, body, motor, (friction, dry) in parts:
        carrier = _body(carrier, joint, body)
        element = ET.SubElement(carrier, "joint", name=joint.name, axis=_text(joint.axis))
        element.set("type", "slide" if joint.kind == "prismatic" else "hinge")
        element.set("armature", repr(float(motor)))
        element.set("damping", repr(friction or 0.0))
        element.set("frictionloss", repr(dry or 0.0))
        if np.isfinite([joint.lower, joint.upper]).all():
            element.set("range", _text([joint.lower, joint.upper]))
        _add_shapes(carrier, found.get(body.link, []))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _body(carrier: ET.Element, joint: Joint, body: Body) -> ET.Element:
    element = ET.SubElement(
        carrier, "body", name=body.link, pos=_text(joint.translation), quat=_text(quaternion(joint.rotation))
    )
    tensor = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    ET.SubElement(element, "inertial", pos=_text(body.centre), mass=repr(body.mass), fullinertia=_text(tensor))
    return element


def _add_shapes(carrier: ET.Element, found: list[Shape]) -> None:
    for shape in found:
        ET.SubElement(
            carrier,
            "geom",
            type=shape.kind,
            size=_text(shape.size),
            pos=_text(shape.translation),
            quat=_text(quaternion(shape.rotation)),
            contype="0",
            conaffinity="0",
        )


def quaternion(rotation: Array) -> Array:
    """(4,) w, x, y, z of a rotation matrix: the eigenvector of Bar-Itzhack (2000), which is accurate at every angle."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    matrix = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, yy - xx - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, zz - xx - yy],
        ]
    )
    vector = np.asarray(np.linalg.eigh(matrix)[1][:, -1], dtype=float)
    return vector if vector[0] >= 0 else -vector


def _text(values: Array | list[float] | tuple[float, ...]) -> str:
    return " ".join(repr(float(value)) for value in values)
