"""The object dictionary of one node: exactly the objects of its EDS or DCF, with their access rules and ranges
(CiA 301, 7.2.4; CiA 306).

At power-on the communication area has the defaults of the file; the rest has the commissioned values
(ParameterValue) or else the defaults. Inside the drive values are read and written by key, ``d[0x6041, 0]``, and the
maker's values of objects that the file lacks as well. From the bus they pass through `upload` and `download`, which
only accept objects of the file.
"""

import drivers.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
import configparser
from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import Any, cast

from canopen.objectdictionary import ODVariable, datatypes

from drivers.eds import object_dictionary, read_sections
from simulator.drive.makers import VIRTUAL, Key, Maker, maker_of
from simulator.scenario import ScenarioError

# isort: split


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


class SdoAbort(Exception):
    """A transfer that the server refuses with `code`."""

    def __init__(self, code: AbortCode) -> None:
        super().__init__(f"SDO abort 0x{code:08X} {code.name}")
        self.code = code


class ObjectDictionary:
    """Values of one node, from `file`; `node` replaces ``$NODEID``. Raises ScenarioError if the file is no EDS or DCF.

    `maker`: default the virtual drive; None: the one that the file names. `nameplate`: values of the device that the
    file cannot contain (motor, limits, serial number). They have priority at every `restore`.
    """

    def __init__(self, file: Path, node: int, maker: Maker | None = VIRTUAL) -> None:
        self._file = file
        self.nameplate: dict[Key, Value] = {}
        self._on_download: dict[Key, Callable[[Any], None]] = {}
        self._on_upload: dict[Key, Callable[[], bytes]] = {}
        self._read(node)
        device = self._objects.device_information
        vendor = device.vendor_number or self._stated((0x1018, 1)) or 0
        self.maker = maker or maker_of(vendor, device.vendor_name or "", device.product_name or "")
        self.block_upload, self.load_encoder = _properties(file) if maker is VIRTUAL else (False, False)
        if maker is VIRTUAL:
            self.nameplate[0x1018, 4] = self._stated((0x1018, 4)) or 0  # does not depend on its node id
        else:
            self.nameplate |= {
                (0x1018, 1): vendor,
                (0x1018, 2): self._stated((0x1018, 2)) or device.product_number or 0,
                (0x1018, 3): self._stated((0x1018, 3)) or device.revision_number or 0,
                (0x1018, 4): (self._stated((0x1018, 4)) or 0x5D000000) + node,  # different for each device of a file
                (0x1008, 0): device.product_name or self.maker.name,
            }
        self.restore()

    def renumber(self, node: int) -> None:
        """Dictionary of another node id, with every value as at power-on."""
        self._read(node)
        self.restore()

    def _read(self, node: int) -> None:
        try:
            objects = object_dictionary(self._file, node)
        except (OSError, ValueError) as error:
            raise ScenarioError(f"{self._file}: {error}") from None
        self._objects: Any = objects
        self._variables: dict[Key, ODVariable] = {}
        self._dummies: dict[int, int] = {}  # data types that fill RPDOs, and their bits
        for entry in objects.values():
            for variable in [entry] if isinstance(entry, ODVariable) else entry.values():
                if variable.index < 0x20:
                    self._dummies[variable.index] = len(variable)
                else:
                    self._variables[variable.index, variable.subindex] = variable
        self._indices = {index for index, _ in self._variables}

    def restore(self) -> None:
        """Set every value from nameplate, file or maker; a value without source is 0, or empty."""
        self._values: dict[Key, Value] = dict(self.maker.absent)
        for key, variable in self._variables.items():
            stated = self._stated(key)
            if stated is None:
                number = variable.data_type in datatypes.NUMBER_TYPES or variable.data_type == datatypes.BOOLEAN
                stated = self.maker.absent.get(key, 0 if number else b"")
            self._values[key] = stated
        self._values |= self.nameplate

    def _stated(self, key: Key) -> Any:
        """Value of an object in the file; None if it has none."""
        variable = self._variables.get(key)
        if variable is None:
            return None
        both = variable.default, cast("int | None", getattr(variable, "value", None))
        first, second = both if key[0] < 0x2000 else both[::-1]  # the communication profile ends there
        return second if first is None else first

    # Inside the drive

    def __contains__(self, key: Key) -> bool:
        return key in self._variables

    def __getitem__(self, key: Key) -> Any:
        return self._values[key]

    def __setitem__(self, key: Key, value: Value) -> None:
        if key not in self._values:
            raise KeyError(key)
        self._values[key] = value

    def get(self, index: int, subindex: int = 0, default: Any = 0) -> Any:
        """The value, or `default` if file, nameplate and maker have none."""
        return self._values.get((index, subindex), default)

    def set_actual(self, index: int, value: int, subindex: int = 0) -> None:
        """Set an actual value if the drive has the object, limited to the range of its type."""
        variable = self._variables.get((index, subindex))
        if variable is not None:
            bits, signed = len(variable), variable.data_type in datatypes.SIGNED_TYPES
            top = (1 << (bits - signed)) - 1
            value = max(-top - 1 if signed else 0, min(top, value))
        if (index, subindex) in self._values:
            self._values[index, subindex] = value

    def keys(self, index: int) -> list[Key]:
        """All keys of one object, by sub-index."""
        return sorted(key for key in self._variables if key[0] == index)

    def writable(self, key: Key) -> bool:
        """Whether the bus may write an object."""
        return key in self._variables and self._variables[key].writable

    def on_download(self, key: Key, hook: Callable[[Any], None]) -> None:
        """Call `hook(value)` before a value from the bus is stored; it may raise `SdoAbort` to refuse it."""
        self._on_download[key] = hook

    def on_upload(self, key: Key, hook: Callable[[], bytes]) -> None:
        """Call `hook()` for the bytes of a domain when the bus reads it; it may raise `SdoAbort`."""
        self._on_upload[key] = hook

    # From the bus

    def upload(self, index: int, subindex: int) -> bytes:
        """Value for the bus. Raises `SdoAbort`."""
        if not self._variable((index, subindex)).readable:
            raise SdoAbort(AbortCode.WRITE_ONLY)
        hook = self._on_upload.get((index, subindex))
        return self.encode((index, subindex)) if hook is None else hook()

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Store a value from the bus: access, length, range, hook. Raises `SdoAbort`; then nothing is changed."""
        variable = self._variable((index, subindex))
        if not variable.writable:
            raise SdoAbort(AbortCode.READ_ONLY)
        value: Any = data
        if variable.data_type in datatypes.NUMBER_TYPES:
            wrong = len(data) - len(variable) // 8
            if wrong and self.maker.tells_length:
                raise SdoAbort(AbortCode.TOO_LONG if wrong > 0 else AbortCode.TOO_SHORT)
            if wrong:
                raise SdoAbort(AbortCode.LENGTH)
            value = variable.decode_raw(data)
            self._check_range(variable, value)
        stores = {0x1010: 0x65766173, 0x1011: 0x64616F6C}.get(index) if subindex else None  # "save", "load"
        if stores is not None:
            if value != stores:
                raise SdoAbort(AbortCode.NOT_STORED)
            return  # values are not kept over power-off
        hook = self._on_download.get((index, subindex))
        if hook is not None:
            hook(value)
        self._values[index, subindex] = value

    def encode(self, key: Key) -> bytes:
        """The present value as sent on the bus."""
        return bytes(cast(Any, self._variables[key]).encode_raw(self._values[key]))

    def struct_format(self, key: Key) -> str:
        """The `struct` character of a number, e.g. "H"; little endian."""
        kind = ODVariable.STRUCT_TYPES[cast(int, self._variables[key].data_type)].format
        return kind.lstrip("<").replace("l", "i").replace("L", "I")

    def bits(self, key: Key) -> int:
        """Length of an object, or of a dummy (a data type) in an RPDO."""
        return self._dummies[key[0]] if key[0] in self._dummies else len(self._variables[key])

    def check_mapping(self, key: Key, bits: int, *, receive: bool) -> None:
        """Raise `SdoAbort` unless the object may be mapped to a PDO with this number of bits."""
        if key[0] in self._dummies and receive and key[1] == 0:
            if bits != self._dummies[key[0]]:
                raise SdoAbort(AbortCode.NOT_MAPPABLE)
            return
        variable = self._variable(key)
        forbidden = "rwr" if receive else "rww"
        able = variable.writable if receive else variable.readable
        if not variable.pdo_mappable or not able or variable.access_type == forbidden or bits != len(variable):
            raise SdoAbort(AbortCode.NOT_MAPPABLE)

    def _check_range(self, variable: ODVariable, value: float) -> None:
        low, high = variable.min, variable.max
        if variable.index == 0x1016 and high is not None and high <= 0xFFFF:  # a limit of the time, in the low word
            value = int(value) & 0xFFFF
        if variable.index in (0x607F, 0x6080, 0x6081, 0x6099, 0x60FF) and (0x60A9, 0) in self:
            unit = self._stated((0x60A9, 0))  # limits are in the unit that the file has
            finer = 10.0 ** (power_of_ten(unit) - power_of_ten(self[0x60A9, 0]))
            low = round(low * finer) if low is not None and low < 0 else low
            high = None if high is None else round(high * finer)
        if high is not None and value > high:
            raise SdoAbort(AbortCode.TOO_HIGH)
        if low is not None and value < low:
            raise SdoAbort(AbortCode.TOO_LOW)

    def _variable(self, key: Key) -> ODVariable:
        if key[0] not in self._indices:
            raise SdoAbort(AbortCode.NO_OBJECT)
        if key not in self._variables:
            raise SdoAbort(AbortCode.NO_SUBINDEX)
        return self._variables[key]


def power_of_ten(unit: int) -> int:
    """The power of ten of a unit in 60A9h: its first byte, signed (CiA 303-2)."""
    return (unit >> 24) - (256 if unit >> 31 else 0)


def _properties(eds: Path) -> tuple[bool, ...]:
    """Properties of the virtual drive without an entry of their own: section [VirtualDrive], 0 or 1 each."""
    try:
        section = read_sections(eds).get("virtualdrive")
        given = [(section and section.text(key)) or "yes" for key in ("BlockUpload", "LoadEncoder")]
        return tuple(configparser.RawConfigParser.BOOLEAN_STATES[text.lower()] for text in given)
    except (OSError, ValueError) as error:
        raise ScenarioError(f"{eds}: {error}") from None
    except KeyError as error:
        raise ScenarioError(f"{eds}: [VirtualDrive]: {error} is neither yes nor no") from None
