"""What no host would send to the Modbus port of the virtual machine leaves machine and host alone."""

import select
import socket
from typing import Any, cast

import pytest

from drivers.ports import AxisState, DrivePort
from tests.contract.bench import AXIS, Virtual

CUT, UNKNOWN = b"\0\1\0\0\0\6\1\x2b\x0e\1\0", b"\0\1\0\0\0\2\1\x64"


@pytest.mark.parametrize("virtual", ["modbus-tcp"], indirect=True, scope="module")
async def test_hostile_bytes_change_nothing(port: DrivePort, virtual: Virtual) -> None:
    await port.enable(AXIS)
    for data in (b"\0" * 300, b"\xff" * 64, CUT, UNKNOWN, b"GET / HTTP/1.1\r\n\r\n"):
        place = ("127.0.0.1", cast(Any, virtual.profile["line"])["port"])
        with socket.create_connection(place, timeout=5) as client:
            client.sendall(data)
            select.select([client], [], [], 0.05)
    assert (await port.status())[AXIS].state is AxisState.ENABLED
    assert virtual.energised() == [AXIS]
