"""The files of an identified robot: URDF, MJCF, YAML, and the side file that sweepid needs to read it again.

**URDF** is the robot's own with the identified inertial parameters. No motion can separate the parameters of links that
are fixed to each other: only their total is identified. It is distributed to those that have an ``<inertial>``, as near
to the original as possible (`physical_consistency`). So every link stays physical, and the total is the same however a
reader treats fixed joints. The base and what is fixed to it are unchanged. The motor inertia, for which URDF has no
element, is in the side file. MuJoCo would compute the mass of links without ``<inertial>`` from their shapes; an
element ``<mujoco>``, ignored by other programs, disables that.

**MJCF** has one body per moving link, armature = motor inertia, damping and frictionloss = identified viscous and dry
friction, an actuator with the drive's offset, and counterbalances as tendons. Collision shapes that are boxes,
cylinders or spheres become visual geoms without collision, because shapes of neighbours may overlap. Meshes are
omitted.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import yaml

from service import BadInput, writing
from service.formats.export.model import IdentifiedModel, LinkBody, body_of
from service.identification.model.physical_consistency import SearchEnded, nearest_physical
from service.model import INERTIAL_NAMES, Array, joint_end, transform_inertial
from service.model.results.combination import FrictionPoint
from service.model.urdf import read_inertial, read_origin

Yaml = str | float | None | Sequence["Yaml"] | Mapping[str, "Yaml"]


@dataclass(frozen=True)
class _PlacedLink:
    """A ``<link>``, the moving link that carries it (itself, if it moves; None: the base), and its pose in that."""

    element: ET.Element
    carrier: str | None
    rotation: Array  # (3, 3)
    translation: Array  # (3,)

    @property
    def name(self) -> str:
        return self.element.get("name", "")


def model_files(model: IdentifiedModel) -> dict[str, str]:
    """Name and text of each file."""
    return {
        "model.urdf": as_urdf(model),
        "model.xml": as_mjcf(model),
        **({"model_elastic.xml": as_mjcf(model, elastic=True)} if model.springs else {}),
        "model.yaml": as_yaml(model),
        "robot.yaml": as_side_file(model),
    }


def write_model(folder: Path, model: IdentifiedModel) -> None:
    """Write the files into a folder that is empty or new; BadInput if it is not empty or cannot be written."""
    files = model_files(model)
    with writing(folder):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise BadInput(str(folder), "exists already and is not an empty folder")
        folder.mkdir(parents=True, exist_ok=True)
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")


def as_yaml(model: IdentifiedModel) -> str:
    """All parameters, SI, for programs that read neither URDF nor MJCF. Inertias of motors are on the joint side."""
    drives = model.motor_inertias, model.friction, model.dry_friction, model.offset
    joints = {
        joint.name: {
            "kind": joint.kind,
            "link": joint.link,
            "parent_to_joint": {"translation": joint.translation.tolist(), "rotation": joint.rotation.tolist()},
            "axis": joint.axis.tolist(),
            "motor_inertia": float(motor),
            "viscous_friction": friction,
            "dry_friction": dry,
            "offset": offset,
            "friction_curve": _curve(model.curves.get(joint.name, ())),
            "gear": _gear(model.springs.get(joint.name)),
            "counterbalance": own.model_dump(mode="json") if (own := model.counterbalances.get(joint.name)) else None,
            "effects": {
                effect.effect: {name: value.model_dump() for name, value in effect.parameters.items()}
                for effect in model.effects
                if effect.axis == joint.name
            },
        }
        for joint, motor, friction, dry, offset in zip(model.robot.chain.joints, *drives, strict=True)
    }
    return _dump(
        {
            "robot": model.robot.name,
            "gravity": model.robot.gravity.tolist(),
            "joints": joints,
            "links": {
                body.link: {
                    "mass": body.mass,
                    "centre_of_mass": body.centre.tolist(),
                    "inertia_about_centre": body.inertia.tolist(),
                    "at_frame": dict(zip(INERTIAL_NAMES, body.parameters.tolist(), strict=True)),
                }
                for body in model.bodies
            },
            "base_parameters": [
                {"name": one.name, "symbolic": one.symbolic, "value": one.value, "std": one.std}
                for one in model.base_parameters
            ],
            "symbols": {
                name: {"value": one.value, "unit": one.unit, "meaning": one.meaning}
                for name, one in model.symbols.items()
            },
            "deviation_in_std": model.deviation_in_std,
            "workspace": {
                one.joint: {"inertia": asdict(one.inertia), "gravity": asdict(one.gravity)} for one in model.worth
            },
        }
    )


def _curve(points: Sequence[FrictionPoint]) -> Yaml:
    return [{"velocity": one.velocity, "effort": one.effort, "std": one.std} for one in points]


def _gear(spring: tuple[float, float] | None) -> Yaml:
    return None if spring is None else {"stiffness": spring[0], "damping": spring[1]}


def as_side_file(model: IdentifiedModel) -> str:
    """The side file of the robot with the identified motors and frictions, next to `model.urdf`."""
    axes = [
        axis.model_copy(
            update={
                "motor_inertia": float(motor) / axis.gear_ratio**2 if motor > 0 else axis.motor_inertia,
                "viscous_friction": axis.viscous_friction if friction is None else friction,
                "counterbalance": model.counterbalances.get(axis.joint),
            }
        )
        for axis, motor, friction in zip(model.robot.axes, model.motor_inertias, model.friction, strict=True)
    ]
    description = model.robot.description.model_copy(update={"urdf": "model.urdf", "axes": tuple(axes)})
    return _dump(description.model_dump(mode="json"))


def _dump(content: Yaml) -> str:
    return yaml.safe_dump(content, sort_keys=False, allow_unicode=True)


def as_urdf(model: IdentifiedModel) -> str:
    """The text of the file; shapes and comments of the original are kept."""
    root = ET.fromstring(model.robot.urdf_text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
    links = _placed_links(root)
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


def _shares(whole: LinkBody, group: list[_PlacedLink]) -> list[tuple[_PlacedLink, LinkBody]]:
    """The links with mass in a rigid group, each with its part of the total; the moving link if none has mass."""
    nominal = {link.name: read_inertial(link.element, "urdf") for link in group}
    heavy = [link for link in group if nominal[link.name][0] > 0]
    if len(heavy) < 2:
        alone = heavy[0] if heavy else group[0]
        return [(alone, body_of(alone.name, _seen_from(alone, whole.parameters)))]
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
    return [(link, body_of(link.name, share)) for link, share in zip(heavy, shares, strict=True)]


def _transform(link: _PlacedLink) -> Array:
    """(10, 10): parameters in the link's own frame to those in the frame of its moving link."""
    return np.stack([transform_inertial(unit, link.rotation, link.translation) for unit in np.eye(10)], -1)


