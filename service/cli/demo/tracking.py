"""The same path on the virtual machine's mechanics, with torque feed-forward of CAD and of the estimate."""

import json
import subprocess
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict

from service.cli.demo.processes import command, environment
from service.model.errors import SweepidError
from service.report.benefit import FollowingError, Tracking, feed_forward
from service.store.files.bundle import Bundle

GAIN = 10.0  # 1/s, of the position controllers: 0.6 m/min per mm, usual for elastic gears
_TIMEOUT = 600.0  # s


class _Answer(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")
    cad: dict[str, FollowingError]
    identified: dict[str, FollowingError]


def drive_path(measured: Bundle, scenario: Path, scratch: Path) -> Tracking:
    """Run the command `sweepid drive follow`; `scratch` is a file for the path, removed afterwards."""
    wanted = feed_forward(measured.robot, measured.sweeps)
    motion = wanted.motion
    path = {
        "gain": GAIN,
        "position": motion.position.tolist(),
        "velocity": motion.velocity.tolist(),
        "feed_forwards": {"cad": wanted.cad.tolist(), "identified": wanted.identified.tolist()},
    }
    scratch.write_text(json.dumps(path), encoding="utf-8")
    arguments = command("drive", "follow", str(scenario), str(scratch))
    answer = subprocess.run(arguments, capture_output=True, text=True, env=environment(), timeout=_TIMEOUT, check=False)
    scratch.unlink()
    if answer.returncode:
        raise SweepidError(f"sweepid drive follow: {answer.stderr.strip()}")
    found = _Answer.model_validate_json(answer.stdout)
    moved = {sweep.spec.axis for sweep in measured.sweeps}
    return Tracking(
        duration=(len(motion.position) - 1) / 1000,
        top_speed=float(np.abs(motion.velocity).max()),
        top_acceleration=float(np.abs(motion.acceleration).max()),
        gain=GAIN,
        cad={joint: one for joint, one in found.cad.items() if joint in moved},
        identified={joint: one for joint, one in found.identified.items() if joint in moved},
    )
