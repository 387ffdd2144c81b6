"""``python -m tests.benchmarks.bench.flood CYCLES``: a socketcand gateway whose drives answer as fast as one listens.

Prints its port. After a client's first frame it sends so many cycles: SYNC, then TPDO1 and TPDO2 of `NODES`; then it
waits for the client to go, and for the next one.
"""

import socket
import struct
import sys

from drivers.canopen.frames import SYNC, TPDO1, TPDO2

NODES = (1, 2, 3, 4, 5, 6)
ENABLED = 0x0027
AT_ONCE = 50  # cycles


def line(identifier: int, data: bytes) -> bytes:
    return f"< frame {identifier:03X} 1.000000 {data.hex().upper()} >".encode()


def cycle(number: int) -> bytes:
    """What is on the bus in one, with counters from 1."""
    frames = [line(SYNC, b"")]
    for node in NODES:
        frames.append(line(TPDO1 + node, struct.pack("<Hih", ENABLED, 500 + number % 7, number % 100)))
        frames.append(line(TPDO2 + node, struct.pack("<iI", 1000 + number, number + 1)))
    return b"".join(frames)


def serve(client: socket.socket, cycles: list[bytes]) -> None:
    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    for told, asked in ((b"< hi >", b"< open can0 >"), (b"< ok >", b"< rawmode >")):
        client.sendall(told)
        if client.recv(len(asked), socket.MSG_WAITALL) != asked:
            return
    client.sendall(b"< ok >")
    if client.recv(64):
        for many in cycles:
            client.sendall(many)
        while client.recv(4096):
            pass


def main() -> None:
    count = int(sys.argv[1])
    cycles = [b"".join(cycle(n) for n in range(k, min(k + AT_ONCE, count))) for k in range(0, count, AT_ONCE)]
    with socket.create_server(("127.0.0.1", 0)) as listener:
        print(listener.getsockname()[1], flush=True)
        while True:
            client, _ = listener.accept()
            with client:
                try:
                    serve(client, cycles)
                except (BrokenPipeError, ConnectionResetError):
                    continue


if __name__ == "__main__":
    main()
