"""`sweepid drive`: a virtual machine tool in a process of its own. Declared without importing the plant."""

from pathlib import Path
from typing import Annotated, Literal

import typer


def drive(
    scenario: Annotated[Path, typer.Option(help="Scenario: true parameters of the machine.")] = Path(
        "config/scenarios/max100-full.yaml"
    ),
    eds: Annotated[Path, typer.Option(help="Object dictionary of the axes.")] = Path("config/eds/virtual-axis.eds"),
    foreign: Annotated[
        list[str] | None,
        typer.Option(help="CANopen: EDS or DCF of another drive, replaces --eds; JOINT=FILE for one axis."),
    ] = None,
    fieldbus: Annotated[
        Literal["canopen", "modbus-tcp", "modbus-rtu"], typer.Option(help="Fieldbus of the machine.")
    ] = "canopen",
    bus: Annotated[
        str, typer.Option(help="CANopen: socketcand (a server here) or a python-can interface.")
    ] = "socketcand",
    channel: Annotated[str, typer.Option(help="CANopen: channel of the bus.")] = "can0",
    registers: Annotated[Path, typer.Option(help="Modbus: register map of the drives.")] = Path(
        "config/registers/virtual-high-first.yaml"
    ),
    device: Annotated[
        str, typer.Option(help="Modbus RTU: serial device; pty = a pseudo-terminal, printed when ready.")
    ] = "pty",
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
        int | None, typer.Option(min=0, help="Seed of one effect to hide; shown by `sweepid drive truth`.")
    ] = None,
    start_pose: Annotated[str, typer.Option(help="Joint positions, rad, comma separated.")] = "",
) -> None:
    """Run a virtual machine: one CiA 402 drive per axis on CAN or Modbus. Ends on SIGTERM or Ctrl-C."""
    options = locals()
    from simulator.virtual_drive import run_drive

    run_drive(**options)
