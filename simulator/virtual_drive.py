"""The process of a virtual machine tool: one thread owns machine, nodes and sockets and handles events in order."""

import drivers.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
import gc
import json
import logging
import math
import selectors
import signal
import socket
import sys
import time
from collections.abc import Mapping, Sequence
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

import can
import structlog
import typer

from simulator.canopen.line import CanLine
from simulator.control import ControlServer
from simulator.hidden import hide as hidden_in
from simulator.machine import LiveMachine
from simulator.modbus.registers import RegisterLayout, RegisterMapError, load_register_map
from simulator.scenario import Scenario, ScenarioError, load_scenario

# isort: split


if TYPE_CHECKING:
    from simulator.modbus.line import ModbusLine


class FieldbusKind(Enum):
    """Fieldbus of the virtual machine."""

    CANOPEN = "canopen"
    MODBUS_TCP = "modbus-tcp"
    MODBUS_RTU = "modbus-rtu"


class VirtualDrive:
    """A machine on a fieldbus, and its control port at `host`. `run` blocks until `stop`; call `close` afterwards.

    CANopen: socketcand at `host`:`port`, or any other python-can interface `bus` with its `channel`. Modbus, with
    the map `registers`: TCP at `host`:`port`, RTU at the serial `device` ("pty": a pseudo-terminal created here).
    `eds` by joint: drives of other manufacturers, only on CANopen. Raises OSError or can.CanError if line or port
    cannot be opened, and ScenarioError for an EDS that this drive does not support.
    """

    def __init__(
        self,
        machine: LiveMachine,
        eds: Path | Mapping[str, Path],
        *,
        fieldbus: FieldbusKind = FieldbusKind.CANOPEN,
        bus: str = "socketcand",
        channel: str = "can0",
        registers: RegisterLayout | None = None,
        device: str = "pty",
        host: str = "127.0.0.1",
        port: int = 0,
        control_port: int = 0,
        speed_factor: float = 1.0,
    ) -> None:
        # select(2) has microsecond resolution; a millisecond of epoll is 20 ms of a machine at factor 20.
        self._selector = selectors.SelectSelector()
        self._wake, self._woken = socket.socketpair()
        self._stopping = False
        self._selector.register(self._woken, selectors.EVENT_READ, self._awake)
        self._line: CanLine | ModbusLine
        if fieldbus is FieldbusKind.CANOPEN:
            self._line = CanLine(
                self._selector, machine, eds, speed_factor, bus=bus, channel=channel, host=host, port=port
            )
        elif registers is None or not isinstance(eds, Path):
            raise ValueError("registers, eds: Modbus needs a register map and the virtual drive's own EDS")
        else:
            where = device if fieldbus is FieldbusKind.MODBUS_RTU else (host, port)
            self._line = _modbus_line(self._selector, machine, eds, speed_factor, registers, where)
        self.cabinet = self._line.cabinet
        self._control = ControlServer(self._selector, host, control_port, self.cabinet, self._line.bus)

    @property
    def port(self) -> int | None:
        """Port of the socketcand or Modbus TCP server; None on any other line."""
        return self._line.port

    @property
    def device(self) -> str | None:
        """Path of the serial line for the host; None on any other line."""
        return self._line.device

    @property
    def control_port(self) -> int:
        return self._control.port

    def run(self) -> None:
        """Power on and serve until `stop`."""
        self.cabinet.boot()
        while not self._stopping:
            now = time.monotonic()
            for key, mask in self._selector.select(min(self.cabinet.due(now), self._line.due(now), 1.0)):
                key.data(mask)
            now = time.monotonic()
            self._line.run(now)
            self.cabinet.run(now)

    def stop(self) -> None:
        """End `run`; from any thread or signal handler."""
        self._stopping = True
        self._wake.send(b"\0")

    def close(self) -> None:
        self._control.close()
        self._line.close()
        self._selector.close()
        self._wake.close()
        self._woken.close()

    def _awake(self, _: int) -> None:
        self._woken.recv(64)


