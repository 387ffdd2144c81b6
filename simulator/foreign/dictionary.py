"""The object dictionary of a foreign drive: exactly the objects of its EDS or DCF (CiA 301, CiA 306).

At power-on the communication area has the defaults of the file; the rest has the commissioned values
(ParameterValue) or else the defaults. Inside the drive ``d[0x6041, 0]`` also reads the manufacturer's values of
objects that the file lacks; on the bus these objects do not exist.
"""

import drivers.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

from canopen.objectdictionary import ODVariable, datatypes

from drivers.eds import object_dictionary
from simulator.drive.dictionary import Abort, AbortCode, Key, Traits, Value
from simulator.foreign.makers import Maker, maker_of
from simulator.scenario import ScenarioError

_PROFILE = 0x2000  # first index after the communication profile
_DUMMIES = 0x20  # indices below are data types that fill RPDOs, not objects
_STORING = {0x1010: 0x65766173, 0x1011: 0x64616F6C}  # "save", "load"
_VELOCITIES = (0x607F, 0x6080, 0x6081, 0x6099, 0x60FF)


class ForeignDictionary:
    """Values of one node, from `file`; `node` replaces ``$NODEID``. Raises ScenarioError if the file is no EDS or DCF.

    `nameplate`: values of the device that the file cannot contain (motor, limits, serial number). Keys without an
    object in the file are used only inside the drive.
    """

    traits = Traits(block_upload=False, load_encoder=False)

    def __init__(self, file: Path, node: int) -> None:
        self._file = file
        self._hooks: dict[Key, Callable[[Any], None]] = {}
        self.nameplate: dict[Key, Value] = {}
        self._read(node)
        information = self._objects.device_information
        vendor = information.vendor_number or self._stated((0x1018, 1)) or 0
        self.maker: Maker = maker_of(vendor, information.vendor_name or "", information.product_name or "")
        self.nameplate |= {
            (0x1018, 1): vendor,
            (0x1018, 2): self._stated((0x1018, 2)) or information.product_number or 0,
            (0x1018, 3): self._stated((0x1018, 3)) or information.revision_number or 0,
            (0x1018, 4): (self._stated((0x1018, 4)) or 0x5D000000)
            + node,  # different for each device that uses the file
            (0x1008, 0): information.product_name or self.maker.name,
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
        self._dummies: dict[int, int] = {}
        for entry in objects.values():
            for variable in [entry] if isinstance(entry, ODVariable) else entry.values():
                if variable.index < _DUMMIES:
                    self._dummies[variable.index] = len(variable)
                else:
                    self._variables[variable.index, variable.subindex] = variable
        self._indices = {index for index, _ in self._variables}

    def restore(self) -> None:
        """Set every value from nameplate, file or manufacturer; a value without source is 0, or empty."""
        self._values: dict[Key, Value] = dict(self.maker.absent)
        for key, variable in self._variables.items():
            stated = self._stated(key)
            if stated is None:
                text = variable.data_type not in datatypes.NUMBER_TYPES and variable.data_type != datatypes.BOOLEAN
                stated = self.maker.absent.get(key, b"" if text else 0)
            self._values[key] = stated
        self._values |= self.nameplate

    def _stated(self, key: Key) -> Any:
        """Value of an object in the file; None if it has none."""
        variable = self._variables.get(key)
        if variable is None:
            return None
        both = variable.default, cast("int | None", getattr(variable, "value", None))
        first, second = both if key[0] < _PROFILE else both[::-1]
        return second if first is None else first

    def __contains__(self, key: Key) -> bool:
        return key in self._variables

    def __getitem__(self, key: Key) -> Any:
        return self._values[key]

    def __setitem__(self, key: Key, value: Value) -> None:
        self._values[key] = value

    def get(self, index: int, subindex: int = 0, default: Any = 0) -> Any:
        """The value, or `default` if file, nameplate and manufacturer have none."""
        return self._values.get((index, subindex), default)

    def set_actual(self, index: int, value: int, subindex: int = 0) -> None:
        """Set an actual value if the file has the object, limited to the range of its type."""
        variable = self._variables.get((index, subindex))
        if variable is not None:
            bits, signed = len(variable), variable.data_type in datatypes.SIGNED_TYPES
            top = (1 << (bits - signed)) - 1
            self._values[index, subindex] = max(-top - 1 if signed else 0, min(top, value))

    def keys(self, index: int) -> list[Key]:
        """All keys of one object, by sub-index."""
        return sorted(key for key in self._variables if key[0] == index)

    def writable(self, key: Key) -> bool:
        """Whether the bus may write an object."""
        return key in self._variables and self._variables[key].writable

    def on_download(self, key: Key, hook: Callable[[Any], None]) -> None:
        """Call `hook(value)` before a value from the bus is stored; it may raise `Abort` to refuse it."""
        self._hooks[key] = hook

    def upload(self, index: int, subindex: int) -> bytes:
        """Value for the bus. Raises `Abort`."""
        variable = self._variable(index, subindex)
        if not variable.readable:
            raise Abort(AbortCode.WRITE_ONLY)
        return self.encode((index, subindex))

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Store a value from the bus: access, length, range, hook, store. Raises `Abort`; then nothing is changed."""
        variable = self._variable(index, subindex)
        if not variable.writable:
            raise Abort(AbortCode.READ_ONLY)
        value: Any = data
        if variable.data_type in datatypes.NUMBER_TYPES:
            if 8 * len(data) != len(variable):
                raise Abort(AbortCode.LENGTH)
            value = variable.decode_raw(data)
            self._check_range(variable, value)
        if index in _STORING and subindex:
            if value != _STORING[index]:
                raise Abort(AbortCode.NOT_STORED)
            return  # values are not kept over power-off
        hook = self._hooks.get((index, subindex))
        if hook is not None:
            hook(value)
        self._values[index, subindex] = value

    def encode(self, key: Key) -> bytes:
        """The present value as sent on the bus."""
        return bytes(cast(Any, self._variables[key]).encode_raw(self._values[key]))

    def bits(self, key: Key) -> int:
        """Length of an object, or of a dummy (a data type) in an RPDO."""
        return self._dummies[key[0]] if key[0] in self._dummies else len(self._variables[key])

    def check_mapping(self, key: Key, bits: int, *, receive: bool) -> None:
        """Raise `Abort` unless the object may be mapped to a PDO with this number of bits."""
        if key[0] in self._dummies and receive and key[1] == 0:
            if bits != self._dummies[key[0]]:
                raise Abort(AbortCode.NOT_MAPPABLE)
            return
        variable = self._variable(*key)
        forbidden = "rwr" if receive else "rww"
        able = variable.writable if receive else variable.readable
        if not variable.pdo_mappable or not able or variable.access_type == forbidden or bits != len(variable):
            raise Abort(AbortCode.NOT_MAPPABLE)

    def _check_range(self, variable: ODVariable, value: float) -> None:
        low, high = variable.min, variable.max
        if variable.index == 0x1016:  # the limits in manufacturers' files apply to the time, in the low word
            value = int(value) & 0xFFFF
        if variable.index in _VELOCITIES and (0x60A9, 0) in self:  # limits are in the unit that the file has
            finer = 10.0 ** (_prefix(self._stated((0x60A9, 0))) - _prefix(self[0x60A9, 0]))
            low = round(low * finer) if low is not None and low < 0 else low
            high = None if high is None else round(high * finer)
        if high is not None and value > high:
            raise Abort(AbortCode.TOO_HIGH)
        if low is not None and value < low:
            raise Abort(AbortCode.TOO_LOW)

    def _variable(self, index: int, subindex: int) -> ODVariable:
        if index not in self._indices:
            raise Abort(AbortCode.NO_OBJECT)
        variable = self._variables.get((index, subindex))
        if variable is None:
            raise Abort(AbortCode.NO_SUBINDEX)
        return variable


def _prefix(unit: int) -> int:
    """The power of ten of a unit (CiA 303-2)."""
    return (unit >> 24) - (256 if unit >> 31 else 0)
