"""`sweepid drive`: a virtual machine tool in a process of its own."""

import json
import logging
import math
import signal
import sys
from pathlib import Path
from typing import Annotated

import can
import structlog
import typer

from simulator.machine import Machine
from simulator.scenario import ScenarioError, load_scenario
from simulator.virtual_drive import VirtualDrive


def drive(
    scenario: Annotated[Path, typer.Option(help="What the machine really is.")] = Path(
        "config/scenarios/max100-full.yaml"
    ),
    eds: Annotated[Path, typer.Option(help="Object dictionary of the axes.")] = Path("config/eds/virtual-axis.eds"),
    bus: Annotated[str, typer.Option(help="socketcand (a server here) or a python-can interface.")] = "socketcand",
    channel: Annotated[str, typer.Option(help="Channel of the bus.")] = "can0",
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the socketcand server; 0 = a free one.")] = 29536,
    control_port: Annotated[int, typer.Option(min=0, max=65535, help="Port for faults to order; 0 = a free one.")] = 0,
    speed_factor: Annotated[
        float, typer.Option(min=0.01, help="Moves and measuring function against real time, as far as the CPU allows.")
    ] = 20.0,
    seed: Annotated[int, typer.Option(help="Of the measurement noise.")] = 0,
    start_pose: Annotated[str, typer.Option(help="Joint positions, rad, comma separated.")] = "",
) -> None:
    """Run a virtual machine: one CiA 402 node an axis on a CAN bus. Ends on SIGTERM or Ctrl-C."""
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(sys.stderr),
    )
    try:
        machine = _machine(scenario, seed, start_pose)
        virtual = VirtualDrive(
            machine,
            _readable(eds),
            bus=bus,
            channel=channel,
            host=host,
            port=port,
            control_port=control_port,
            speed_factor=speed_factor,
        )
    except (ScenarioError, OSError, can.CanError) as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(2) from None

    def stop(_number: int, _frame: object) -> None:
        virtual.stop()

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)
    typer.echo(json.dumps({"ready": True, "port": virtual.port, "control_port": virtual.control_port}))
    try:
        virtual.run()
    finally:
        virtual.close()


def _machine(scenario: Path, seed: int, start_pose: str) -> Machine:
    machine = Machine(load_scenario(scenario), seed)
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


def _readable(path: Path) -> Path:
    if path.suffix != ".eds":
        raise ScenarioError(f"--eds: {path} is not an .eds file")
    path.open().close()
    return path
