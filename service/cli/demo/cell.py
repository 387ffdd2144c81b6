"""A virtual machine and its service in separate processes, with the representative robot stored in the service."""

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from service.cli.demo.processes import Ready, drive_profile, running
from service.model.robot import Robot
from service.web.client import ServiceClient

PROFILE = Path("config/drives/virtual-max100.yaml")
ROBOT = Path("config/robots/max100-class.yaml")
CELL = Path("config/cells/workshop.yaml")
SPEED_FACTOR = "20"  # of the virtual machine's moves and drive-side sweeps


@dataclass(frozen=True)
class VirtualCell:
    """`machine` is the line it printed when it was ready."""

    machine: Ready
    client: ServiceClient
    robot_id: int


@contextmanager
def virtual_cell(folder: Path, robot: Robot, scenario: Path, *options: str) -> Generator[VirtualCell]:
    """Machine and service, started, and ended in any case; they write into `folder`. `options`: of the machine."""
    drive = ("drive", "--scenario", str(scenario), "--port", "0", "--speed-factor", SPEED_FACTOR, *options)
    with running(drive, folder / "drive.log") as drives:
        profile = drive_profile(PROFILE, drives.port, folder / "drives.yaml")
        serve = ("serve", "--port", "0", "--data-dir", str(folder / "data"), "--drive", str(profile))
        serve += ("--robot", ROBOT.stem, "--cell", CELL.stem)
        with running(serve, folder / "serve.log") as service, ServiceClient(service.url) as client:
            stored = client.add_robot(robot.description.model_dump(mode="json"), robot.urdf_text)
            yield VirtualCell(drives, client, int(stored["id"]))
