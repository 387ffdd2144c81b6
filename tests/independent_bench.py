"""Machines of CANopen stacks that share nothing with this project: a process, and the drive profile that leads to it.

The process is started with its bus (`socketcand`, or the number of an open SocketCAN socket) and its modes. It prints
one line of JSON when it is ready: `port` of its socketcand server (null on a kernel's bus), `control_port`, the `eds`
that its stack wrote, `identity` (vendor, product, revision), `gear`, `rated` (N m of the motor) and the `inertias` of
its plants (kg m^2, by joint).
"""

import json
import signal
import socket
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.contract.makers import PATIENCE
from tests.node_canopen.install import node_command

ROOT = Path(__file__).resolve().parents[1]
DEVICE = ROOT / "config" / "devices" / "plain-402.yaml"
SYNC_PERIOD = 0.008  # s
CHANNEL = "vcan0"
STACKS: dict[str, Callable[[], list[str]]] = {
    "durand": lambda: [sys.executable, "-m", "tests.durand_nodes"],
    "node-canopen": node_command,
}


@dataclass(frozen=True)
class IndependentMachine:
    """A running machine; `profile` is that of a plain CiA 402 drive, with the EDS that the stack wrote."""

    profile: dict[str, Any]
    control_port: int
    inertias: dict[str, float]  # of the plant, kg m^2
    process: subprocess.Popen[bytes]


@contextmanager
def machine(
    stack: str, modes: str = "csv", *, bus: str = "socketcand", sync_period: float = SYNC_PERIOD, device: Path = DEVICE
) -> Iterator[IndependentMachine]:
    """`stack` of `STACKS`; `modes` as in the objects of the stack; `bus`: `socketcand`, or `socketcan` for vcan0."""
    with ExitStack() as stacked:
        folder = Path(stacked.enter_context(tempfile.TemporaryDirectory()))
        files: list[int] = []
        if bus == "socketcan":
            files = [stacked.enter_context(kernel_socket()).fileno()]
        command = [*STACKS[stack](), str(files[0]) if files else "socketcand", modes]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT, pass_fds=files)
        stacked.enter_context(process)
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line, f"{' '.join(command)} ended before it was ready"
            ready = json.loads(line)
            eds = folder / "drive.eds"
            eds.write_text(ready["eds"])
            content = profile(ready, eds, device, sync_period)
            yield IndependentMachine(content, ready["control_port"], ready["inertias"], process)
        finally:
            process.terminate()
    assert process.returncode in (0, -signal.SIGKILL)


def kernel_socket() -> socket.socket:
    """A raw SocketCAN socket on vcan0. A read returns after 0.2 s at the latest, so the process can end."""
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, struct.pack("@ll", 0, 200_000))
    raw.bind((CHANNEL,))
    return raw


def profile(ready: dict[str, Any], eds: Path, device: Path, sync_period: float) -> dict[str, Any]:
    if ready["port"] is None:
        where: dict[str, Any] = {"interface": "socketcan", "channel": CHANNEL}
    else:
        where = {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1", "port": ready["port"]}
    vendor, product, revision = ready["identity"]
    axis = {
        "identity": {"vendor": vendor, "product": product, "revision": revision},
        "gear_ratio": ready["gear"],
        "rated_torque": ready["rated"],
        "position_limits": [-2.96, 2.96],
        "velocity_limit": 1.0,
        "effort_limit": 3600.0,
        "acceleration": 1.0,
        "quick_stop_deceleration": 4.0,
        "standstill_velocity": 1e-3,
    }
    return {
        "adapter": "canopen",
        "eds": str(eds),
        "device": str(device),
        "bus": where | PATIENCE | {"sync_period": sync_period, "missed_cycles": 1_000_000},
        "emergency_stop_codes": [0x9000],
        "travel_limits": {"rad": 1e3},
        "axes": [axis | {"joint": joint, "node": number} for number, joint in enumerate(ready["inertias"], 1)],
    }
