"""The OPC UA server of the publisher process, and its nodes: machine, campaign, latest estimate with its axes, loads.

A load is of the LoadType of OPC 40010-1 (OPC UA for Robotics, 7.23), with the node ids of the specification. Mass in
kg. CenterOfMass: X, Y, Z of the centre in the frame of the link, m; A, B, C the orientation of the principal axes:
rotations about X (roll), Y (pitch), Z (yaw) of that frame, R = Rz(C) Ry(B) Rx(A), rad. Inertia: principal moments
about the centre of mass, kg m^2. Only this type of the specification is included; its namespace is marked as a subset.
"""

import asyncio
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar, cast

import asyncua
import numpy as np
from asyncua.crypto.permission_rules import SimpleRoleRuleset, User, UserRole
from asyncua.server.user_managers import UserManager
from asyncua.ua.uaerrors import UaError
from asyncua.ua.uatypes import VariantType
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from service.model import INERTIAL_NAMES, Array
from service.model.urdf import inertia_at_centre
from service.planning.campaigns.stored_results import AxisEstimateQuality
from service.process.settings import OpcUa
from service.publishing.state import CampaignProgress, FromPublisher, LatestEstimate, MachineState, PublishedState

# its own code passes plain numbers and texts where its annotations name other types
ua: Any = cast(Any, asyncua).ua
Node: TypeAlias = Any
Value = str | bool | int | float | datetime | Sequence[str] | Sequence[int] | None
Of = TypeVar("Of")
Shown = Mapping[str, tuple[VariantType, Callable[[Of], Value]]]
"""Variables of one level by name: their kind, and their value of what is shown; None: no value yet."""

_MACHINE: Shown[MachineState] = {
    "Name": (VariantType.String, lambda of: of.name),
    "Connected": (VariantType.Boolean, lambda of: of.connected),
    "MayMove": (VariantType.Boolean, lambda of: of.may_move),
    "State": (VariantType.String, lambda of: of.state),
    "Stopped": (VariantType.Boolean, lambda of: of.stopped),
    "StopsHeld": (VariantType.UInt32, lambda of: len(of.stops)),
    "Reason": (VariantType.String, lambda of: of.reason),
}
_AXIS: Shown[AxisEstimateQuality] = {
    "Sweeps": (VariantType.UInt32, lambda of: of.sweeps),
    "GapRatio": (VariantType.Double, lambda of: of.gap),
    "LeftRatio": (VariantType.Double, lambda of: of.left),
    "StdRatio": (VariantType.Double, lambda of: of.std),
}


def _unknown() -> object:
    """Status: no value yet."""
    return ua.DataValue(StatusCode=ua.StatusCode(ua.StatusCodes.BadWaitingForInitialData))


def _known(value: object, kind: VariantType | None = None) -> object:
    """Value with status Good and the present time."""
    now = datetime.now(UTC)
    return ua.DataValue(ua.Variant(value, kind), SourceTimestamp=now, ServerTimestamp=now)


class NodeGroup(Generic[Of]):
    """An object with variables of one level."""

    def __init__(self, node: Node, variables: Mapping[str, Node], shown: Shown[Of]) -> None:
        self.node, self._variables, self._shown = node, variables, shown
        self._values: dict[str, Value] = {}

    async def show(self, of: Of) -> None:
        """Write the values that have changed."""
        for name, (kind, value_of) in self._shown.items():
            value = value_of(of)
            if name in self._values and self._values[name] == value:
                continue
            self._values[name] = value
            content = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value
            await self._variables[name].write_value(_unknown() if value is None else _known(content, kind))


async def _group(parent: Node, name: str, shown: Shown[Of], space: int, stem: str = "") -> NodeGroup[Of]:
    stem = f"{stem}.{name}" if stem else name
    node = await parent.add_object(ua.NodeId(stem, space), ua.QualifiedName(name, space))
    variables: dict[str, Node] = {}
    for each, (kind, _) in shown.items():
        number = ua.NodeId(f"{stem}.{each}", space)
        data = ua.NodeId(int(kind.value))
        variable = await node.add_variable(number, ua.QualifiedName(each, space), ua.Variant(None), datatype=data)
        if each in ("CurrentSweeps", "CurrentAxes"):
            await variable.write_value_rank(ua.ValueRank.OneDimension)
        await variable.write_value(_unknown())
        variables[each] = variable
    return NodeGroup(node, variables, shown)


