"""`sweepid drive`: a virtual machine tool in a process of its own."""

import simulator.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
import gc
import json
import logging
import math
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import can
import structlog
import typer

from simulator.hidden import hide as hidden_in
from simulator.machine import Machine
from simulator.modbus.pty_pair import PTY
from simulator.modbus.register_map import RegisterMapError, load_register_map
from simulator.scenario import Scenario, ScenarioError, load_scenario
from simulator.virtual_drive import Fieldbus, VirtualDrive


def drive(
    scenario: Annotated[Path, typer.Option(help="Scenario: true parameters of the machine.")] = Path(
        "config/scenarios/max100-full.yaml"
    ),
    eds: Annotated[Path, typer.Option(help="Object dictionary of the axes.")] = Path("config/eds/virtual-axis.eds"),
    foreign: Annotated[
        list[str] | None,
        typer.Option(help="CANopen: EDS or DCF of another drive, replaces --eds; JOINT=FILE for one axis."),
    ] = None,
    fieldbus: Annotated[Fieldbus, typer.Option(help="Fieldbus of the machine.")] = Fieldbus.CANOPEN,
    bus: Annotated[
        str, typer.Option(help="CANopen: socketcand (a server here) or a python-can interface.")
    ] = "socketcand",
    channel: Annotated[str, typer.Option(help="CANopen: channel of the bus.")] = "can0",
    registers: Annotated[Path, typer.Option(help="Modbus: register map of the drives.")] = Path(
        "config/registers/virtual-high-first.yaml"
    ),
    device: Annotated[
        str, typer.Option(help=f"Modbus RTU: serial device; {PTY} = a pseudo-terminal, printed when ready.")
    ] = PTY,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the socketcand or Modbus TCP server; 0 = a free one.")
    ] = 29536,
    control_port: Annotated[int, typer.Option(min=0, max=65535, help="Port for fault injection; 0 = a free one.")] = 0,
    speed_factor: Annotated[
        float, typer.Option(min=0.01, help="Speed of moves and measuring function relative to real time.")
    ] = 20.0,
    seed: Annotated[int, typer.Option(help="Seed of the measurement noise.")] = 0,
    hide: Annotated[
        int | None, typer.Option(min=0, help="Seed of one effect to hide in the machine; shown by `sweepid truth`.")
    ] = None,
    start_pose: Annotated[str, typer.Option(help="Joint positions, rad, comma separated.")] = "",
) -> None:
    """Run a virtual machine: one CiA 402 drive per axis on CAN or Modbus. Ends on SIGTERM or Ctrl-C."""
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # invalid frames of others are not logged
    try:
        really, hidden = load_scenario(scenario), None
        if hide is not None:
            really, hidden = hidden_in(really, hide)
        machine = _machine(really, seed, start_pose)
        virtual = VirtualDrive(
            machine,
            _foreign(machine.joints, foreign) if foreign else _readable("--eds", eds, ".eds"),
            fieldbus=fieldbus,
            bus=bus,
            channel=channel,
            registers=None if fieldbus is Fieldbus.CANOPEN else load_register_map(registers),
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
        "fieldbus": fieldbus.value,
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


def _machine(scenario: Scenario, seed: int, start_pose: str) -> Machine:
    machine = Machine(scenario, seed)
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
