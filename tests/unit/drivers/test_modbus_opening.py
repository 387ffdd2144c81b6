"""A Modbus line that cannot be opened says why, for whoever forgot to switch the machine on."""

import socket
from pathlib import Path

import pytest

from drivers.errors import ConnectionFailed
from drivers.modbus.line import Line
from drivers.modbus.profile import RtuLine, TcpLine


def test_nobody_listens() -> None:
    with socket.socket() as bound:  # a port of ours that does not listen
        bound.bind(("127.0.0.1", 0))
        port = bound.getsockname()[1]
        line = Line(TcpLine(transport="tcp", host="127.0.0.1", port=port, timeout=1.0, watchdog=4.0))
        expected = (
            rf"^Modbus tcp 127\.0\.0\.1:{port} could not be opened: Connection refused; check power, cable and address$"
        )
        with pytest.raises(ConnectionFailed, match=expected):
            line.open()


def test_the_name_is_no_host() -> None:
    line = Line(TcpLine(transport="tcp", host="cabinet.invalid", port=502, timeout=1.0, watchdog=4.0))
    with pytest.raises(ConnectionFailed, match=r"cabinet\.invalid:502 could not be opened: .*(resol|know|service)"):
        line.open()


def test_there_is_no_such_device(tmp_path: Path) -> None:
    line = Line(RtuLine(transport="rtu", device=str(tmp_path / "ttyUSB0"), timeout=1.0, watchdog=4.0))
    with pytest.raises(
        ConnectionFailed, match=r"ttyUSB0 could not be opened: .*No such file or directory.*; check power"
    ):
        line.open()


def test_the_device_is_no_serial_line(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    line = Line(RtuLine(transport="rtu", device=str(tmp_path / "file"), timeout=1.0, watchdog=4.0))
    with pytest.raises(
        ConnectionFailed, match=r"file could not be opened: .*Inappropriate ioctl.*; check power, cable and address"
    ):
        line.open()