class Nodes:
    """All nodes. `Axes` and `Loads` are created with the first estimate, and again if the robot has others."""

    def __init__(
        self,
        server: Node,
        space: int,
        load_type: Node,
        groups: tuple[NodeGroup[MachineState], NodeGroup[CampaignProgress], NodeGroup[LatestEstimate]],
    ) -> None:
        self._server, self._space, self._load_type = server, space, load_type
        self._machine, self._campaign, self._estimate = groups
        self._axes: dict[str, NodeGroup[AxisEstimateQuality]] = {}
        self._loads: dict[str, dict[str, Node]] = {}
        self._shown: LatestEstimate | None = None

    @classmethod
    async def added(cls, server: Node) -> "Nodes":
        # the revision is written last: a client that sees the new one finds its values
        estimate_values: Shown[LatestEstimate] = {
            "Robot": (VariantType.String, lambda of: of.robot),
            "Campaign": (VariantType.UInt32, lambda of: of.campaign),
            "Made": (VariantType.DateTime, lambda of: of.made),
            "ConditionNumber": (VariantType.Double, lambda of: of.condition),
            "Revision": (VariantType.UInt32, lambda of: of.revision),
        }
        campaign_values: Shown[CampaignProgress] = {
            "Number": (VariantType.UInt32, lambda of: of.id),
            "State": (VariantType.String, lambda of: of.state.value),
            "Cause": (VariantType.String, lambda of: of.cause),
            "SweepsDone": (VariantType.UInt32, lambda of: of.done),
            "SweepsTotal": (VariantType.UInt32, lambda of: of.total),
            "CurrentSweeps": (VariantType.UInt32, lambda of: of.sweeps),
            "CurrentAxes": (VariantType.String, lambda of: of.axes),
        }
        space = await server.register_namespace("urn:sweepid:machine")
        load_type = await _add_load_type(server)
        objects = server.nodes.objects
        machine = await _group(objects, "Machine", _MACHINE, space)
        campaign = await _group(objects, "Campaign", campaign_values, space)
        estimate = await _group(objects, "Estimate", estimate_values, space)
        for parent, name, number in ((estimate.node, "Axes", "Estimate.Axes"), (objects, "Loads", "Loads")):
            await parent.add_folder(ua.NodeId(number, space), ua.QualifiedName(name, space))
        return cls(server, space, load_type, (machine, campaign, estimate))

    async def show(self, state: PublishedState) -> None:
        await self._machine.show(state.machine)
        if state.campaign is not None:
            await self._campaign.show(state.campaign)
        if state.estimate is not None and state.estimate != self._shown:
            await self._show_estimate(state.estimate)
            self._shown = state.estimate

    async def _show_estimate(self, estimate: LatestEstimate) -> None:
        if list(self._axes) != list(estimate.axes):
            await self._server.delete_nodes([group.node for group in self._axes.values()], recursive=True)
            folder = self._server.get_node(ua.NodeId("Estimate.Axes", self._space))
            self._axes = {
                joint: await _group(folder, joint, _AXIS, self._space, "Estimate.Axes") for joint in estimate.axes
            }
        for joint, axis in estimate.axes.items():
            await self._axes[joint].show(axis)
        loads = {link: load_of(body.parameters) for link, body in estimate.links.items()}
        bodies = {link: load for link, load in loads.items() if load is not None}
        if list(self._loads) != list(bodies):
            folder = self._server.get_node(ua.NodeId("Loads", self._space))
            await self._server.delete_nodes(await folder.get_children(), recursive=True)
            self._loads = {link: await _add_load(folder, link, self._load_type, self._space) for link in bodies}
        for link, load in bodies.items():
            await _show_load(self._loads[link], load)
        await self._estimate.show(estimate)


@dataclass(frozen=True, slots=True)
class Declared:
    """A variable of the LoadType. `number`: node id of its declaration, `kind`: its variable type, `data`: its data
    type. `robotics`: its name is in the namespace of the Robotics specification, else of OPC UA itself.
    """

    name: str
    number: int
    kind: int
    data: int
    value: object = None
    children: "tuple[Declared, ...]" = ()
    robotics: bool = False
    optional: bool = False


