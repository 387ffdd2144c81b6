"""The machine of durand's nodes as a process, and the drive profile that leads to it."""

import json
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.contract.makers import PATIENCE
from tests.durand_nodes.objects import GEAR, PRODUCT, RATED, REVISION, VENDOR

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class DurandMachine:
    """Running; the profile is that of `config/devices/plain-402.yaml` with the EDS that durand wrote."""

    profile: dict[str, Any]
    control_port: int
    inertias: dict[str, float]  # of the plant, kg m^2
    process: subprocess.Popen[bytes]


@contextmanager
def machine(modes: str = "csv", sync_period: float = 0.008, device: Path | None = None) -> Iterator[DurandMachine]:
    """`modes` as in `objects.MODES`; `device`: another device map."""
    command = [sys.executable, "-m", "tests.durand_nodes", modes]
    with (
        tempfile.TemporaryDirectory() as folder,
        subprocess.Popen(command, stdout=subprocess.PIPE, cwd=ROOT) as process,
    ):
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line, f"{' '.join(command)} ended before it was ready"
            ready = json.loads(line)
            eds = Path(folder) / "durand.eds"
            eds.write_text(ready["eds"])
            device = device or ROOT / "config" / "devices" / "plain-402.yaml"
            content = profile(ready["port"], list(ready["inertias"]), eds, device, sync_period)
            yield DurandMachine(content, ready["control_port"], ready["inertias"], process)
        finally:
            process.terminate()
    assert process.returncode in (0, -signal.SIGKILL)


def profile(port: int, joints: list[str], eds: Path, device: Path, sync_period: float) -> dict[str, Any]:
    bus = {"interface": "socketcand", "channel": "can0", "host": "127.0.0.1", "port": port, **PATIENCE}
    axis = {
        "identity": {"vendor": VENDOR, "product": PRODUCT, "revision": REVISION},
        "gear_ratio": GEAR,
        "rated_torque": RATED,
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
        "bus": bus | {"sync_period": sync_period, "missed_cycles": 1_000_000},
        "emergency_stop_codes": [0x9000],
        "axes": [axis | {"joint": joint, "node": node} for node, joint in enumerate(joints, 1)],
    }
