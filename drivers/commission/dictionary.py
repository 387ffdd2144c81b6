"""Contents of an EDS or DCF (CiA 306) about the objects of a drive: type, access, whether a PDO may carry it."""

import drivers.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from canopen.objectdictionary import ODVariable, datatypes

from drivers.eds import object_dictionary
from drivers.errors import BadProfile

Key = tuple[int, int]

_NAMES = {
    datatypes.INTEGER8: "i8",
    datatypes.UNSIGNED8: "u8",
    datatypes.INTEGER16: "i16",
    datatypes.UNSIGNED16: "u16",
    datatypes.INTEGER32: "i32",
    datatypes.UNSIGNED32: "u32",
}


@dataclass(frozen=True, slots=True)
class Listed:
    """One object. `type` as in device maps ("i32"), "" for other types; `value` as commissioned, otherwise the
    default.
    """

    type: str
    writable: bool
    mappable: bool
    value: int | None


@dataclass(frozen=True, slots=True)
class Dictionary:
    """The objects of a file by index and sub-index, and the manufacturer of the drive; None if the file does not state
    it, or states 0, which no manufacturer has.
    """

    objects: Mapping[Key, Listed]
    vendor: int | None
    product: int | None
    revision: int | None
    name: str  # of maker and product, for people

    def value(self, index: int, sub: int = 0) -> int | None:
        """Value of an object according to the file."""
        listed = self.objects.get((index, sub))
        return None if listed is None else listed.value


def read_dictionary(path: Path, node: int) -> Dictionary:
    """BadProfile names the file and the reason. `node` resolves ``$NODEID``."""
    try:
        whole: Any = object_dictionary(path, node)
    except (OSError, ValueError) as error:
        raise BadProfile(f"eds: {path}: {getattr(error, 'strerror', None) or error}") from None
    objects: dict[Key, Listed] = {}
    for entry in whole.values():
        for variable in [entry] if isinstance(entry, ODVariable) else entry.values():
            objects[variable.index, variable.subindex] = _listed(variable)
    about = whole.device_information
    identity = [objects[0x1018, sub].value if (0x1018, sub) in objects else None for sub in (1, 2, 3)]
    return Dictionary(
        objects,
        vendor=about.vendor_number or identity[0] or None,
        product=about.product_number or identity[1] or None,
        revision=about.revision_number or identity[2] or None,
        name=_printable(f"{about.vendor_name or ''} {about.product_name or ''}"),
    )


def _printable(name: str) -> str:
    """In one line, without characters that YAML does not read."""
    return " ".join("".join(letter if letter.isprintable() else " " for letter in name).split())


def _listed(variable: Any) -> Listed:
    values = (getattr(variable, "value", None), variable.default)
    value = next((each for each in values if isinstance(each, int)), None)
    return Listed(_NAMES.get(variable.data_type, ""), variable.writable, variable.pdo_mappable, value)
