"""The LoadType of OPC 40010-1 (OPC UA for Robotics, 7.23), with the node ids of the specification.

Mass in kg. CenterOfMass: X, Y, Z of the centre in the frame of the link, m; A, B, C the orientation of the principal
axes: rotations about X (roll), Y (pitch), Z (yaw) of that frame, R = Rz(C) Ry(B) Rx(A), rad. Inertia: principal moments
about the centre of mass, kg m^2. Only this type of the specification is included; its namespace is marked as a subset.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.publishing.opcua.library import Node, ua
from service.publishing.opcua.variables import Variable, add_variable, known

ROBOTICS = "http://opcfoundation.org/UA/Robotics/"
_LOAD_TYPE = 1018
_UNITS = "http://www.opcfoundation.org/UA/units/un/cefact"
Array = NDArray[np.float64]


def unit(code: str, name: str) -> object:
    """A unit by its UN/CEFACT common code, numbered as in OPC 10000-8."""
    number = int.from_bytes(code.encode(), "big")
    return ua.EUInformation(_UNITS, number, ua.LocalizedText(name), ua.LocalizedText(name))


_NUMBER = ua.ObjectIds.Double
_XYZ = tuple(Variable(name, ua.ObjectIds.BaseDataVariableType, _NUMBER) for name in "XYZ")
_ABC = tuple(Variable(name, ua.ObjectIds.BaseDataVariableType, _NUMBER) for name in "ABC")
KILOGRAM = Variable("EngineeringUnits", ua.ObjectIds.PropertyType, ua.ObjectIds.EUInformation, value=unit("KGM", "kg"))
LOAD = (
    Variable("Mass", ua.ObjectIds.AnalogUnitType, _NUMBER, children=(KILOGRAM,), robotics=True),
    Variable(
        "CenterOfMass",
        ua.ObjectIds.ThreeDFrameType,
        ua.ObjectIds.ThreeDFrame,
        children=(
            Variable(
                "CartesianCoordinates",
                ua.ObjectIds.ThreeDCartesianCoordinatesType,
                ua.ObjectIds.ThreeDCartesianCoordinates,
                children=_XYZ,
            ),
            Variable("Orientation", ua.ObjectIds.ThreeDOrientationType, ua.ObjectIds.ThreeDOrientation, children=_ABC),
        ),
        robotics=True,
        optional=True,
    ),
    Variable(
        "Inertia",
        ua.ObjectIds.ThreeDVectorType,
        ua.ObjectIds.ThreeDVector,
        children=_XYZ,
        robotics=True,
        optional=True,
    ),
)
# of the instance declarations, by path below the type
_NUMBERS: Mapping[str, int] = {
    "Mass": 6723,
    "Mass/EngineeringUnits": 6728,
    "CenterOfMass": 6013,
    "CenterOfMass/CartesianCoordinates": 16130,
    "CenterOfMass/CartesianCoordinates/X": 16134,
    "CenterOfMass/CartesianCoordinates/Y": 16135,
    "CenterOfMass/CartesianCoordinates/Z": 16136,
    "CenterOfMass/Orientation": 16132,
    "CenterOfMass/Orientation/A": 16137,
    "CenterOfMass/Orientation/B": 16138,
    "CenterOfMass/Orientation/C": 16139,
    "Inertia": 18170,
    "Inertia/X": 18171,
    "Inertia/Y": 18172,
    "Inertia/Z": 18173,
}


@dataclass(frozen=True, slots=True)
class Load:
    """`centre` (3,) m, `angles` A, B, C (3,) rad, `moments` (3,) kg m^2."""

    mass: float
    centre: tuple[float, float, float]
    angles: tuple[float, float, float]
    moments: tuple[float, float, float]


def load_of(parameters: Mapping[str, float]) -> Load | None:
    """The load of the ten parameters of a link at the origin of its frame; None without mass."""
    mass = parameters["m"]
    if not mass > 0:
        return None
    centre = np.array([parameters["mx"], parameters["my"], parameters["mz"]]) / mass
    of = parameters
    about_origin = np.array(
        [[of["Ixx"], of["Ixy"], of["Ixz"]], [of["Ixy"], of["Iyy"], of["Iyz"]], [of["Ixz"], of["Iyz"], of["Izz"]]]
    )
    moments, axes = np.linalg.eigh(about_origin - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre)))
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    x, y, z = centre.tolist()
    least, middle, most = moments.tolist()
    return Load(mass, (x, y, z), angles_of(axes), (least, middle, most))


def angles_of(rotation: Array) -> tuple[float, float, float]:
    """A, B, C of a rotation (3, 3) = Rz(C) Ry(B) Rx(A); C is 0 if B is +-90 degrees."""
    b = math.asin(max(-1.0, min(1.0, -float(rotation[2, 0]))))
    if abs(rotation[2, 0]) > 1 - 1e-12:
        return math.atan2(-float(rotation[1, 2]), float(rotation[1, 1])), b, 0.0
    a = math.atan2(float(rotation[2, 1]), float(rotation[2, 2]))
    return a, b, math.atan2(float(rotation[1, 0]), float(rotation[0, 0]))


async def add_load_type(server: Node) -> Node:
    """The type, in the namespace of the specification."""
    space = await server.register_namespace(ROBOTICS)
    base = server.get_node(ua.ObjectIds.BaseObjectType)
    found = await base.add_object_type(ua.NodeId(_LOAD_TYPE, space), ua.QualifiedName("LoadType", space))
    for variable in LOAD:
        await add_variable(found, variable, lambda path: ua.NodeId(_NUMBERS[path], space), space, declared=True)
    await _told_to_be_a_part(server, space)
    return found


async def add_load(parent: Node, name: str, load_type: Node, space: int) -> dict[str, Node]:
    """A load without values yet; its variables by path."""
    robotics = load_type.nodeid.NamespaceIndex
    stem = f"{parent.nodeid.Identifier}.{name}"
    node = await parent.add_object(ua.NodeId(stem, space), ua.QualifiedName(name, space))
    await node.delete_reference(ua.ObjectIds.BaseObjectType, ua.ObjectIds.HasTypeDefinition)
    await node.add_reference(load_type, ua.ObjectIds.HasTypeDefinition, bidirectional=False)
    variables: dict[str, Node] = {}
    for variable in LOAD:
        variables |= await add_variable(
            node, variable, lambda path: ua.NodeId(f"{stem}.{path.replace('/', '.')}", space), robotics
        )
    return variables


async def show_load(variables: Mapping[str, Node], load: Load) -> None:
    """Write the values, including the parts of structures."""
    place, turned = ua.ThreeDCartesianCoordinates(*load.centre), ua.ThreeDOrientation(*load.angles)
    values: dict[str, object] = {
        "Mass": load.mass,
        "CenterOfMass": ua.ThreeDFrame(place, turned),
        "CenterOfMass/CartesianCoordinates": place,
        "CenterOfMass/Orientation": turned,
        "Inertia": ua.ThreeDVector(*load.moments),
    }
    values |= {f"CenterOfMass/CartesianCoordinates/{name}": v for name, v in zip("XYZ", load.centre, strict=True)}
    values |= {f"CenterOfMass/Orientation/{name}": v for name, v in zip("ABC", load.angles, strict=True)}
    values |= {f"Inertia/{name}": v for name, v in zip("XYZ", load.moments, strict=True)}
    for path, value in values.items():
        await variables[path].write_value(known(value))


async def _told_to_be_a_part(server: Node, space: int) -> None:
    """NamespaceMetadata (OPC 10000-5, 6.3.13): clients must not expect the complete specification."""
    spaces = server.get_node(ua.ObjectIds.Server_Namespaces)
    metadata = await spaces.add_object(
        ua.NodeId(15011, space), ua.QualifiedName(ROBOTICS, space), ua.ObjectIds.NamespaceMetadataType, False
    )
    for child in await metadata.get_children():
        match (await child.read_browse_name()).Name:
            case "NamespaceUri":
                await child.write_value(ROBOTICS)
            case "IsNamespaceSubset":
                await child.write_value(True)
            case _:
                pass
