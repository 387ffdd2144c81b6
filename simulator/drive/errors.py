"""A node's error objects (603Fh, 1001h, 1003h) and the emergency messages they cause (CiA 301, 7.2.7)."""

import struct
from enum import IntEnum

from simulator.drive.dictionary import Dictionary


class ErrorCode(IntEnum):
    """Error codes of the drive itself (CiA 402-2, table of error codes; 9000h external, FFxxh
    manufacturer-specific).
    """

    TORQUE_LIMIT = 0x2310
    NO_POWER_SECTION = 0x5400
    PARAMETER = 0x6320
    ENCODER = 0x7305
    HEARTBEAT = 0x8130
    SET_POINT_MISSING = 0x8250
    SPEED_LIMIT = 0x8400
    FOLLOWING = 0x8611
    POSITION_LIMIT = 0x8612
    SYNC_MISSING = 0x8700
    EMERGENCY_STOP = 0x9000
    LIMIT_SWITCH = 0xFF10


_REGISTER: dict[int, int] = {
    ErrorCode.TORQUE_LIMIT: 0x03,
    ErrorCode.HEARTBEAT: 0x11,
    ErrorCode.SET_POINT_MISSING: 0x11,
    ErrorCode.SYNC_MISSING: 0x11,
    ErrorCode.EMERGENCY_STOP: 0x81,
}
_DEVICE_PROFILE = 0x21


class ErrorLog:
    """Enters errors into the dictionary and queues the bytes of the emergency messages."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._dictionary = dictionary
        self._messages: list[bytes] = []
        dictionary.on_download((0x1003, 0), lambda _: self._clear_history())

    def enter(self, code: int) -> None:
        """A new error: 603Fh, 1001h, first of 1003h, EMCY."""
        d = self._dictionary
        register = d[0x1001, 0] | _REGISTER.get(code, _DEVICE_PROFILE)
        d[0x603F, 0], d[0x1001, 0] = code, register
        history = [code, *(d[0x1003, sub] for sub in range(1, 8))]
        for sub, entry in enumerate(history, 1):
            d[0x1003, sub] = entry
        d[0x1003, 0] = min(d[0x1003, 0] + 1, 8)
        self._messages.append(struct.pack("<HB5x", code, register))

    def announce(self, code: int) -> None:
        """Only an emergency message: no error in the dictionary, no fault state."""
        self._messages.append(struct.pack("<HB5x", code, self._dictionary[0x1001, 0]))

    def clear(self) -> None:
        """The fault was reset: EMCY with code 0; the history is kept."""
        self._dictionary[0x603F, 0] = self._dictionary[0x1001, 0] = 0
        self._messages.append(bytes(8))

    def take_messages(self) -> list[bytes]:
        """Emergency messages not sent yet, oldest first."""
        messages, self._messages = self._messages, []
        return messages

    def _clear_history(self) -> None:
        for sub in range(1, 9):
            self._dictionary[0x1003, sub] = 0
