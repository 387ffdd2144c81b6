"""A port of loopback for a server that cannot tell which one it took; orders to the control port of a machine."""

import json
import random
import socket
from contextlib import suppress
from typing import Any

_LOWEST, _HIGHEST = 20_000, 32_000  # below those that the kernel gives to whoever asks for any


def free_port() -> int:
    """Free now, and nobody gets it by asking for any port."""
    while True:
        port = random.SystemRandom().randrange(_LOWEST, _HIGHEST)
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port


def ordered(control_port: int, order: str, **fields: object) -> dict[str, Any]:
    """What a virtual machine answers to an order, which it must carry out."""
    with socket.create_connection(("127.0.0.1", control_port), timeout=180) as client:
        client.sendall(json.dumps({"order": order, **fields}).encode() + b"\n")
        with client.makefile() as lines:
            reply: dict[str, Any] = json.loads(lines.readline())
    assert reply["ok"], reply
    return reply