def _numbers(first: int, names: str) -> tuple[Declared, ...]:
    """Parts of a structure, numbered on from `first`."""
    kind, data = ua.ObjectIds.BaseDataVariableType, ua.ObjectIds.Double
    return tuple(Declared(name, number, kind, data) for number, name in enumerate(names, first))


def _unit(code: str, name: str) -> object:
    """A unit by its UN/CEFACT common code, numbered as in OPC 10000-8."""
    number, shown = int.from_bytes(code.encode(), "big"), ua.LocalizedText(name)
    return ua.EUInformation("http://www.opcfoundation.org/UA/units/un/cefact", number, shown, shown)


def _declared() -> tuple[Declared, ...]:
    ids = ua.ObjectIds
    unit = Declared("EngineeringUnits", 6728, ids.PropertyType, ids.EUInformation, value=_unit("KGM", "kg"))
    place = Declared(
        "CartesianCoordinates",
        16130,
        ids.ThreeDCartesianCoordinatesType,
        ids.ThreeDCartesianCoordinates,
        children=_numbers(16134, "XYZ"),
    )
    turned = Declared(
        "Orientation", 16132, ids.ThreeDOrientationType, ids.ThreeDOrientation, children=_numbers(16137, "ABC")
    )
    frame = Declared("CenterOfMass", 6013, ids.ThreeDFrameType, ids.ThreeDFrame, None, (place, turned), True, True)
    inertia = _numbers(18171, "XYZ")
    return (
        Declared("Mass", 6723, ids.AnalogUnitType, ids.Double, children=(unit,), robotics=True),
        frame,
        Declared("Inertia", 18170, ids.ThreeDVectorType, ids.ThreeDVector, None, inertia, True, True),
    )


_LOAD_TYPE = _declared()


async def _add_declared(
    parent: Node, variable: Declared, robotics: int, instance: tuple[str, int] | None = None, path: str = ""
) -> dict[str, Node]:
    """A variable with its parts, by path. `instance`: stem of the node ids and their namespace; None: part of the type,
    so with modelling rules and without values.
    """
    path = f"{path}/{variable.name}" if path else variable.name
    name = ua.QualifiedName(variable.name, robotics if variable.robotics else 0)
    add = parent.add_property if variable.kind == ua.ObjectIds.PropertyType else parent.add_variable
    number = (variable.number, robotics) if instance is None else (_dotted(instance[0], path), instance[1])
    node = await add(ua.NodeId(*number), name, ua.Variant(variable.value), datatype=ua.NodeId(variable.data))
    if variable.kind not in (ua.ObjectIds.PropertyType, ua.ObjectIds.BaseDataVariableType):
        await _retype(node, ua.ObjectIds.BaseDataVariableType, ua.NodeId(variable.kind))
    if instance is None:
        await node.set_modelling_rule(not variable.optional)
    elif variable.value is None:
        await node.write_value(_unknown())
    found = {path: node}
    for child in variable.children:
        found |= await _add_declared(node, child, robotics, instance, path)
    return found


def _dotted(stem: str, path: str) -> str:
    return f"{stem}.{path.replace('/', '.')}"


async def _retype(node: Node, before: int, kind: object) -> None:
    await node.delete_reference(before, ua.ObjectIds.HasTypeDefinition)
    await node.add_reference(kind, ua.ObjectIds.HasTypeDefinition, bidirectional=False)


async def _add_load_type(server: Node) -> Node:
    """The type, in the namespace of the specification.

    NamespaceMetadata (OPC 10000-5, 6.3.13) say that it is a subset: clients must not expect all of it.
    """
    robotics = "http://opcfoundation.org/UA/Robotics/"
    space = await server.register_namespace(robotics)
    base = server.get_node(ua.ObjectIds.BaseObjectType)
    load_type = await base.add_object_type(ua.NodeId(1018, space), ua.QualifiedName("LoadType", space))
    for variable in _LOAD_TYPE:
        await _add_declared(load_type, variable, space)
    metadata = await server.get_node(ua.ObjectIds.Server_Namespaces).add_object(
        ua.NodeId(15011, space), ua.QualifiedName(robotics, space), ua.ObjectIds.NamespaceMetadataType, False
    )
    said = {"NamespaceUri": robotics, "IsNamespaceSubset": True}
    for child in await metadata.get_children():
        name = (await child.read_browse_name()).Name
        if name in said:
            await child.write_value(said[name])
    return load_type


