"""SDO server: request bytes in, response bytes out (CiA 301, 7.2.4.3). Expedited, segmented, block upload."""

import binascii
import struct
from dataclasses import dataclass

from simulator.drive.dictionary import AbortCode, ObjectDictionary, SdoAbort


@dataclass(slots=True)
class _Transfer:
    """A transfer that needs more than one request."""

    index: int
    subindex: int
    data: bytearray
    download: bool
    toggle: int = 0
    offset: int = 0  # block upload: acknowledged bytes
    block_size: int = 0  # block upload: segments per block
    ended: bool = False  # block upload: everything is sent and acknowledged


class SdoServer:
    """One server channel. `handle` does not raise for any request of a client."""

    head = struct.Struct("<BHB")

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self._dictionary = dictionary
        self._transfer: _Transfer | None = None
        self._multiplexer = (0, 0)

    def reset(self) -> None:
        """Discard a transfer in progress."""
        self._transfer = None

    def handle(self, request: bytes) -> list[bytes]:
        """Answer one request of 8 bytes with none, one or (block upload) many responses."""
        if len(request) != 8:
            return []
        try:
            return self._dispatch(request)
        except SdoAbort as abort:
            self._transfer = None
            return [struct.pack("<BHBI", 0x80, *self._multiplexer, abort.code)]

    def _dispatch(self, request: bytes) -> list[bytes]:
        command = request[0]
        match command >> 5:
            case 1:
                return [self._initiate_download(request)]
            case 0:
                return [self._download_segment(request)]
            case 2:
                return [self._initiate_upload(request)]
            case 3:
                return [self._upload_segment(command)]
            case 4:
                self._transfer = None
                return []
            case 5:
                return self._block_upload(request)
            case _:
                raise SdoAbort(AbortCode.COMMAND)

    def _initiate(self, request: bytes) -> tuple[int, int]:
        _, index, subindex = SdoServer.head.unpack_from(request)
        self._transfer = None
        self._multiplexer = (index, subindex)
        return index, subindex

    def _initiate_download(self, request: bytes) -> bytes:
        index, subindex = self._initiate(request)
        command = request[0]
        if command & 0x02:
            size = 4 - ((command >> 2) & 3) if command & 0x01 else 4
            self._dictionary.download(index, subindex, request[4 : 4 + size])
        else:
            self._transfer = _Transfer(index, subindex, bytearray(), download=True)
        return SdoServer.head.pack(0x60, index, subindex) + bytes(4)

    def _download_segment(self, request: bytes) -> bytes:
        transfer = self._toggled(request[0], download=True)
        transfer.data += request[1 : 8 - ((request[0] >> 1) & 7)]
        if len(transfer.data) > 4096:
            raise SdoAbort(AbortCode.TOO_LONG)
        if request[0] & 0x01:
            self._transfer = None
            self._dictionary.download(transfer.index, transfer.subindex, bytes(transfer.data))
        return bytes([0x20 | transfer.toggle ^ 0x10]) + bytes(7)

    def _initiate_upload(self, request: bytes) -> bytes:
        index, subindex = self._initiate(request)
        data = self._dictionary.upload(index, subindex)
        if not data:
            raise SdoAbort(AbortCode.NO_DATA)
        if len(data) <= 4:
            return SdoServer.head.pack(0x43 | (4 - len(data)) << 2, index, subindex) + data.ljust(4, b"\0")
        self._transfer = _Transfer(index, subindex, bytearray(data), download=False)
        return struct.pack("<BHBI", 0x41, index, subindex, len(data))

    def _upload_segment(self, command: int) -> bytes:
        transfer = self._toggled(command, download=False)
        segment = bytes(transfer.data[:7])
        del transfer.data[:7]
        head = transfer.toggle ^ 0x10 | (7 - len(segment)) << 1
        if not transfer.data:
            head |= 1
            self._transfer = None
        return bytes([head]) + segment.ljust(7, b"\0")

    def _toggled(self, command: int, *, download: bool) -> _Transfer:
        transfer = self._transfer
        if transfer is None or transfer.block_size or transfer.download is not download:
            raise SdoAbort(AbortCode.COMMAND)
        if command & 0x10 != transfer.toggle:
            raise SdoAbort(AbortCode.TOGGLE)
        transfer.toggle ^= 0x10
        return transfer

    def _block_upload(self, request: bytes) -> list[bytes]:
        subcommand = request[0] & 0x03
        if subcommand == 0:
            index, subindex = self._initiate(request)
            if not self._dictionary.block_upload:
                raise SdoAbort(AbortCode.COMMAND)
            data = self._dictionary.upload(index, subindex)
            if not data:
                raise SdoAbort(AbortCode.NO_DATA)
            size = _block_size(request[4])
            self._transfer = _Transfer(index, subindex, bytearray(data), download=False, block_size=size)
            return [struct.pack("<BHBI", 0xC6, index, subindex, len(data))]
        transfer = self._transfer
        if transfer is None or not transfer.block_size:
            raise SdoAbort(AbortCode.COMMAND)
        if subcommand == 3:
            return self._block(transfer)
        if subcommand == 2:
            transfer.offset = min(transfer.offset + 7 * min(request[1], transfer.block_size), len(transfer.data))
            transfer.block_size = _block_size(request[2])
            if transfer.offset < len(transfer.data):
                return self._block(transfer)
            transfer.ended = True
            unused = -len(transfer.data) % 7
            return [struct.pack("<BH", 0xC1 | unused << 2, binascii.crc_hqx(transfer.data, 0)) + bytes(5)]
        self._transfer = None  # end of the transfer, acknowledged by the client
        if not transfer.ended:
            raise SdoAbort(AbortCode.COMMAND)
        return []

    @staticmethod
    def _block(transfer: _Transfer) -> list[bytes]:
        data, start = transfer.data, transfer.offset
        frames: list[bytes] = []
        for number in range(1, transfer.block_size + 1):
            segment = data[start : start + 7]
            start += 7
            last = start >= len(data)
            frames.append(bytes([number | (0x80 if last else 0)]) + bytes(segment).ljust(7, b"\0"))
            if last:
                break
        return frames


def _block_size(wanted: int) -> int:
    if not 1 <= wanted <= 127:
        raise SdoAbort(AbortCode.BLOCK_SIZE)
    return wanted
