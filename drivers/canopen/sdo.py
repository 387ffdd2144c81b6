"""Typed SDO access to one node; blocking, for one thread at a time."""

import struct
from collections.abc import Callable
from typing import Any, cast

import can
import canopen
from canopen.sdo.client import BlockUploadStream, SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from drivers.canopen.objects import Entry
from drivers.errors import CauseCode, CommunicationLost, WrongConfiguration

_INITIATE = frozenset({*range(0x20, 0x30), 0x40, *range(0xA0, 0xA8, 4), *range(0xC0, 0xC8, 2)})
"""Requests that name an object: download, upload, block upload, block download."""
_NONE = bytes(3)
ABSENT = frozenset({0x06020000, 0x06090011})  # object, sub-index does not exist


class SharedSdoClient(SdoClient):
    """One of several clients of a node: the stop process also asks it for its state, and its answers reach everybody.

    An answer that names another object than the request (CiA 301, initiate services) is somebody else's; an abort that
    names none is taken for ours.
    """

    _object: bytes | None = None  # index and sub-index of the request; None: a segment or block, which names none

    def send_request(self, request: bytes) -> None:
        self._object = bytes(request[1:4]) if request[0] in _INITIATE else None
        cast(Any, super()).send_request(request)

    def on_response(self, can_id: int, data: bytes, timestamp: float) -> None:
        if self._object is None or bytes(data[1:4]) in (self._object, _NONE):
            cast(Any, super()).on_response(can_id, data, timestamp)


class RemoteNode(canopen.RemoteNode):
    """With this client."""

    def add_sdo(self, rx_cobid: int, tx_cobid: int) -> SdoClient:
        client = SharedSdoClient(rx_cobid, tx_cobid, self.object_dictionary)
        cast(Any, self).sdo_channels.append(client)
        return client


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
            return entry.unpack(self.client.upload(entry.index, entry.sub))
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
            self.client.download(entry.index, entry.sub, entry.pack(value))
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

    def _explain(self, entry: Entry, error: Exception, value: str = "") -> WrongConfiguration | CommunicationLost:
        if not isinstance(error, SdoAbortedError):
            return CommunicationLost(self.place, f"{entry}{value}: {error}")
        kind = ObjectAbsent if error.code in ABSENT else WrongConfiguration
        return kind(self.place, f"{entry}{value}: {error}")