async def _add_load(parent: Node, name: str, load_type: Node, space: int) -> dict[str, Node]:
    """A load without values yet; its variables by path."""
    stem = f"{parent.nodeid.Identifier}.{name}"
    node = await parent.add_object(ua.NodeId(stem, space), ua.QualifiedName(name, space))
    await _retype(node, ua.ObjectIds.BaseObjectType, load_type.nodeid)
    variables: dict[str, Node] = {}
    for variable in _LOAD_TYPE:
        variables |= await _add_declared(node, variable, load_type.nodeid.NamespaceIndex, (stem, space))
    return variables


@dataclass(frozen=True, slots=True)
class PrincipalLoad:
    """`centre` (3,) m, `angles` A, B, C (3,) rad, `moments` (3,) kg m^2."""

    mass: float
    centre: tuple[float, float, float]
    angles: tuple[float, float, float]
    moments: tuple[float, float, float]


def load_of(parameters: Mapping[str, float]) -> PrincipalLoad | None:
    """The load of the ten parameters of a link at the origin of its frame; None without mass."""
    mass = parameters["m"]
    if not mass > 0:
        return None
    ten = np.array([parameters[name] for name in INERTIAL_NAMES])
    centre = ten[1:4] / mass
    moments, axes = np.linalg.eigh(inertia_at_centre(ten))
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    x, y, z = centre.tolist()
    least, middle, most = moments.tolist()
    return PrincipalLoad(mass, (x, y, z), _angles_of(axes), (least, middle, most))


def _angles_of(rotation: Array) -> tuple[float, float, float]:
    """A, B, C of a rotation (3, 3) = Rz(C) Ry(B) Rx(A); C is 0 if B is +-90 degrees."""
    b = math.asin(max(-1.0, min(1.0, -float(rotation[2, 0]))))
    if abs(rotation[2, 0]) > 1 - 1e-12:
        return math.atan2(-float(rotation[1, 2]), float(rotation[1, 1])), b, 0.0
    a = math.atan2(float(rotation[2, 1]), float(rotation[2, 2]))
    return a, b, math.atan2(float(rotation[1, 0]), float(rotation[0, 0]))


async def _show_load(variables: Mapping[str, Node], load: PrincipalLoad) -> None:
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
        await variables[path].write_value(_known(value))


_log = logging.getLogger(__name__)


class OpcUaServer:
    """Runs until `run` is cancelled; a state set while it does not listen is shown later."""

    def __init__(self, settings: OpcUa, machine: str, report: Callable[[FromPublisher], None]) -> None:
        self._settings, self._machine, self._report = settings, machine, report
        self._state: PublishedState | None = None
        self._news = asyncio.Event()

    def state(self, state: PublishedState) -> None:
        """Set the state; it replaces one that is not shown yet."""
        self._state = state
        self._news.set()

    async def run(self) -> None:
        """Run until cancelled; tries again if it cannot listen or a file is invalid."""
        while True:
            try:
                await self._serve()
            except (OSError, ValueError, UaError) as error:
                self._report(FromPublisher(part="opcua", trouble=f"{type(error).__name__}: {error}"))
            await asyncio.sleep(2.0)

    async def _serve(self) -> None:
        settings = self._settings
        trusted = None if settings.trusted is None else trusted_in(settings.trusted)
        server: Any = cast(Any, asyncua).Server(user_manager=Clients(trusted))
        uri = "urn:sweepid:opcua"
        server.name = f"sweepid {self._machine}"
        server.product_uri, server.manufacturer_name = uri, "sweepid"
        server.limits.max_message_size, server.limits.max_chunk_count = 2**20, 64  # bytes and parts of a request
        await server.init()
        policies = ua.SecurityPolicyType
        # None permits requests for endpoints; `Requests` refuses all others of a session that `Clients` did not accept
        allowed = [policies.NoSecurity]
        if trusted is not None:
            allowed += [
                policies.Basic256Sha256_SignAndEncrypt,
                policies.Aes128Sha256RsaOaep_SignAndEncrypt,
                policies.Aes256Sha256RsaPss_SignAndEncrypt,
            ]
        server.set_security_policy(allowed, Requests())
        server.set_identity_tokens([ua.AnonymousIdentityToken])
        if settings.certificate is not None and settings.key is not None:
            certificate = certificate_in(settings.certificate)
            uri = _uri_of(certificate)
            await server.load_certificate(certificate.public_bytes(Encoding.DER), "der")
            await server.load_private_key(settings.key, None, "pem")
        await server.set_application_uri(uri)
        host = f"[{settings.host}]" if ":" in settings.host else settings.host
        server.set_endpoint(f"opc.tcp://{host}:{settings.port}/sweepid")
        server.iserver.max_session_timeout_ms = 5 * 60_000  # of an inactive session
        nodes = await Nodes.added(server)
        await server.start()
        try:
            if trusted is not None:  # no client can use it: not advertised
                none = ua.MessageSecurityMode.None_
                offered = server.iserver.endpoints
                offered[:] = [endpoint for endpoint in offered if endpoint.SecurityMode != none]
            self._report(FromPublisher(part="opcua", port=_port(server)))
            while True:
                self._news.clear()
                if self._state is not None:
                    await nodes.show(self._state)
                await self._news.wait()
        finally:
            with suppress(asyncio.CancelledError):
                await server.stop()


