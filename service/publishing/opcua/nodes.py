"""The machine as OPC UA nodes: machine, campaign, latest estimate with its axes, and the loads."""

from collections.abc import Mapping, Sequence
from datetime import datetime

from asyncua.ua.uatypes import VariantType as Kind

from service.publishing.opcua.library import Node, ua
from service.publishing.opcua.load_type import add_load, add_load_type, load_of, show_load
from service.publishing.opcua.variables import known, unknown
from service.publishing.state import AxisQuality, CampaignProgress, LatestEstimate, MachineState, State

NAMESPACE = "urn:sweepid:machine"
Value = str | bool | int | float | datetime | Sequence[str] | Sequence[int] | None

MACHINE: Mapping[str, Kind] = {
    "Name": Kind.String,
    "Connected": Kind.Boolean,
    "MayMove": Kind.Boolean,
    "State": Kind.String,
    "Stopped": Kind.Boolean,
    "StopsHeld": Kind.UInt32,
    "Reason": Kind.String,
}
CAMPAIGN: Mapping[str, Kind] = {
    "Number": Kind.UInt32,
    "State": Kind.String,
    "Cause": Kind.String,
    "SweepsDone": Kind.UInt32,
    "SweepsTotal": Kind.UInt32,
    "CurrentSweeps": Kind.UInt32,
    "CurrentAxes": Kind.String,
}
ESTIMATE: Mapping[str, Kind] = {
    "Robot": Kind.String,
    "Campaign": Kind.UInt32,
    "Revision": Kind.UInt32,
    "Made": Kind.DateTime,
    "ConditionNumber": Kind.Double,
}
AXIS: Mapping[str, Kind] = {
    "Sweeps": Kind.UInt32,
    "GapRatio": Kind.Double,
    "LeftRatio": Kind.Double,
    "StdRatio": Kind.Double,
}
_LISTS = ("CurrentSweeps", "CurrentAxes")


class Group:
    """An object with variables of one level."""

    def __init__(self, node: Node, variables: Mapping[str, Node], kinds: Mapping[str, Kind]) -> None:
        self.node, self._variables, self._kinds = node, variables, kinds
        self._shown: dict[str, Value] = {}

    @classmethod
    async def added(cls, parent: Node, name: str, kinds: Mapping[str, Kind], space: int, stem: str = "") -> "Group":
        stem = f"{stem}.{name}" if stem else name
        node = await parent.add_object(ua.NodeId(stem, space), ua.QualifiedName(name, space))
        variables: dict[str, Node] = {}
        for each, kind in kinds.items():
            number = ua.NodeId(f"{stem}.{each}", space)
            data = ua.NodeId(int(kind.value))
            variable = await node.add_variable(number, ua.QualifiedName(each, space), ua.Variant(None), datatype=data)
            if each in _LISTS:
                await variable.write_value_rank(ua.ValueRank.OneDimension)
            await variable.write_value(unknown())
            variables[each] = variable
        return cls(node, variables, kinds)

    async def show(self, values: Mapping[str, Value]) -> None:
        """Write changed values; None means no value yet."""
        for name, value in values.items():
            if name in self._shown and self._shown[name] == value:
                continue
            self._shown[name] = value
            if value is None:
                written = unknown()
            else:
                content = list(value) if isinstance(value, Sequence) and not isinstance(value, str) else value
                written = known(content, self._kinds[name])
            await self._variables[name].write_value(written)


class Nodes:
    """All nodes. `Axes` and `Loads` are created with the first estimate, and again if the robot has others."""

    def __init__(self, server: Node, space: int, load_type: Node, groups: Sequence[Group]) -> None:
        self._server, self._space, self._load_type = server, space, load_type
        self._machine, self._campaign, self._estimate = groups
        self._axes: dict[str, Group] = {}
        self._loads: dict[str, dict[str, Node]] = {}
        self._shown: LatestEstimate | None = None

    @classmethod
    async def added(cls, server: Node) -> "Nodes":
        space = await server.register_namespace(NAMESPACE)
        load_type = await add_load_type(server)
        objects = server.nodes.objects
        groups = [
            await Group.added(objects, name, kinds, space)
            for name, kinds in (("Machine", MACHINE), ("Campaign", CAMPAIGN), ("Estimate", ESTIMATE))
        ]
        for parent, name, number in ((groups[2].node, "Axes", "Estimate.Axes"), (objects, "Loads", "Loads")):
            await parent.add_folder(ua.NodeId(number, space), ua.QualifiedName(name, space))
        return cls(server, space, load_type, groups)

    async def show(self, state: State) -> None:
        await self._machine.show(_machine(state.machine))
        if state.campaign is not None:
            await self._campaign.show(_campaign(state.campaign))
        if state.estimate is not None and state.estimate != self._shown:
            await self._show_estimate(state.estimate)
            self._shown = state.estimate

    async def _show_estimate(self, estimate: LatestEstimate) -> None:
        if list(self._axes) != list(estimate.axes):
            await self._server.delete_nodes([group.node for group in self._axes.values()], recursive=True)
            folder = self._server.get_node(ua.NodeId("Estimate.Axes", self._space))
            self._axes = {
                joint: await Group.added(folder, joint, AXIS, self._space, "Estimate.Axes") for joint in estimate.axes
            }
        for joint, axis in estimate.axes.items():
            await self._axes[joint].show(_axis(axis))
        loads = {link: load_of(body.parameters) for link, body in estimate.links.items()}
        bodies = {link: load for link, load in loads.items() if load is not None}
        if list(self._loads) != list(bodies):
            folder = self._server.get_node(ua.NodeId("Loads", self._space))
            await self._server.delete_nodes(await folder.get_children(), recursive=True)
            self._loads = {link: await add_load(folder, link, self._load_type, self._space) for link in bodies}
        for link, load in bodies.items():
            await show_load(self._loads[link], load)
        await self._estimate.show(_estimate(estimate))  # last: a client that sees the new revision finds its values


def _machine(machine: MachineState) -> dict[str, Value]:
    return {
        "Name": machine.name,
        "Connected": machine.connected,
        "MayMove": machine.may_move,
        "State": machine.state,
        "Stopped": machine.stopped,
        "StopsHeld": len(machine.stops),
        "Reason": machine.reason,
    }


def _campaign(campaign: CampaignProgress) -> dict[str, Value]:
    return {
        "Number": campaign.id,
        "State": campaign.state.value,
        "Cause": campaign.cause,
        "SweepsDone": campaign.done,
        "SweepsTotal": campaign.total,
        "CurrentSweeps": campaign.sweeps,
        "CurrentAxes": campaign.axes,
    }


def _estimate(estimate: LatestEstimate) -> dict[str, Value]:
    return {
        "Robot": estimate.robot,
        "Campaign": estimate.campaign,
        "Made": estimate.made,
        "ConditionNumber": estimate.condition,
        "Revision": estimate.revision,
    }


def _axis(axis: AxisQuality) -> dict[str, Value]:
    return {"Sweeps": axis.sweeps, "GapRatio": axis.gap, "LeftRatio": axis.left, "StdRatio": axis.std}
