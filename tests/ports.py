"""A port of loopback for a server that cannot tell which one it took."""

import random
import socket
from contextlib import suppress

_LOWEST, _HIGHEST = 20_000, 32_000  # below those that the kernel gives to whoever asks for any


def free_port() -> int:
    """Free now, and nobody gets it by asking for any port."""
    while True:
        port = random.SystemRandom().randrange(_LOWEST, _HIGHEST)
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port
