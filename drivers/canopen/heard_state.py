"""What one node reports of its state on a bus that another host uses: statusword and velocity. Pure.

Sources, none of which disturbs the other host: TPDO `state`, and the answers to SDO uploads that the other host
requests. A block or segmented transfer has data that look like answers; so an answer counts only after its request.
"""

import struct
from contextlib import suppress

from drivers.canopen import frames
from drivers.canopen.device_map import DeviceMap
from drivers.canopen.objects import Entry
from drivers.canopen.profile import CanopenAxis
from drivers.canopen.units import codec
from drivers.cia402 import states
from drivers.errors import DriveError

PATIENCE = 0.1  # s until a question without an answer is asked again
UPLOAD = 0x40  # command specifier of an SDO upload request
_REQUEST = struct.Struct("<BHB4x")
_EXPEDITED = {0x43: 4, 0x47: 3, 0x4B: 2, 0x4F: 1, 0x42: 4}  # by command specifier of the answer: number of data bytes
_UNIT = ("velocity_unit", "increments", "motor_revolutions")
_PRE_OPERATIONAL = 0x7F


def upload_request(entry: Entry) -> bytes:
    """SDO request that reads an object."""
    return _REQUEST.pack(UPLOAD, entry.index, entry.sub)


class HeardState:
    """Times are s on the monotonic clock."""

    def __init__(self, axis: CanopenAxis, device_map: DeviceMap) -> None:
        self._axis, self._map = axis, device_map
        self.asked_by_service = float("-inf")  # time of its last SDO request to this node
        self._nmt: int | None = None
        self._requested: tuple[int, int] | None = None  # index and sub-index
        self._asked = float("-inf")
        self._at = float("-inf")  # time of the last request or question that is not answered yet
        self._values: dict[tuple[int, int], tuple[bytes, float]] = {}  # by object: value, time of its request
        self._pdo: tuple[frames.MotionPdo, float] | None = None

    @property
    def pre_operational(self) -> bool:
        """Whether the node reports that it accepts no process data, and answers SDO."""
        return self._nmt == _PRE_OPERATIONAL

    def note(self, event: frames.Event, now: float) -> None:
        """A frame of this node other than SDO."""
        if isinstance(event, frames.MotionPdo):
            self._pdo = event, now
        elif isinstance(event, frames.Heartbeat):
            self._nmt = event.state

    def requested(self, data: bytes, now: float) -> None:
        """An SDO request of the other host."""
        self.asked_by_service = now
        self._expect(data, now)

    def answered(self, data: bytes, now: float) -> None:
        """An SDO response of the node."""
        if len(data) != 8 or self._requested is None:
            return
        specifier, index, sub = struct.unpack_from("<BHB", data)
        if (index, sub) != self._requested:
            return
        self._requested = None
        if size := _EXPEDITED.get(specifier):
            self._values[index, sub] = data[4 : 4 + size], self._at

    def question(self, since: float, now: float) -> bytes:
        """The next SDO upload request that is needed to know the state after `since`; b"" if an answer is awaited."""
        if self._requested is not None and now - self._asked < PATIENCE:
            return b""
        status, velocity = (self._value(name, since) for name in ("statusword", "velocity"))
        if status is None or (velocity is not None and velocity[1] >= status[1]):
            name = next((name for name in self._unknown_units()), "statusword")
        else:
            name = "velocity"
        self._asked = now
        request = upload_request(self._map.entry(name))
        self._expect(request, now)
        return request

    def doubt(self, since: float) -> str:
        """Why it is not known that the axis stood without energy at a time after `since`; "" if it reported that."""
        reported = self._reported(since)
        if reported is None:
            return "its state cannot be heard here" if self._nmt is None else "does not report its state"
        status, velocity = reported
        if states.decode(status) not in states.WITHOUT_ENERGY:
            return f"is '{states.decode(status).value}'"
        limit = self._limit()
        return "" if abs(velocity) <= limit else f"turns at {velocity} velocity units, standstill is at most {limit:g}"

    # -- inside

    def _reported(self, since: float) -> tuple[int, int] | None:
        """Statusword and raw velocity of the same time or of a later velocity; the newest after `since`."""
        found: list[tuple[float, int, int]] = []
        if self._pdo is not None and self._pdo[1] > since:
            found.append((self._pdo[1], self._pdo[0].statusword, self._pdo[0].velocity))
        status, velocity = self._value("statusword", since), self._value("velocity", since)
        if status is not None and velocity is not None and velocity[1] >= status[1]:
            found.append((status[1], int(status[0]), int(velocity[0])))
        elif status is not None and states.decode(int(status[0])) not in states.WITHOUT_ENERGY:
            found.append((status[1], int(status[0]), 0))  # it is energised, whatever its velocity is
        return max(found)[1:] if found else None

    def _value(self, name: str, since: float) -> tuple[float, float] | None:
        """The value of an object that was requested after `since`, and the time of the request."""
        entry = self._map.entry(name)
        value, at = self._values.get((entry.index, entry.sub), (b"", float("-inf")))
        if at <= since:
            return None
        with suppress(struct.error):
            return entry.unpack(value), at
        return None

    def _expect(self, data: bytes, now: float) -> None:
        self._requested = None
        if len(data) == _REQUEST.size and data[0] == UPLOAD:
            _, index, sub = _REQUEST.unpack(data)
            self._requested, self._at = (index, sub), now

    def _unknown_units(self) -> list[str]:
        units = self._map.units
        wanted = _UNIT if units.velocity == "60A9h" else ()
        return [
            name
            for name in wanted
            if name not in self._map.missing
            and self._value(name, float("-inf")) is None
            and not (name != "velocity_unit" and units.increments != "608Fh")
        ]

    def _limit(self) -> float:
        """Largest raw velocity at standstill. 0 while the unit of the drive was not heard: 0 is 0 in every unit."""

        def read(name: str) -> float:
            if name in self._map.missing:
                return 1.0
            value = self._value(name, float("-inf"))
            if value is None:
                raise KeyError(name)
            return value[0]

        units = self._map.units.model_copy(update={"effort": "torque"})  # its unit is not needed
        try:
            return abs(self._axis.standstill_velocity / float(codec(self._axis, units, 1.0, read).velocity(1.0)))
        except (KeyError, DriveError, ZeroDivisionError):
            return 0.0
