"""The object dictionary of one node: typed values with the access rules and ranges of the EDS (CiA 301, 7.2.4).

Inside the drive, values are read and written by key, ``d[0x6041, 0]``, whether or not the EDS has that object. From
the bus they pass through `upload` and `download`, which only accept objects of the EDS.
"""

import drivers.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
import configparser
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, cast

from canopen.objectdictionary import ODVariable, datatypes

from drivers.eds import object_dictionary, read_sections
from simulator.drive.defaults import ABSENT, Key
from simulator.scenario import ScenarioError

Value = int | float | str | bytes


class AbortCode(IntEnum):
    """SDO abort codes in use (CiA 301, table 22)."""

    TOGGLE = 0x05030000
    COMMAND = 0x05040001
    BLOCK_SIZE = 0x05040002
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_LENGTH = 0x06040042
    INCOMPATIBLE = 0x06040043
    LENGTH = 0x06070010
    TOO_LONG = 0x06070012
    TOO_SHORT = 0x06070013
    NO_SUBINDEX = 0x06090011
    VALUE = 0x06090030
    TOO_HIGH = 0x06090031
    TOO_LOW = 0x06090032
    NOT_STORED = 0x08000020
    STATE = 0x08000022
    NO_DATA = 0x08000024


class Abort(Exception):
    """A transfer that the server refuses with `code`."""

    def __init__(self, code: AbortCode) -> None:
        super().__init__(f"SDO abort 0x{code:08X} {code.name}")
        self.code = code


@dataclass(frozen=True, slots=True)
class Traits:
    """Properties that have no EDS entry: section [VirtualDrive], 0 or 1 each."""

    block_upload: bool = True
    load_encoder: bool = True


class Dictionary:
    """Values of one node, from the EDS at `eds`; `node` replaces ``$NODEID``. Raises ScenarioError for a file that is
    no EDS.

    `nameplate`: values of the device that the EDS cannot contain (motor, serial number). They have priority at every
    `restore`.
    """

    def __init__(self, eds: Path, node: int) -> None:
        self._eds = eds
        self.traits = _traits(eds)
        self.nameplate: dict[Key, Value] = {}
        self._variables: dict[Key, ODVariable] = {}
        self._values: dict[Key, Value] = {}
        self._on_download: dict[Key, Callable[[Any], None]] = {}
        self._on_upload: dict[Key, Callable[[], bytes]] = {}
        self.renumber(node)
        self.nameplate[0x1018, 4] = self[0x1018, 4]  # belongs to the device and does not depend on its node id

    def renumber(self, node: int) -> None:
        """Dictionary of another node id, with every value as at power-on."""
        try:
            objects = object_dictionary(self._eds, node)
        except (OSError, ValueError) as error:
            raise ScenarioError(f"{self._eds}: {error}") from None
        self._variables = {}
        for entry in objects.values():
            for variable in [entry] if isinstance(entry, ODVariable) else entry.values():
                self._variables[variable.index, variable.subindex] = variable
        self._indices = {index for index, _ in self._variables}
        self.restore()

    def restore(self) -> None:
        """Set every value from nameplate, EDS or `ABSENT`; a value without default is 0."""
        self._values = dict(ABSENT)
        for key, variable in self._variables.items():
            default = cast("Value | None", variable.default)
            self._values[key] = 0 if default is None else default
        self._values |= self.nameplate

    def __contains__(self, key: Key) -> bool:
        return key in self._variables

    def __getitem__(self, key: Key) -> Any:
        return self._values[key]

    def __setitem__(self, key: Key, value: Value) -> None:
        if key not in self._values:
            raise KeyError(key)
        self._values[key] = value

    def keys(self, index: int) -> list[Key]:
        """All keys of one object, by sub-index."""
        return sorted(key for key in self._variables if key[0] == index)

    def on_download(self, key: Key, hook: Callable[[Any], None]) -> None:
        """Call `hook(value)` before a value from the bus is stored; it may raise `Abort` to refuse it."""
        self._on_download[key] = hook

    def on_upload(self, key: Key, hook: Callable[[], bytes]) -> None:
        """Call `hook()` for the bytes of a domain when the bus reads it; it may raise `Abort`."""
        self._on_upload[key] = hook

    def upload(self, index: int, subindex: int) -> bytes:
        """Value for the bus. Raises `Abort`."""
        variable = self._variable(index, subindex)
        if not variable.readable:
            raise Abort(AbortCode.WRITE_ONLY)
        hook = self._on_upload.get((index, subindex))
        if hook is not None:
            return hook()
        return self.encode((index, subindex))

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Store a value from the bus: access, length, range, hook, store. Raises `Abort`; then nothing is changed."""
        variable = self._variable(index, subindex)
        if not variable.writable:
            raise Abort(AbortCode.READ_ONLY)
        value: Any = data
        if variable.data_type in datatypes.NUMBER_TYPES:
            size = len(variable) // 8
            if len(data) != size:
                raise Abort(AbortCode.TOO_LONG if len(data) > size else AbortCode.TOO_SHORT)
            value = variable.decode_raw(data)
            if variable.max is not None and value > variable.max:
                raise Abort(AbortCode.TOO_HIGH)
            if variable.min is not None and value < variable.min:
                raise Abort(AbortCode.TOO_LOW)
        hook = self._on_download.get((index, subindex))
        if hook is not None:
            hook(value)
        self._values[index, subindex] = value

    def encode(self, key: Key) -> bytes:
        """The present value as sent on the bus."""
        return bytes(cast(Any, self._variables[key]).encode_raw(self._values[key]))

    def struct_format(self, key: Key) -> str:
        """The `struct` character of a number, e.g. "H"; little endian."""
        return (
            ODVariable.STRUCT_TYPES[cast(int, self._variables[key].data_type)]
            .format.lstrip("<")
            .replace("l", "i")
            .replace("L", "I")
        )

    def mapping(self, key: Key) -> tuple[int, bool, bool] | None:
        """(bits, may go into an RPDO, may go into a TPDO) of an object; None if it does not exist."""
        variable = self._variables.get(key)
        if variable is None:
            return None
        return len(variable), variable.pdo_mappable and variable.writable, variable.pdo_mappable and variable.readable

    def _variable(self, index: int, subindex: int) -> ODVariable:
        if index not in self._indices:
            raise Abort(AbortCode.NO_OBJECT)
        variable = self._variables.get((index, subindex))
        if variable is None:
            raise Abort(AbortCode.NO_SUBINDEX)
        return variable


def _traits(eds: Path) -> Traits:
    try:
        section = read_sections(eds).get("virtualdrive")
        given = [(section and section.text(key)) or "yes" for key in ("BlockUpload", "LoadEncoder")]
        return Traits(*(configparser.RawConfigParser.BOOLEAN_STATES[text.lower()] for text in given))
    except (OSError, ValueError) as error:
        raise ScenarioError(f"{eds}: {error}") from None
    except KeyError as error:
        raise ScenarioError(f"{eds}: [VirtualDrive]: {error} is neither yes nor no") from None