def _uri_of(certificate: x509.Certificate) -> str:
    """The application URI in a certificate; ValueError without one."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        names = None
    uris = [] if names is None else names.get_values_for_type(x509.UniformResourceIdentifier)
    if not uris:
        raise ValueError("the server's certificate has no application URI (subjectAltName URI)")
    return str(uris[0])


def _port(server: Node) -> int:
    if server.bserver is None:
        raise OSError("does not listen")
    return int(server.bserver.port)


_ALLOWED = frozenset(
    ua.NodeId(getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary"))
    for name in (
        "CreateSession", "ActivateSession", "CloseSession", "CloseSecureChannel", "FindServers", "GetEndpoints", "Read",
        "Browse", "BrowseNext", "TranslateBrowsePathsToNodeIds", "CreateSubscription", "ModifySubscription",
        "DeleteSubscriptions", "SetPublishingMode", "CreateMonitoredItems", "ModifyMonitoredItems",
        "DeleteMonitoredItems", "SetMonitoringMode", "Publish", "Republish",
    )
)  # fmt: skip


class Requests(SimpleRoleRuleset):
    """Permitted requests: all others are refused, and all requests of a session that is not activated."""

    def check_validity(self, user: User, action_type_id: object, body: object) -> bool:
        return user.role is UserRole.User and action_type_id in _ALLOWED


class Clients(UserManager):
    """Identifies a client by the certificate of its secure channel; without a list, all clients on this computer."""

    def __init__(self, trusted: Mapping[bytes, x509.Certificate] | None) -> None:
        self._trusted = trusted

    def get_user(
        self, iserver: object, username: str | None = None, password: str | None = None, certificate: Any = None
    ) -> User | None:
        """None rejects the session."""
        if self._trusted is None:
            return User(role=UserRole.User)
        known = self._trusted.get(bytes(certificate)) if certificate else None
        now = datetime.now(UTC)
        if known is None or not known.not_valid_before_utc <= now <= known.not_valid_after_utc:
            return None
        return User(role=UserRole.User, name=known.subject.rfc4514_string())


def trusted_in(folder: Path) -> dict[bytes, x509.Certificate]:
    """The certificates of a folder, by their DER form. OSError if it cannot be read; invalid files are reported."""
    found: dict[bytes, x509.Certificate] = {}
    for path in sorted(folder.iterdir()):
        try:
            certificate = certificate_in(path)
        except ValueError as error:
            _log.error("%s is no certificate and trusts nobody: %s", path, error)
            continue
        found[certificate.public_bytes(Encoding.DER)] = certificate
    return found


def certificate_in(path: Path) -> x509.Certificate:
    """PEM or DER. OSError, ValueError."""
    content = path.read_bytes()
    if b"-----BEGIN" in content:
        return x509.load_pem_x509_certificate(content)
    return x509.load_der_x509_certificate(content)
