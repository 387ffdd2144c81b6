"""A client of the CAN bus that says what it likes, by hand."""

import struct
import time

import can


class Host:
    """SDO to any node."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus = bus

    def _request(self, node: int, data: bytes) -> bytes:
        self._bus.send(can.Message(arbitration_id=0x600 + node, data=data, is_extended_id=False))
        deadline = time.monotonic() + 60.0
        while time.monotonic() < deadline:
            message = self._bus.recv(0.1)
            if message is not None and message.arbitration_id == 0x580 + node and not message.is_error_frame:
                return bytes(message.data)
        raise AssertionError(f"no answer of node {node}")

    def write(self, node: int, index: int, sub: int, layout: str, value: float) -> int:
        """Abort code, or 0; at most 4 bytes."""
        data = struct.pack("<" + layout, value)
        head = struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, sub)
        answer = self._request(node, head + data.ljust(4, b"\0"))
        return struct.unpack_from("<I", answer, 4)[0] if answer[0] == 0x80 else 0

    def read(self, node: int, index: int, sub: int, layout: str) -> int:
        answer = self._request(node, struct.pack("<BHB4x", 0x40, index, sub))
        assert answer[0] != 0x80, f"{index:x}h:{sub} {answer.hex()}"
        return struct.unpack_from("<" + layout, answer, 4)[0]

    def enable(self, node: int, mode: int) -> None:
        assert self.write(node, 0x6060, 0, "b", mode) == 0
        for controlword, state in ((0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)):
            assert self.write(node, 0x6040, 0, "H", controlword) == 0
            assert self.read(node, 0x6041, 0, "H") & 0x6F == state
