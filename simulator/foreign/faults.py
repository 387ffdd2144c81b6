"""Error objects of a foreign drive, if it has them (603Fh, 1001h, 1003h), and its emergency messages."""

import struct
from enum import IntEnum

from simulator.drive.dictionary import Abort, AbortCode
from simulator.foreign.dictionary import ForeignDictionary


class ErrorCode(IntEnum):
    """Codes of these drives (CiA 301, table 26; CiA 402-2; FF10h is used by the virtual machine)."""

    NO_POWER_SECTION = 0x5400
    ENCODER = 0x7305
    HEARTBEAT = 0x8130
    PDO_TOO_SHORT = 0x8210
    PDO_TOO_LONG = 0x8220
    SYNC_LENGTH = 0x8240
    SPEED_LIMIT = 0x8400
    FOLLOWING = 0x8611
    EMERGENCY_STOP = 0x9000
    LIMIT_SWITCH = 0xFF10


_GENERIC, _COMMUNICATION, _PROFILE, _MAKER = 0x01, 0x10, 0x20, 0x80


class ErrorLog:
    """Enters errors into the dictionary and queues the bytes of the emergency messages."""

    def __init__(self, dictionary: ForeignDictionary) -> None:
        self._dictionary = dictionary
        self._messages: list[bytes] = []
        if (0x1003, 0) in dictionary:
            dictionary.on_download((0x1003, 0), self._clear_history)
        self.reset()

    def reset(self) -> None:
        """As at power-on."""
        self.code = self.register = 0
        self._history: list[int] = []

    def enter(self, code: int) -> None:
        """A new error: 603Fh, 1001h, first of 1003h, EMCY."""
        group = _COMMUNICATION if code >> 8 in (0x81, 0x82) else _MAKER if code >> 8 in (0x90, 0xFF) else _PROFILE
        self.code, self.register = code, self.register | _GENERIC | group
        self._history = [code, *self._history][: max(len(self._dictionary.keys(0x1003)) - 1, 0)]
        self._publish()
        self.announce(code)

    def announce(self, code: int) -> None:
        """Only an emergency message: no error in the dictionary, no fault state."""
        self._messages.append(struct.pack("<HB5x", code, self.register))

    def clear(self) -> None:
        """The fault was reset: EMCY with code 0; the history is kept."""
        self.code = self.register = 0
        self._publish()
        self.announce(0)

    def take_messages(self) -> list[bytes]:
        """Emergency messages not sent yet, oldest first."""
        messages, self._messages = self._messages, []
        return messages

    def _publish(self) -> None:
        self._dictionary.set_actual(0x603F, self.code)
        self._dictionary.set_actual(0x1001, self.register)
        self._dictionary.set_actual(0x1003, len(self._history))
        for sub in range(1, len(self._dictionary.keys(0x1003))):
            self._dictionary.set_actual(0x1003, self._history[sub - 1] if sub <= len(self._history) else 0, sub)

    def _clear_history(self, value: int) -> None:
        if value:
            raise Abort(AbortCode.VALUE)  # only 0 may be written (CiA 301, 7.5.2.6)
        self._history = []
        self._publish()
