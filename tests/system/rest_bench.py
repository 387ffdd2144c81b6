"""A virtual machine and a service in processes of their own, and what a test does with them through REST."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Any

import psutil
import yaml

from service.web.client import Json, ServiceClient, ServiceProblem

CONFIG = Path(__file__).parents[2] / "config"
ROBOT = CONFIG / "robots" / "max100-class.yaml"
SCENARIO = CONFIG / "scenarios" / "max100-full.yaml"
SWEEPID = str(Path(sys.executable).with_name("sweepid"))
PATIENCE = 180.0  # s for anything on a busy computer
PATIENT_LEASE = 30.0  # s: a disk that others use may take long over a renewal
SHORT_LEASE = 16.0  # s, where a service is killed and started again: it waits for so long
SYNC_PERIOD = 0.008  # s: half the rate of the default, which a computer that does other work cannot always keep


class Fieldbus(Enum):
    """How the machine is reached."""

    CANOPEN = "canopen"
    MODBUS_TCP = "modbus-tcp"


class VirtualMachine:
    """`sweepid drive`, its control port, and a profile that leads to it; its power may fail and come back."""

    def __init__(self, folder: Path, command: list[str], fieldbus: Fieldbus) -> None:
        self._command, self._port = command, 0
        self.power_on()
        if fieldbus is Fieldbus.CANOPEN:
            content = yaml.safe_load((CONFIG / "drives" / "virtual-max100.yaml").read_text("utf-8"))
            content["bus"] |= {"port": self._port, "sync_period": SYNC_PERIOD}
            content["eds"] = str(CONFIG / "eds" / "virtual-axis.eds")
        else:
            content = yaml.safe_load((CONFIG / "drives" / "virtual-max100-modbus-tcp.yaml").read_text("utf-8"))
            content["line"]["port"] = self._port
            content["registers"] = str(CONFIG / "registers" / "virtual-high-first.yaml")
        self.profile = folder / "profile.yaml"
        self.profile.write_text(yaml.safe_dump(content), "utf-8")

    def power_on(self, scenario: Path | None = None) -> None:
        """Start the drives, on the port they had before if they ran already; returns when they answer.

        `scenario`: what the machine is from now on.
        """
        if scenario is not None:
            self._command[self._command.index("--scenario") + 1] = str(scenario)
        command = [*self._command, "--port", str(self._port)]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        ready = json.loads(self._process.stdout.readline() if self._process.stdout else b"")
        self._port, self._control_port = int(ready["port"]), int(ready["control_port"])

    def power_off(self, how: signal.Signals = signal.SIGKILL) -> None:
        """End the drives, without a word to anybody unless `how` is a kinder signal."""
        self._process.send_signal(how)
        self._process.wait(PATIENCE)
        if self._process.stdout:
            self._process.stdout.close()

    def order(self, order: str, **details: object) -> Json:
        """What the control port answers to an order."""
        with socket.create_connection(("127.0.0.1", self._control_port), timeout=PATIENCE) as client:
            client.sendall(json.dumps({"order": order, **details}).encode() + b"\n")
            with client.makefile() as lines:
                return json.loads(lines.readline())

    def axes(self) -> dict[str, dict[str, Any]]:
        """How the axes really are, whatever the service believes."""
        return self.order("status")["axes"]

    def stands(self) -> bool:
        """No axis has energy, none moves."""
        return not any(axis["energised"] or abs(axis["velocity"]) > 1e-6 for axis in self.axes().values())


class Service:
    """`sweepid serve` on a data directory; may be killed and started again."""

    def __init__(self, folder: Path, profile: Path, lease_time: float = PATIENT_LEASE, **settings_too: object) -> None:
        """`lease_time`: s that a busy disk may take; also what a service that follows on a killed one waits for."""
        self.data = folder / "data"
        self._log = folder / "service.log"
        self._settings = folder / "service.yaml"
        settings = {
            "data_dir": str(self.data),
            "drive": str(profile),
            "robots_dir": str(CONFIG / "robots"),
            "cells_dir": str(CONFIG / "cells"),
            "virtual_machine": True,
            "lease_time": lease_time,
            **settings_too,
        }
        self._settings.write_text(yaml.safe_dump(settings), "utf-8")
        self._process: subprocess.Popen[bytes] | None = None
        self.url = ""

    def start(self) -> str:
        """Start and wait until it is ready; its address."""
        command = [SWEEPID, "serve", "--config", str(self._settings), "--port", "0"]
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log)
        line = self._process.stdout.readline() if self._process.stdout else b""
        if not line:
            raise RuntimeError(self._log.read_text("utf-8"))
        self.url = str(json.loads(line)["url"])
        return self.url

    def workers(self) -> list[psutil.Process]:
        """The identification's processes."""
        children = psutil.Process(self.running().pid).children(recursive=True)
        return [child for child in children if any("spawn_main" in word for word in child.cmdline())]

    def log(self) -> str:
        """What it wrote so far."""
        return self._log.read_text("utf-8")

    def kill(self) -> None:
        """SIGKILL, as a power cut does it: the service and all it has started."""
        service = self.running()
        children = psutil.Process(service.pid).children(recursive=True)
        service.kill()
        for child in children:
            child.kill()
        psutil.wait_procs(children, timeout=10)
        self.end()

    def close(self) -> None:
        """End it in good order."""
        if self._process is not None:
            self._process.terminate()
            code = self.end()
            assert code == 0, self._log.read_text("utf-8")

    @property
    def runs(self) -> bool:
        """Unless it was ended, and not started again."""
        return self._process is not None

    def running(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            raise RuntimeError("the service does not run")
        return self._process

    def end(self) -> int:
        process = self.running()
        code = process.wait(PATIENCE)
        if process.stdout:
            process.stdout.close()
        self._process = None
        return code


@contextmanager
def virtual_machine(
    folder: Path, speed_factor: float = 20.0, fieldbus: Fieldbus = Fieldbus.CANOPEN, scenario: Path = SCENARIO
) -> Iterator[VirtualMachine]:
    command = [SWEEPID, "drive", "--speed-factor", str(speed_factor), "--scenario", str(scenario)]
    command += ["--eds", str(CONFIG / "eds" / "virtual-axis.eds"), "--fieldbus", fieldbus.value]
    machine = VirtualMachine(folder, command, fieldbus)
    try:
        yield machine
    finally:
        machine.power_off(signal.SIGTERM)


@contextmanager
def serving(
    folder: Path, profile: Path, lease_time: float = PATIENT_LEASE, **settings_too: object
) -> Iterator[Service]:
    service = Service(folder, profile, lease_time, **settings_too)
    service.start()
    try:
        yield service
    finally:
        service.close()


def add_plan(client: ServiceClient, **wanted: object) -> int:
    """A plan of the representative robot; its number."""
    robot = next(robot for robot in client.robots() if robot["name"] == "max100-class")
    request: Json = {"robot_id": robot["id"], "varied": ["joint_2", "joint_3"], "step": 15.0}
    return int(client.add_plan(request | wanted)["id"])


def until(condition: Callable[[], object], what: str, patience: float = PATIENCE) -> None:
    """Looks rarely for what takes long: each look is a request to a service that leads a machine meanwhile."""
    began = time.monotonic()
    while not condition():
        waited = time.monotonic() - began
        if waited > patience:
            raise TimeoutError(f"{what}: not within {patience} s")
        time.sleep(min(max(waited / 50, 0.02), 0.1))


def run(*arguments: str, url: str) -> subprocess.CompletedProcess[str]:
    """The console script, against a service."""
    environment = os.environ | {"SWEEPID_URL": url}
    return subprocess.run(
        [SWEEPID, *arguments], capture_output=True, text=True, timeout=120, check=False, env=environment
    )


def release(client: ServiceClient, by: str = "Ada") -> None:
    """Every stop, once the drives have confirmed that they stand."""

    def released() -> bool:
        try:
            client.reset_stop(by, [stop["id"] for stop in client.stops()])
        except ServiceProblem as problem:
            if "is not finished yet" in str(problem):
                return False
            raise
        return True

    until(released, "released")


def differences(one: Any, other: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Relative differences of the numbers in two documents of one shape."""
    if isinstance(one, dict):
        assert one.keys() == other.keys(), path
        for key in one:
            yield from differences(one[key], other[key], f"{path}/{key}")
    elif isinstance(one, list):
        assert len(one) == len(other), path
        for number, (mine, yours) in enumerate(zip(one, other, strict=True)):
            yield from differences(mine, yours, f"{path}/{number}")
    elif isinstance(one, float):
        yield path, abs(one - other) / max(abs(one), abs(other), 1e-12)
    else:
        assert one == other, path
