"""A socketcand gateway on a bus where others already speak, and one that answers otherwise."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from drivers.canopen import frames, socketcand
from drivers.canopen.bus import Bus
from drivers.canopen.profile import BusProfile
from drivers.contract.bench import eventually
from drivers.errors import ConnectionFailed

HEARTBEAT = b"< frame 701 12.5 7F >"


@contextmanager
def gateway(answers: list[bytes]) -> Iterator[int]:
    """Its port. It says each answer in one packet, after a request of any kind, and stays until the host goes."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            server.accept()[0].close()  # the host asks first whether anybody is there
            connection, _ = server.accept()
            with connection:
                for answer in answers:
                    connection.sendall(answer)
                    if not connection.recv(256):
                        return
                while connection.recv(256):
                    pass

        thread = threading.Thread(target=serve)
        thread.start()
        yield server.getsockname()[1]
        thread.join(20)
        assert not thread.is_alive()


def profile(port: int) -> BusProfile:
    return BusProfile(interface="socketcand", channel="can0", host="127.0.0.1", port=port)


async def test_frames_in_the_packet_of_the_last_answer_are_frames() -> None:
    with gateway([b"< hi >", b"< ok >", b"< ok >" + HEARTBEAT + b"< frame 081 12.6 0010000000000000 >"]) as port:
        bus = Bus(profile(port), (1,))
        try:
            await eventually(lambda: bus.emergency(1) is not None)
            bus.send(frames.SYNC, b"")
        finally:
            bus.close()


@pytest.mark.parametrize("answers", [[b"< hi >", b"< no >"], [b"< hi >", b"< o"], [b"hello!"]])
def test_a_gateway_that_answers_otherwise_is_refused_and_nothing_stays_open(
    answers: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(socketcand, "ANSWER_TIMEOUT", 0.5)
    with (
        gateway(answers) as port,
        pytest.raises(ConnectionFailed, match=r"could not be opened: (Expected|the gateway did not send) '< "),
    ):
        Bus(profile(port), (1,))
