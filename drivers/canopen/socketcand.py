"""python-can's socketcand client, for a bus on which other nodes already send.

python-can 4.6 reads each answer of its handshake together with the bytes after it. It refuses a gateway whose first
frames arrive in the same packet as the last "< ok >". Here exactly the answer is read, and the rest stays in the
buffer.
"""

import socket
from typing import Any, cast

import can
from can.interfaces.socketcand import SocketCanDaemonBus

ANSWER_TIMEOUT = 10.0  # s, for each answer of the handshake


class SocketcandBus(SocketCanDaemonBus):
    """As its parent class. Raises CanError, and leaves nothing open, if the gateway gives another answer or is too
    late.
    """

    def _expect_msg(self, msg: str) -> None:
        connection = cast(socket.socket, cast(Any, self)._SocketCanDaemonBus__socket)
        connection.settimeout(ANSWER_TIMEOUT)
        try:
            answer = _exactly(connection, len(msg)).decode("ascii", "replace")
        except OSError as error:
            connection.close()
            raise can.CanError(f"the gateway did not send '{msg}': {error}") from None
        if answer != msg:
            connection.close()
            raise can.CanError(f"Expected '{msg}' got: '{answer}'")
        connection.settimeout(None)


def _exactly(connection: socket.socket, length: int) -> bytes:
    """Read `length` bytes, or fewer if the gateway closes."""
    received = b""
    while len(received) < length and (more := connection.recv(length - len(received))):
        received += more
    return received
