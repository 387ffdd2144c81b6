"""The robot's own URDF with the identified inertial parameters.

No motion can separate the parameters of links that are fixed to each other: only their total is identified. It is
distributed to those that have an ``<inertial>``, as near to the original as possible (`physical_consistency`). So every
link stays physical, and the total is the same however a reader treats fixed joints. The base and what is fixed to it
are unchanged. URDF has no element for the motor inertia; it is in the side file.

MuJoCo would compute the mass of links without ``<inertial>`` from their shapes; a ``<mujoco>`` element, ignored by
other programs, disables that.
"""

import xml.etree.ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from service.formats.export.links import PlacedLink, placed_links
from service.formats.export.model import Body, IdentifiedModel, body
from service.identification.model.physical_consistency import SearchEnded, nearest_physical
from service.model.errors import BadInput
from service.model.urdf import read_inertial, transform_inertial

Array = NDArray[np.float64]


def as_urdf(model: IdentifiedModel) -> str:
    """The text of the file; shapes and comments of the original are kept."""
    root = ET.fromstring(model.robot.urdf_text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
    links = placed_links(root)
    for whole in model.bodies:
        for link, part in _shares(whole, [link for link in links if link.carrier == whole.link]):
            for old in link.element.findall("inertial"):
                link.element.remove(old)
            link.element.insert(0, _inertial(part))
    joints = {element.get("name"): element for element in root.findall("joint")}
    for key, values in (("damping", model.friction), ("friction", model.dry_friction)):
        for joint, value in zip(model.robot.joints, values, strict=True):
            if value is not None:
                _child(joints[joint], "dynamics").set(key, repr(value))
    _child(_child(root, "mujoco"), "compiler").set("inertiafromgeom", "false")
    ET.indent(root)
    return '<?xml version="1.0"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _shares(whole: Body, group: list[PlacedLink]) -> list[tuple[PlacedLink, Body]]:
    """The links with mass in a rigid group, each with its part of the total; the moving link if none has mass."""
    nominal = {link.name: read_inertial(link.element, "urdf") for link in group}
    heavy = [link for link in group if nominal[link.name][0] > 0]
    if len(heavy) < 2:
        alone = heavy[0] if heavy else group[0]
        return [(alone, body(alone.name, _seen_from(alone, whole.parameters)))]
    rows = np.hstack([_transform(link) for link in heavy])
    motors = np.zeros(len(heavy))
    found = nearest_physical(
        np.concatenate([*(nominal[link.name] for link in heavy), motors]),
        (1.0, motors + 1.0),
        np.hstack([rows, np.zeros((10, len(heavy)))]),
        whole.parameters,
        np.eye(10),
    )
    if found.ended is SearchEnded.UNFINISHED:
        names = ", ".join(link.name for link in heavy)
        raise BadInput("urdf", f"the identified body cannot be shared among {names}: {found.ended.value}")
    shares = found.parameters[: 10 * len(heavy)].reshape(-1, 10)
    return [(link, body(link.name, share)) for link, share in zip(heavy, shares, strict=True)]


def _transform(link: PlacedLink) -> Array:
    """(10, 10): parameters in the link's own frame to those in the frame of its moving link."""
    return np.stack([transform_inertial(unit, link.rotation, link.translation) for unit in np.eye(10)], -1)


def _seen_from(link: PlacedLink, parameters: Array) -> Array:
    return transform_inertial(parameters, link.rotation.T, -link.rotation.T @ link.translation)


def _inertial(part: Body) -> ET.Element:
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=" ".join(repr(float(x)) for x in part.centre), rpy="0 0 0")
    ET.SubElement(element, "mass", value=repr(part.mass))
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    values = part.inertia[np.triu_indices(3)]
    ET.SubElement(element, "inertia", {name: repr(float(value)) for name, value in zip(names, values, strict=True)})
    return element


def _child(element: ET.Element, tag: str) -> ET.Element:
    found = element.find(tag)
    return ET.SubElement(element, tag) if found is None else found
