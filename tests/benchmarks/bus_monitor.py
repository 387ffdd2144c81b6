"""A third party on the bus: a process that notes when each SYNC and each sample frame (TPDO2) was on it.

    python -m tests.benchmarks.bus_monitor BUS FILE      BUS: the `bus` of a drive profile, as JSON

Its times are not its own: on SocketCAN the kernel stamps a frame when it passes, a socketcand server (the virtual
drive) when it has read it from the host. So they tell what the drive sees, however late this process runs. Prints one
line when it listens, and writes FILE (.npy, `FRAME`) when its standard input ends.
"""

import json
import re
import selectors
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import can
import numpy as np
from numpy.typing import NDArray

FRAME = np.dtype([("time", "f8"), ("id", "u2"), ("counter", "u4")])  # s of the wall clock; TPDO2's 2120h:01
SYNC, TPDO2 = 0x080, 0x280
NODES = range(1, 7)

_CAN_FRAME = struct.Struct("=IB3x8s")
_TIMESPEC = struct.Struct("@ll")
_SO_TIMESTAMPNS = 35
_LINE = re.compile(rb"< frame (080|28[1-6]) (\d+\.\d+) ([0-9A-F]*) >")

Note = tuple[float, int, int]


@contextmanager
def bus_monitor(bus: Mapping[str, Any]) -> Iterator[list[NDArray[np.void]]]:
    """Listens to `bus` of a profile meanwhile; the frames (n,) `FRAME` are in the list afterwards."""
    frames: list[NDArray[np.void]] = []
    if bus["interface"] == "virtual":
        with _listening(bus) as notes:
            yield frames
        frames.append(np.array(notes, FRAME))
        return
    with TemporaryDirectory() as folder:
        path = Path(folder) / "frames.npy"
        command = [sys.executable, "-m", "tests.benchmarks.bus_monitor", json.dumps(bus), str(path)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"listening\n"
            yield frames
            process.communicate(timeout=60)
        frames.append(np.load(path))


@contextmanager
def _listening(bus: Mapping[str, Any]) -> Iterator[list[Note]]:
    """A thread, for the bus that exists within one process only: python-can stamps a frame as it is sent."""
    notes: list[Note] = []
    over = threading.Event()
    with can.Bus(interface="virtual", channel=bus["channel"]) as interface:

        def listen() -> None:
            while not over.is_set():
                message = interface.recv(0.1)
                if message is not None and (note := _note(message.timestamp, message.arbitration_id, message.data)):
                    notes.append(note)

        thread = threading.Thread(target=listen, name="bus monitor")
        thread.start()
        try:
            yield notes
        finally:
            over.set()
            thread.join()


def _note(time: float, identifier: int, data: bytes | bytearray) -> Note | None:
    if identifier == SYNC:
        return time, identifier, 0
    if identifier - TPDO2 in NODES:
        return time, identifier, int.from_bytes(data[4:8], "little")
    return None


def _socketcan(bus: Mapping[str, Any]) -> socket.socket:
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    wanted = [SYNC, *(TPDO2 + node for node in NODES)]
    filters = b"".join(struct.pack("=II", identifier, 0x7FF) for identifier in wanted)
    raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)
    raw.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    raw.bind((bus["channel"],))
    return raw


def _from_socketcan(raw: socket.socket) -> list[Note]:
    data, ancillary, _, _ = raw.recvmsg(_CAN_FRAME.size, 64)
    identifier, length, payload = _CAN_FRAME.unpack(data)
    seconds, nanoseconds = _TIMESPEC.unpack(ancillary[0][2])
    note = _note(seconds + nanoseconds * 1e-9, identifier, cast(bytes, payload)[:length])
    return [note] if note else []


def _socketcand(bus: Mapping[str, Any]) -> socket.socket:
    connection = socket.create_connection((bus["host"], bus["port"]), timeout=10)
    for answer, request in ((b"< hi >", f"< open {bus['channel']} >"), (b"< ok >", "< rawmode >"), (b"< ok >", "")):
        received = connection.recv(len(answer), socket.MSG_WAITALL)
        if received != answer:
            raise ConnectionError(f"socketcand answered {received!r} instead of {answer!r}")
        connection.sendall(request.encode())
    return connection


class Lines:
    """What a socketcand server sends, cut into frames."""

    def __init__(self) -> None:
        self._rest = b""

    def take(self, received: bytes) -> list[Note]:
        text = self._rest + received
        self._rest = text[text.rfind(b">") + 1 :]
        return [
            (float(time), int(identifier, 16), int.from_bytes(bytes.fromhex(data.decode())[4:8], "little"))
            for identifier, time, data in _LINE.findall(text)
        ]


def main() -> None:
    bus, path = json.loads(sys.argv[1]), Path(sys.argv[2])
    lines, notes = Lines(), list[Note]()
    by_kernel = bus["interface"] == "socketcan"
    connection = _socketcan(bus) if by_kernel else _socketcand(bus)
    with connection, selectors.DefaultSelector() as selector:
        selector.register(connection, selectors.EVENT_READ)
        selector.register(sys.stdin, selectors.EVENT_READ)
        print("listening", flush=True)
        while True:
            ready = [key.fileobj for key, _ in selector.select()]
            if connection in ready:
                notes += _from_socketcan(connection) if by_kernel else lines.take(connection.recv(1 << 16))
            elif sys.stdin in ready:
                break
    np.save(path, np.array(notes, FRAME))


if __name__ == "__main__":
    main()
