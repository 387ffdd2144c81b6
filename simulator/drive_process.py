"""The process of a virtual machine tool."""

import drivers.lean_can  # noqa: F401  # pyright: ignore[reportUnusedImport]

# isort: split
import gc
import json
import logging
import math
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import can
import structlog
import typer

from simulator.hidden import hide as hidden_in
from simulator.machine import Machine
from simulator.modbus.register_map import RegisterMapError, load_register_map
from simulator.scenario import Scenario, ScenarioError, load_scenario
from simulator.virtual_drive import Fieldbus, VirtualDrive


def run_drive(
    scenario: Path,
    eds: Path,
    foreign: Sequence[str] | None,
    fieldbus: Fieldbus,
    *,
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
