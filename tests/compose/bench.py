"""docker-compose.yml as its users start it, in a project of its own, and what a test sees of it from outside."""

import json
import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from service.web.client import Json, ServiceClient, ServiceUnreachable
from tests.ports import free_port
from tests.system.rest_bench import until

ROOT = Path(__file__).parents[2]
COMMAND = 120.0  # s

# runs in the machine's container: how the axes stand, line by line, until the machine is gone
_WATCH = """
import socket, time
with socket.create_connection(("127.0.0.1", 29537), 10) as machine, machine.makefile("rw") as talk:
    while True:
        talk.write('{"order": "status"}\\n')
        talk.flush()
        line = talk.readline()
        if not line:
            break
        print(line, end="", flush=True)
        time.sleep(0.02)
"""

Axes = dict[str, Json]


class Watch:
    """How the machine's axes really are, whatever the service believes."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def all(self) -> list[Axes]:
        """Everything seen so far, in order."""
        whole, _, _ = self._path.read_text("utf-8").rpartition("\n")
        return [json.loads(line)["axes"] for line in whole.splitlines()]

    def moves(self) -> bool:
        """An axis does now."""
        return any(abs(axis["velocity"]) > 1e-3 for axis in self.all()[-1].values())


class Containers:
    """A project of docker-compose.yml, from the image that `docker-compose build` has made."""

    def __init__(self, folder: Path, project: str, environment: dict[str, str]) -> None:
        self.folder = folder
        self._environment = os.environ | {"COMPOSE_PROJECT_NAME": project} | environment

    def compose(self, *arguments: str, patience: float = COMMAND) -> str:
        """What `docker-compose ARGUMENTS` prints; RuntimeError with its complaint if it fails."""
        done = subprocess.run(
            ["docker-compose", *arguments],
            cwd=ROOT,
            env=self._environment,
            capture_output=True,
            text=True,
            timeout=patience,
            check=False,
        )
        if done.returncode:
            raise RuntimeError(f"docker-compose {arguments}: {done.stdout[-4000:]}{done.stderr[-4000:]}")
        return done.stdout

    def numbers(self, *services: str) -> list[str]:
        """Of the containers of services, running or not; of all."""
        return self.compose("ps", "--all", "--quiet", *services).split()

    def inspect(self, service: str) -> Json:
        """What the engine knows of a container, running or not."""
        (number,) = self.numbers(service)
        return inspected(number)

    @contextmanager
    def watched(self, machine: str = "machine") -> Iterator[Watch]:
        """Look at the machine itself, beside the service, as long as it runs."""
        path = self.folder / f"watch-{time.monotonic_ns()}.jsonl"
        command = ["docker-compose", "exec", "-T", machine, "python3", "-c", _WATCH]
        with (
            path.open("w") as lines,
            subprocess.Popen(
                command, cwd=ROOT, env=self._environment, stdin=subprocess.DEVNULL, stdout=lines
            ) as watching,
        ):
            try:
                watch = Watch(path)
                until(watch.all, "the machine tells how it stands")
                yield watch
            finally:
                watching.terminate()

    def remove(self) -> None:
        """Containers, network and data."""
        print(self.compose("logs", "--no-color", "--tail", "200"))  # shown when the test has failed
        self.compose("down", "--volumes")


class Cell(Containers):
    """What starts without a profile."""

    def __init__(self, folder: Path) -> None:
        port = free_port()
        super().__init__(folder, "sweepid-test", {"SWEEPID_PORT": str(port)})
        self.url = f"http://127.0.0.1:{port}"

    def up(self) -> None:
        """Start, and wait until it could measure."""
        self.compose("up", "--detach", "--no-build")
        with ServiceClient(self.url) as client:
            until(lambda: ready(client), "the cell is ready")


def inspected(number: str) -> Json:
    """What the engine knows of a container."""
    done = subprocess.run(["docker", "inspect", number], capture_output=True, timeout=COMMAND, check=True)
    return json.loads(done.stdout)[0]


def stands(axes: Axes) -> bool:
    """No axis has energy, none moves."""
    return not any(axis["energised"] or abs(axis["velocity"]) > 1e-6 for axis in axes.values())


def positions(axes: Axes) -> dict[str, float]:
    return {joint: axis["position"] for joint, axis in axes.items()}


def ready(client: ServiceClient) -> bool:
    try:
        return bool(client.ready()["ready"])
    except ServiceUnreachable:
        return False
