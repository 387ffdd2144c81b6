"""Makes the stored documents of this folder with the commands: `python -m tests.stored.make`.

They stand for what a service has in its store today. Make them anew only when a *new* format gets its own files; those
of older formats stay as they are.
"""

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from service.diagnosis.rows.signals import in_frequency
from service.diagnosis.sensitivity import expected
from service.identification.design.diagnosis_sweeps import full_design
from service.model import Sweep
from service.store.files.bundle import write_bundle
from tests.command import sweepid
from tests.numeric.campaign import max100, measure
from tests.numeric.free_motion import draw, log, program
from tests.numeric.noise_campaign import measure_noise

HERE = Path(__file__).parent
FRICTION = 60.0  # N m, dry, that the model does not know
KEPT = 20  # samples of an example, lines of a response: enough to tell the format


def rubbing(folder: Path, blocks: tuple[str, ...] | None = None, sign: float = 1.0) -> Path:
    """The vertical axis of the representative robot, with dry friction and noise; `sign` of the effort as recorded."""
    robot, random = max100(), np.random.default_rng(5)
    poses = np.array([[0.0, -0.6, 0.4, 0, 0, 0], [0.5, 0.4, -0.7, 0, 0, 0]])
    chosen: dict[str, Any] = {} if blocks is None else {"blocks": blocks}
    sweeps: list[Sweep] = []
    for designed in full_design(robot, "joint_1", poses, sample_rate=250.0, **chosen):
        sweep = expected(designed, designed.spec.pose[0])
        record = sweep.recording
        (turning,) = in_frequency(record.velocity[None], 250.0)
        effort = 300.0 * turning + 200.0 * record.velocity + FRICTION * np.sign(record.velocity)
        record.effort[:] = sign * (effort + random.normal(0, 3.0, len(effort)))
        sweeps.append(sweep)
    write_bundle(folder, robot, sweeps)
    return folder


def shortened(value: object) -> object:
    """The same document with the first numbers of long lists alone."""
    if isinstance(value, dict):
        return {key: shortened(one) for key, one in value.items()}
    if isinstance(value, list):
        return [shortened(one) for one in value[:KEPT]]
    return value


def keep(name: str, *arguments: str) -> None:
    done = sweepid(*arguments, "--json", "-")
    if done.returncode:
        raise SystemExit(done.stderr)
    write(name, json.loads(done.stdout))


def write(name: str, document: object) -> None:
    text = json.dumps(shortened(document), indent=1, sort_keys=True)
    (HERE / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def main() -> None:
    with TemporaryDirectory() as where:
        folder = Path(where)
        whole = rubbing(folder / "whole")
        keep("check", "check", str(whole))
        keep("check-wrong", "check", str(rubbing(folder / "turned", sign=-1.0)))
        keep("diagnosis-named", "diagnose", str(whole), "--model", str(folder / "model.json"))
        write("model", json.loads((folder / "model.json").read_text("utf-8")))
        keep("diagnosis-open", "diagnose", str(rubbing(folder / "slow", ("forward_slow",))), "--no-twin")
        campaign = measure("max100-rigid", 3, poses=3, sample_rate=250.0)
        write_bundle(folder / "sweeps", campaign.robot, campaign.sweeps)
        keep("estimate", "identify", str(folder / "sweeps"))
        keep("sheet", "export", "sheet", str(folder / "sweeps"))
        truth = draw(4, 3)
        write_bundle(folder / "free", truth.robot, log(truth, program(np.random.default_rng(4), 3), 4))
        keep("estimate-free-motion", "identify", str(folder / "free"))
        write_bundle(folder / "after", truth.robot, log(truth, program(np.random.default_rng(4), 3), 5))
        keep("payload", "estimate", "payload", str(folder / "free"), str(folder / "after"))
        noise = measure_noise("max100-rigid", "joint_1", 2, repeats=1)
        write_bundle(folder / "noise", noise.robot, noise.sweeps)
        keep("analysis", "identify", str(folder / "noise"))


if __name__ == "__main__":
    main()
