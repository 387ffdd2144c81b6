"""The processes of the demo: `sweepid drive` and `sweepid serve` on free loopback ports, ended in any case."""

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import yaml
from pydantic import BaseModel, ConfigDict

from service import SweepidError
from service.model import Robot
from service.model.configuration import read_yaml
from service.web.client import HOST_WATCH, Json, ServiceClient, ServiceProblem


class ReadyLine(BaseModel):
    """The line of a process that is ready: `url` of the service, `hidden_in`: joint with a hidden effect."""

    model_config = ConfigDict(frozen=True, extra="ignore")
    port: int
    url: str = ""
    hidden_in: str = ""


class _Bus(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")
    host: str
    port: int


class _Profile(BaseModel):
    """The fields of a drive profile that the demo changes; the others are unchanged."""

    model_config = ConfigDict(frozen=True, extra="allow")
    eds: Path
    bus: _Bus


def command(*arguments: str) -> list[str]:
    """`sweepid ARGUMENTS` in this interpreter."""
    return [sys.executable, "-c", "from service.cli import main; main()", *arguments]


def environment() -> dict[str, str]:
    """The environment of this process without settings of another service."""
    return {name: value for name, value in os.environ.items() if not name.startswith("SWEEPID_")}


def answer_of_drive(*arguments: str) -> str:
    """What `sweepid drive ARGUMENTS` prints. SweepidError if it fails."""
    answer = subprocess.run(
        command("drive", *arguments), capture_output=True, text=True, env=environment(), timeout=600.0, check=False
    )
    if answer.returncode:
        raise SweepidError(f"sweepid drive {arguments[0]}: {answer.stderr.strip()}")
    return answer.stdout


@contextmanager
def running(arguments: Sequence[str], log: Path) -> Generator[ReadyLine]:
    """A process that prints one JSON line when it is ready; returns that line. Its stderr goes to `log`.

    Ctrl-C in the terminal does not reach it: it ends after its clients, in the order in which the blocks are left.
    """
    group = subprocess.CREATE_NEW_PROCESS_GROUP if sys.platform == "win32" else 0
    with log.open("w", encoding="utf-8") as words:
        process = subprocess.Popen(
            command(*arguments),
            stdout=subprocess.PIPE,
            stderr=words,
            text=True,
            env=environment(),
            creationflags=group,
            start_new_session=sys.platform != "win32",
        )
        try:
            yield _ready(process, arguments[0], log)
        finally:
            _end(process)


def drive_profile(template: Path, port: int, path: Path) -> Path:
    """Write the drive profile `template` for a virtual machine at a port of this host; returns its path."""
    profile = read_yaml(template, _Profile)
    bus = profile.bus.model_copy(update={"host": "127.0.0.1", "port": port})
    here = profile.model_copy(update={"bus": bus, "eds": (template.parent / profile.eds).resolve()})
    path.write_text(yaml.safe_dump(here.model_dump(mode="json"), sort_keys=False), encoding="utf-8")
    return path


def _ready(process: "subprocess.Popen[str]", name: str, log: Path, within: float = 60.0) -> ReadyLine:
    """The first line of a process, which must come `within` s."""
    patience = threading.Timer(within, process.kill)
    patience.start()
    try:
        line = process.stdout.readline() if process.stdout else ""
    finally:
        patience.cancel()
        patience.join()
    try:
        return ReadyLine.model_validate_json(line)
    except ValueError:
        raise SweepidError(f"sweepid {name} did not start within {within:.0f} s; see {log}") from None


def _end(process: "subprocess.Popen[str]") -> None:
    process.terminate()
    try:
        process.wait(20.0)  # s to end by itself
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout:
        process.stdout.close()


class CampaignFailed(SweepidError):
    """The campaign was not completed; the message gives the reason."""


@dataclass(frozen=True)
class Operator:
    """`progress` is called with the campaign at each event, `say` with notes for the log."""

    client: ServiceClient
    progress: Callable[[Json], None]
    say: Callable[[str], None]

    def run(self, campaign_id: int) -> None:
        """Run a campaign until its last sweep is identified. Any other end stops the machine first."""
        with self._stopping():
            self.client.start(campaign_id)
            self._until_completed(campaign_id)

    def watch(self, campaign_id: int) -> None:
        """The same for a campaign that was already started."""
        with self._stopping():
            self._until_completed(campaign_id)

    @contextmanager
    def _stopping(self) -> Generator[None]:
        try:
            yield
        except BaseException as error:
            try:
                self.client.stop("sweepid demo", type(error).__name__)
            except SweepidError as unconfirmed:  # must not hide the error that ended the campaign
                self.say(str(unconfirmed))
            raise

    def _until_completed(self, campaign_id: int) -> None:
        troubles = 0
        for _ in self.client.events(campaign_id):
            campaign = self.client.campaign(campaign_id)
            self.progress(campaign)
            if campaign["state"] == "completed":
                return
            if campaign["state"] == "aborted":
                raise CampaignFailed(f"campaign {campaign_id} was aborted: {campaign['cause']}")
            if campaign["state"] == "paused":
                troubles += 1
                if troubles > 3:  # faults that are acknowledged before giving up
                    raise CampaignFailed(
                        f"campaign {campaign_id} paused for the {troubles}th time: {campaign['cause']}"
                    )
                self.say(f"{campaign['cause']} - checked, acknowledged, sweep repeated")
                self._clear(campaign_id)

    def _clear(self, campaign_id: int) -> None:
        """React to a fault as an operator: check, acknowledge, continue with the failed sweep.

        Continuing reconnects first if the connection was lost; a fault found then is another fault. A stop of the host
        watch (this computer was suspended) is released; a stop that a person pressed is not.
        """
        watched = [stop["id"] for stop in self.client.stops() if stop["by"] == HOST_WATCH]
        if watched:
            self.client.reset_stop("sweepid demo", watched)
        for axis in self.client.drives()["axes"]:
            if axis["fault"] is not None:
                self.client.acknowledge(axis["joint"])
        try:
            self.client.resume(campaign_id, repeat=True)
        except ServiceProblem as problem:
            raise CampaignFailed(f"campaign {campaign_id} cannot go on: {problem}") from None


PROFILE = Path("config/drives/virtual-max100.yaml")
ROBOT = Path("config/robots/max100-class.yaml")
CELL = Path("config/cells/workshop.yaml")


@dataclass(frozen=True)
class VirtualCell:
    """`machine` is the line it printed when it was ready."""

    machine: ReadyLine
    client: ServiceClient
    robot_id: int


@contextmanager
def virtual_cell(folder: Path, robot: Robot, scenario: Path, *options: str) -> Generator[VirtualCell]:
    """Machine and service, started, and ended in any case; they write into `folder`. `options`: of the machine."""
    drive = ("drive", "--scenario", str(scenario), "--port", "0", "--speed-factor", "20", *options)
    with running(drive, folder / "drive.log") as drives:
        profile = drive_profile(PROFILE, drives.port, folder / "drives.yaml")
        serve = ("serve", "--port", "0", "--data-dir", str(folder / "data"), "--drive", str(profile))
        serve += ("--robot", ROBOT.stem, "--cell", CELL.stem)
        with running(serve, folder / "serve.log") as service, ServiceClient(service.url) as client:
            stored = client.add_robot(robot.description.model_dump(mode="json"), robot.urdf_text)
            yield VirtualCell(drives, client, int(stored["id"]))