def _seen_from(link: _PlacedLink, parameters: Array) -> Array:
    return transform_inertial(parameters, link.rotation.T, -link.rotation.T @ link.translation)


def _inertial(part: LinkBody) -> ET.Element:
    element = ET.Element("inertial")
    ET.SubElement(element, "origin", xyz=_text(part.centre), rpy="0 0 0")
    ET.SubElement(element, "mass", value=repr(part.mass))
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    values = part.inertia[np.triu_indices(3)]
    ET.SubElement(element, "inertia", {name: repr(float(value)) for name, value in zip(names, values, strict=True)})
    return element


def _child(element: ET.Element, tag: str) -> ET.Element:
    found = element.find(tag)
    return ET.SubElement(element, tag) if found is None else found


def as_mjcf(model: IdentifiedModel, *, elastic: bool = False) -> str:
    """The text of the file. Angles in radian; joint ranges as in the URDF, none for a continuous joint.

    Each joint has an actuator whose control is the effort that the drive indicates, its offset included. `elastic`: a
    known gear is a second joint on the same axis: the first is the motor, with its inertia, the sum of both the load.
    """
    root = ET.Element("mujoco", model=model.robot.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    ET.SubElement(root, "option", gravity=_text(model.robot.gravity))
    carrier = ET.SubElement(root, "worldbody")
    links = _placed_links(ET.fromstring(model.robot.urdf_text))
    _add_shapes(carrier, (link for link in links if link.carrier is None))
    frictions = zip(model.friction, model.dry_friction, strict=True)
    parts = zip(model.robot.chain.joints, model.bodies, model.motor_inertias, frictions, strict=True)
    for joint, body, motor, (friction, dry) in parts:
        before = carrier
        carrier = ET.SubElement(
            carrier, "body", name=body.link, pos=_text(joint.translation), quat=_text(quaternion(joint.rotation))
        )
        tensor = _text(body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        ET.SubElement(carrier, "inertial", pos=_text(body.centre), mass=repr(body.mass), fullinertia=tensor)
        element = ET.SubElement(carrier, "joint", name=joint.name, axis=_text(joint.axis))
        element.set("type", "slide" if joint.kind == "prismatic" else "hinge")
        element.set("armature", repr(float(motor)))
        element.set("damping", repr(friction or 0.0))
        element.set("frictionloss", repr(dry or 0.0))
        if joint.name in model.hoses:
            for name, value in zip(("stiffness", "springref"), model.hoses[joint.name], strict=True):
                element.set(name, repr(value))
        if joint.name in model.counterbalances:
            own = model.counterbalances[joint.name]
            for link, place, end in ((before, own.anchor, "anchor"), (carrier, own.attachment, "attachment")):
                ET.SubElement(link, "site", name=f"{joint.name}_{end}", pos=_text(place), size="0.01")
        if np.isfinite([joint.lower, joint.upper]).all():
            element.set("range", _text([joint.lower, joint.upper]))
        if elastic and joint.name in model.springs:
            gear = ET.SubElement(carrier, "joint", name=f"{joint.name}_gear", axis=_text(joint.axis))
            gear.set("type", element.get("type", ""))
            for name, value in zip(("stiffness", "damping"), model.springs[joint.name], strict=True):
                gear.set(name, repr(value))
        _add_shapes(carrier, (link for link in links if link.carrier == body.link))
    tendons = ET.SubElement(root, "tendon") if model.counterbalances else root
    for joint in model.counterbalances:
        factors, free, _ = model.tendon(joint)
        stiffness = _text(factors if factors[1:].any() else factors[:1])
        tendon = ET.SubElement(
            tendons, "spatial", name=f"{joint}_counterbalance", stiffness=stiffness, springlength=repr(free)
        )
        for end in ("anchor", "attachment"):
            ET.SubElement(tendon, "site", site=f"{joint}_{end}")
    drives = ET.SubElement(root, "actuator")
    for joint, offset in zip(model.robot.joints, model.offset, strict=True):
        ET.SubElement(drives, "general", name=joint, joint=joint, biastype="affine", biasprm=_text([-offset, 0.0, 0.0]))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def _add_shapes(carrier: ET.Element, links: Iterable[_PlacedLink]) -> None:
    """BadInput if the numbers of a shape cannot be read."""
    for link in links:
        here = f"urdf link {link.name} collision"
        for collision in link.element.findall("collision"):
            rotation, translation = read_origin(collision, here)
            try:
                kind, size = _geometry(collision)
            except ValueError as error:
                raise BadInput(here, f"cannot be read: {error}") from None
            if kind:
                place = _text(link.translation + link.rotation @ translation)
                turn = _text(quaternion(link.rotation @ rotation))
                look = {"pos": place, "quat": turn, "contype": "0", "conaffinity": "0"}
                ET.SubElement(carrier, "geom", {"type": kind, "size": _text(size), **look})


def _geometry(collision: ET.Element) -> tuple[str, tuple[float, ...]]:
    """Kind and (half) sizes, m; both empty for other shapes, for example a mesh."""
    box, cylinder, sphere = (collision.find(f"geometry/{kind}") for kind in ("box", "cylinder", "sphere"))
    if box is not None:
        x, y, z = (float(side) / 2 for side in box.get("size", "").split())
        return "box", (x, y, z)
    if cylinder is not None:
        return "cylinder", (float(cylinder.get("radius", "")), float(cylinder.get("length", "")) / 2)
    if sphere is not None:
        return "sphere", (float(sphere.get("radius", "")),)
    return "", ()


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


def _placed_links(root: ET.Element) -> list[_PlacedLink]:
    """All links, base to tip. The structure is valid, because the URDF's chain was read before."""
    links = {element.get("name", ""): element for element in root.findall("link")}
    children: dict[str, list[ET.Element]] = {}
    for joint in root.findall("joint"):
        children.setdefault(joint_end(joint, "parent", "urdf"), []).append(joint)
    carried = {joint_end(joint, "child", "urdf") for joint in root.findall("joint")}
    found = [_PlacedLink(links[name], None, np.eye(3), np.zeros(3)) for name in links if name not in carried]
    for placed in found:  # extended during the loop
        for joint in children.get(placed.name, []):
            child = links[joint_end(joint, "child", "urdf")]
            if joint.get("type") != "fixed":
                found.append(_PlacedLink(child, child.get("name", ""), np.eye(3), np.zeros(3)))
                continue
            rotation, translation = read_origin(joint, f"urdf joint {joint.get('name')}")
            place = placed.rotation @ rotation, placed.translation + placed.rotation @ translation
            found.append(_PlacedLink(child, placed.carrier, *place))
    return found
