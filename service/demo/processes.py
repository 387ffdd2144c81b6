"""The processes of the demo: `sweepid drive` and `sweepid serve` on free loopback ports, ended whatever happens."""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import yaml

from service.configuration import read_text
from service.errors import SweepidError

Json = dict[str, Any]

_MAIN = "from service.cli import main; main()"
_START = 60.0  # s until a process must be ready
_END = 20.0  # s to end by itself once told to


class ProcessFailed(SweepidError):
    """A process of the demo did not start; its log says why."""


def command(*arguments: str) -> list[str]:
    """`sweepid ARGUMENTS` in this interpreter."""
    return [sys.executable, "-c", _MAIN, *arguments]


def environment() -> dict[str, str]:
    """Ours without settings of another service."""
    return {name: value for name, value in os.environ.items() if not name.startswith("SWEEPID_")}


@contextmanager
def running(arguments: Sequence[str], log: Path) -> Generator[Json]:
    """A process that prints one JSON line when it is ready; gives that line. Its other words go to `log`.

    Ctrl-C in the terminal does not reach it: it ends after its clients, in the order in which the blocks are left.
    """
    detached: Json = (
        {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
        if sys.platform == "win32"
        else {"start_new_session": True}
    )
    with log.open("w", encoding="utf-8") as words:
        process = subprocess.Popen(
            command(*arguments), stdout=subprocess.PIPE, stderr=words, text=True, env=environment(), **detached
        )
        try:
            yield _ready(process, arguments[0], log)
        finally:
            _end(process)


def drive_profile(template: Path, port: int, path: Path) -> Path:
    """Write the drive profile `template` for a virtual machine at a port of this host; gives its path."""
    profile = cast("Json", yaml.safe_load(read_text(template)))
    profile["bus"] |= {"host": "127.0.0.1", "port": port}
    profile["eds"] = str((template.parent / profile["eds"]).resolve())
    path.write_text(yaml.safe_dump(profile, sort_keys=False), encoding="utf-8")
    return path


def _ready(process: "subprocess.Popen[str]", name: str, log: Path) -> Json:
    patience = threading.Timer(_START, process.kill)
    patience.start()
    try:
        line = process.stdout.readline() if process.stdout else ""
    finally:
        patience.cancel()
        patience.join()
    try:
        return cast("Json", json.loads(line))
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
