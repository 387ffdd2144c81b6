"""Variables that clients read: their types from a table, their values with a status."""

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime

from asyncua.ua.uatypes import VariantType

from service.publishing.opcua.library import Node, ua

_PROPERTY = ua.ObjectIds.PropertyType


@dataclass(frozen=True, slots=True)
class Variable:
    """`robotics`: its name is in the namespace of the Robotics specification, else of OPC UA itself."""

    name: str
    kind: int  # its variable type, a node of OPC UA
    data: int  # its data type
    value: object = None
    children: "tuple[Variable, ...]" = ()
    robotics: bool = False
    optional: bool = False


def unknown() -> object:
    """Status: no value yet."""
    return ua.DataValue(StatusCode=ua.StatusCode(ua.StatusCodes.BadWaitingForInitialData))


def known(value: object, kind: VariantType | None = None) -> object:
    """Value with status Good and the present time."""
    now = datetime.now(UTC)
    return ua.DataValue(ua.Variant(value, kind), SourceTimestamp=now, ServerTimestamp=now)


async def add_variable(
    parent: Node,
    variable: Variable,
    node_of: Callable[[str], object],
    robotics: int,
    *,
    declared: bool = False,
    path: str = "",
) -> dict[str, Node]:
    """A variable with its parts, by path. `declared`: part of a type, so with modelling rules and without values."""
    path = f"{path}/{variable.name}" if path else variable.name
    name = ua.QualifiedName(variable.name, robotics if variable.robotics else 0)
    add = parent.add_property if variable.kind == _PROPERTY else parent.add_variable
    value = ua.Variant(variable.value)
    node = await add(node_of(path), name, value, datatype=ua.NodeId(variable.data))
    if variable.kind not in (_PROPERTY, ua.ObjectIds.BaseDataVariableType):
        await node.delete_reference(ua.ObjectIds.BaseDataVariableType, ua.ObjectIds.HasTypeDefinition)
        await node.add_reference(ua.NodeId(variable.kind), ua.ObjectIds.HasTypeDefinition, bidirectional=False)
    if declared:
        await node.set_modelling_rule(not variable.optional)
    elif variable.value is None:
        await node.write_value(unknown())
    found = {path: node}
    for child in variable.children:
        found |= await add_variable(node, child, node_of, robotics, declared=declared, path=path)
    return found
