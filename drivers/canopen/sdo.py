"""Typed SDO access to one node; blocking, for one thread at a time."""

import struct
from collections.abc import Callable
from typing import Any, TypeVar, cast

import can
from canopen.sdo.client import BlockUploadStream, SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers.canopen.objects import Entry
from drivers.errors import CauseCode, CommunicationLost, WrongConfiguration

T = TypeVar("T")

NO_ANSWER = "No SDO response received"  # canopen's words for a time-out
ABSENT = frozenset({0x06020000, 0x06090011})  # object, sub-index does not exist


class _BlockUpload(BlockUploadStream):
    """canopen 2.4 calls `abort` of the stream if a block is missing, but the stream has no such method."""

    def abort(self, code: int) -> None:
        cast(Any, self.sdo_client).abort(code)


class ObjectAbsent(WrongConfiguration, code=CauseCode.WRONG_CONFIGURATION):
    """The drive does not have an object."""


class OtherType(WrongConfiguration, code=CauseCode.WRONG_CONFIGURATION):
    """The drive has the object, with another length."""


class Sdo:
    """Reads and writes objects of one node. Raises CommunicationLost if the node does not answer."""

    def __init__(self, client: SdoClient, place: str, check_alive: Callable[[], None]) -> None:
        """`place` as in "joint_1 (node 1)"; `check_alive` raises CommunicationLost once the bus is lost."""
        self.client = client
        self.place = place
        self._check_alive = check_alive

    def read(self, entry: Entry) -> float:
        """Raises WrongConfiguration if the drive refuses; ObjectAbsent or OtherType if it has no such object or
        type.
        """
        self._check_alive()
        try:
            return entry.unpack(self._answer(entry))
        except (SdoAbortedError, SdoCommunicationError, can.CanError, OSError) as error:
            raise self._explain(entry, error) from None
        except struct.error as error:
            raise OtherType(
                self.place, f"{entry}: the drive's value has another type than the dictionary says: {error}"
            ) from None

    def integer(self, entry: Entry) -> int:
        return int(self.read(entry))

    def write(self, entry: Entry, value: float) -> None:
        """Errors as `read`; the value is not read back."""
        self._check_alive()
        try:
            packed = entry.pack(value)
            self._asked(lambda: self.client.download(entry.index, entry.sub, packed))
        except (SdoAbortedError, SdoCommunicationError, can.CanError, OSError) as error:
            raise self._explain(entry, error, f" = {value:g}") from None
        except struct.error as error:
            raise WrongConfiguration(self.place, f"{entry} cannot hold {value:g}: {error}") from None

    def settle(self, entry: Entry, value: float) -> None:
        """Make the object hold `value`: write it if it differs, and read it back. Raises WrongConfiguration if it
        differs then.
        """
        if self.read(entry) == value:
            return
        self.write(entry, value)
        got = self.read(entry)
        if got != value:
            raise WrongConfiguration(self.place, f"{entry}: wrote {value:g}, drive holds {got:g}")

    def upload(self, index: int, sub: int, block: bool) -> bytes:
        """A DOMAIN, by block or segmented transfer."""
        entry = Entry(index, sub, "s", "domain")
        self._check_alive()
        try:
            if not block:
                return self.client.upload(index, sub)
            with _BlockUpload(self.client, index, sub) as stream:
                return cast(bytes, stream.read())
        except (SdoAbortedError, SdoCommunicationError, can.CanError, OSError) as error:
            raise self._explain(entry, error) from None

    def _answer(self, entry: Entry) -> bytes:
        return self._asked(lambda: self.client.upload(entry.index, entry.sub))

    def _asked(self, ask: Callable[[], T]) -> T:
        """Once more after an answer to another question: the stop process also asks a node for its state, and a node
        sends its answers to everybody.
        """
        try:
            return ask()
        except SdoAbortedError:
            raise
        except SdoCommunicationError as error:
            if str(error) == NO_ANSWER:
                raise
            return ask()

    def _explain(self, entry: Entry, error: Exception, value: str = "") -> WrongConfiguration | CommunicationLost:
        if not isinstance(error, SdoAbortedError):
            return CommunicationLost(self.place, f"{entry}{value}: {error}")
        kind = ObjectAbsent if error.code in ABSENT else WrongConfiguration
        return kind(self.place, f"{entry}{value}: {error}")