def _modbus_line(
    selector: selectors.BaseSelector,
    machine: LiveMachine,
    eds: Path,
    speed_factor: float,
    registers: RegisterLayout,
    where: str | tuple[str, int],
) -> "ModbusLine":
    """On a serial device, or at a host and port. Imported here: pymodbus imports aiohttp, which CAN does not need."""
    from simulator.modbus.line import ModbusLine, SerialLine, TcpLine

    line = SerialLine(where) if isinstance(where, str) else TcpLine(*where)
    return ModbusLine(selector, machine, eds, speed_factor, registers=registers, line=line)


# isort: split


def run_drive(
    *,
    scenario: Path,
    eds: Path,
    foreign: Sequence[str] | None,
    fieldbus: str,
    bus: str,
    channel: str,
    registers: Path,
    device: str,
    host: str,
    port: int,
    control_port: int,
    speed_factor: float,
    seed: int,
    hide: int | None,
    start_pose: str,
) -> None:
    """Run until SIGTERM or Ctrl-C; one JSON line on stdout when it is ready. typer.Exit(2) for bad input."""
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # invalid frames of others are not logged
    kind = FieldbusKind(fieldbus)
    try:
        really, hidden = load_scenario(scenario), None
        if hide is not None:
            really, hidden = hidden_in(really, hide)
        machine = _machine(really, seed, start_pose)
        virtual = VirtualDrive(
            machine,
            _foreign(machine.joints, foreign) if foreign else _readable("--eds", eds, ".eds"),
            fieldbus=kind,
            bus=bus,
            channel=channel,
            registers=None if kind is FieldbusKind.CANOPEN else load_register_map(registers),
            device=device,
            host=host,
            port=port,
            control_port=control_port,
            speed_factor=speed_factor,
        )
    except (ScenarioError, RegisterMapError, OSError, can.CanError) as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from None

    def stop(_number: int, _frame: object) -> None:
        virtual.stop()

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    ready: dict[str, object] = {
        "ready": True,
        "fieldbus": fieldbus,
        "port": virtual.port,
        "control_port": virtual.control_port,
    }
    if virtual.device is not None:
        ready["device"] = virtual.device
    if hidden is not None:
        ready["hidden_in"] = hidden.joint
    gc.freeze()  # these objects live until the end; their collection would delay the drives
    typer.echo(json.dumps(ready))
    try:
        virtual.run()
    finally:
        virtual.close()


def _machine(scenario: Scenario, seed: int, start_pose: str) -> LiveMachine:
    machine = LiveMachine(scenario, seed)
    if start_pose:
        try:
            pose = [float(value) for value in start_pose.split(",")]
        except ValueError:
            raise ScenarioError(f"--start-pose: {start_pose!r} is not a list of numbers") from None
        if not all(math.isfinite(position) for position in pose):
            raise ScenarioError(f"--start-pose: {start_pose!r} holds what is not finite")
        if len(pose) != len(machine.joints):
            raise ScenarioError(f"--start-pose: {len(pose)} positions for {len(machine.joints)} joints")
        for joint, position in zip(machine.joints, pose, strict=True):
            machine.set_position(joint, position)
    return machine


def _foreign(joints: Sequence[str], options: Sequence[str]) -> dict[str, Path]:
    """The file of each joint's drive: its own, otherwise the common one."""
    files: dict[str, Path] = {}
    for option in options:
        joint, equals, name = option.rpartition("=")
        if equals and joint not in joints:
            raise ScenarioError(f"--foreign: {joint!r} is not one of {', '.join(joints)}")
        files[joint] = _readable("--foreign", Path(name), ".eds", ".dcf")
    return {joint: files[joint] if joint in files else files[""] for joint in joints if joint in files or "" in files}


def _readable(option: str, path: Path, *suffixes: str) -> Path:
    if path.suffix not in suffixes:
        raise ScenarioError(f"{option}: {path} is not an {' or '.join(suffixes)} file")
    path.open().close()
    return path
