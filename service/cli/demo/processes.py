"""The processes of the demo: `sweepid drive` and `sweepid serve` on free loopback ports, ended in any case."""

import os
import subprocess
import sys
import threading
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path

import yaml
from pydantic import BaseModel, ConfigDict

from service.model.configuration import read_yaml
from service.model.errors import SweepidError

_MAIN = "from service.cli import main; main()"
_START = 60.0  # s until a process must be ready
_END = 20.0  # s to end by itself after the request


class ProcessFailed(SweepidError):
    """A process of the demo did not start; its log contains the reason."""


class Ready(BaseModel):
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
    return [sys.executable, "-c", _MAIN, *arguments]


def environment() -> dict[str, str]:
    """The environment of this process without settings of another service."""
    return {name: value for name, value in os.environ.items() if not name.startswith("SWEEPID_")}


@contextmanager
def running(arguments: Sequence[str], log: Path) -> Generator[Ready]:
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


def _ready(process: "subprocess.Popen[str]", name: str, log: Path) -> Ready:
    patience = threading.Timer(_START, process.kill)
    patience.start()
    try:
        line = process.stdout.readline() if process.stdout else ""
    finally:
        patience.cancel()
        patience.join()
    try:
        return Ready.model_validate_json(line)
    except ValueError:
        raise ProcessFailed(f"sweepid {name} did not start within {_START:.0f} s; see {log}") from None


def _end(process: "subprocess.Popen[str]") -> None:
    process.terminate()
    try:
        process.wait(_END)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout:
        process.stdout.close()
