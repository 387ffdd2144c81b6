"""python-can's socketcand client, opened on a bus where others already speak.

python-can 4.6 takes its handshake's answers with whatever follows them, and refuses a gateway whose first frames come
in the same packet as the last "< ok >". Here each answer is read to its length and what follows stays for the reader.
"""

import socket
from typing import Any, cast

import can
from can.interfaces.socketcand import SocketCanDaemonBus

ANSWER_TIMEOUT = 10.0  # s, for each answer of the handshake


class SocketcandBus(SocketCanDaemonBus):
    """As its parent; CanError where the gateway answers otherwise or not in time, and then nothing stays open."""

    def _expect_msg(self, msg: str) -> None:
        connection = cast(socket.socket, cast(Any, self)._SocketCanDaemonBus__socket)
        connection.settimeout(ANSWER_TIMEOUT)
        try:
            answer = _exactly(connection, len(msg)).decode("ascii", "replace")
        except OSError as error:
            connection.close()
            raise can.CanError(f"no '{msg}' from the gateway: {error}") from None
        if answer != msg:
            connection.close()
            raise can.CanError(f"Expected '{msg}' got: '{answer}'")
        connection.settimeout(None)


def _exactly(connection: socket.socket, length: int) -> bytes:
    """So many bytes, fewer where the gateway closes."""
    received = b""
    while len(received) < length and (more := connection.recv(length - len(received))):
        received += more
    return received
