"""The objects that the adapter uses (CiA 301, CiA 402); those of the measuring function are in `measuring.py`."""

import struct
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Entry:
    """One object with its wire type (struct code, little endian) and its name in messages, which may differ."""

    index: int
    sub: int
    type: str
    name: str = field(compare=False)

    def __str__(self) -> str:
        return f"{self.index:04X}h:{self.sub:02X} {self.name}"

    def pack(self, value: float) -> bytes:
        """The bytes of the value. Raises struct.error if it does not fit the type."""
        return struct.pack("<" + self.type, value if self.type == "d" else int(value))

    def unpack(self, data: bytes) -> float:
        """The value of the bytes. Raises struct.error if their number is wrong."""
        value: float = struct.unpack("<" + self.type, data)[0]
        return value


DEVICE_TYPE = Entry(0x1000, 0, "I", "device type")
ERROR_HISTORY = Entry(0x1003, 1, "I", "latest error")
SYNC_PERIOD = Entry(0x1006, 0, "I", "communication cycle in us")
HEARTBEAT_CONSUMER = Entry(0x1016, 1, "I", "heartbeat consumer")
HEARTBEAT_PRODUCER = Entry(0x1017, 0, "H", "heartbeat producer in ms")
SYNC_COUNTER = Entry(0x1019, 0, "B", "synchronous counter overflow")
VENDOR = Entry(0x1018, 1, "I", "vendor")
PRODUCT = Entry(0x1018, 2, "I", "product")
REVISION = Entry(0x1018, 3, "I", "revision")
SERIAL = Entry(0x1018, 4, "I", "serial number")

CONNECTION_LOSS = Entry(0x6007, 0, "h", "abort connection option")
ERROR_CODE = Entry(0x603F, 0, "H", "error code")
CONTROLWORD = Entry(0x6040, 0, "H", "controlword")
STATUSWORD = Entry(0x6041, 0, "H", "statusword")
QUICK_STOP_OPTION = Entry(0x605A, 0, "h", "quick stop option")
SHUTDOWN_OPTION = Entry(0x605B, 0, "h", "shutdown option")
DISABLE_OPTION = Entry(0x605C, 0, "h", "disable operation option")
HALT_OPTION = Entry(0x605D, 0, "h", "halt option")
FAULT_OPTION = Entry(0x605E, 0, "h", "fault reaction option")
MODE = Entry(0x6060, 0, "b", "mode of operation")
MODE_DISPLAY = Entry(0x6061, 0, "b", "mode of operation display")
POSITION = Entry(0x6064, 0, "i", "position")
VELOCITY = Entry(0x606C, 0, "i", "velocity")
MAX_TORQUE = Entry(0x6072, 0, "H", "max torque")
RATED_CURRENT = Entry(0x6075, 0, "I", "rated current in mA")
RATED_TORQUE = Entry(0x6076, 0, "I", "rated torque in 10^-3 N m")
TORQUE = Entry(0x6077, 0, "h", "torque")
CURRENT = Entry(0x6078, 0, "h", "current")
TARGET_POSITION = Entry(0x607A, 0, "i", "target position")
POSITION_MIN = Entry(0x607D, 1, "i", "lower position limit")
POSITION_MAX = Entry(0x607D, 2, "i", "upper position limit")
MAX_PROFILE_VELOCITY = Entry(0x607F, 0, "I", "max profile velocity")
MAX_MOTOR_SPEED = Entry(0x6080, 0, "I", "max motor speed")
PROFILE_VELOCITY = Entry(0x6081, 0, "I", "profile velocity")
PROFILE_ACCELERATION = Entry(0x6083, 0, "I", "profile acceleration")
PROFILE_DECELERATION = Entry(0x6084, 0, "I", "profile deceleration")
QUICK_STOP_DECELERATION = Entry(0x6085, 0, "I", "quick stop deceleration")
INCREMENTS = Entry(0x608F, 1, "I", "encoder increments")
MOTOR_REVOLUTIONS = Entry(0x608F, 2, "I", "motor revolutions")
VELOCITY_UNIT = Entry(0x60A9, 0, "I", "velocity unit")
VELOCITY_OFFSET = Entry(0x60B1, 0, "i", "velocity offset")
INTERPOLATED_POSITION = Entry(0x60C1, 1, "i", "interpolated position")
CYCLE_VALUE = Entry(0x60C2, 1, "B", "interpolation period")
CYCLE_EXPONENT = Entry(0x60C2, 2, "b", "interpolation period's power of ten")
TARGET_VELOCITY = Entry(0x60FF, 0, "i", "target velocity")
SUPPORTED_MODES = Entry(0x6502, 0, "I", "supported drive modes")

SAMPLE_COUNTER = Entry(0x2120, 1, "I", "sample counter")

SERVO_DRIVE = 0x192  # low word of 1000h: CiA 402
