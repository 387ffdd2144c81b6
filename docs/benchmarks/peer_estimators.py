"""sweepid beside FIGAROH and least squares with Pinocchio's regressor, on one free motion of each robot.

The records are of the second plant of `tests/numeric` (MuJoCo, own friction and sensors), which is of none of them:
arms of five and six axes, 20 s at 250 Hz, unknown rotors, CAD off by 10 to 18 %. The peers get the samples filtered
and differentiated as `tests/numeric/simple_estimators` does. FIGAROH runs in an environment of its own, made
here, by its script in `peers`, which is also what its user would write.
"""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count, islice
from pathlib import Path

import numpy as np

from service.identification.estimates.combination import combine
from service.identification.model import axis_rows
from service.identification.motion.equations import whole_parameters
from service.identification.motion.free_motion import free_motions
from tests.numeric.second_plant.logs import Log, log
from tests.numeric.simple_estimators import Law, errors, motion, simple

HERE = Path(__file__).parent / "peers"
ROBOTS = 4  # the first from seed 500 with five axes or more
WORLDS = {"textbook": False, "Stribeck, ripple": True}
PEERS = {"FIGAROH": "figaroh_fit.py"}
PACKAGES = ("figaroh==1.0.2",)


@dataclass(frozen=True)
class Answer:
    """`torque` (n,): unpredicted share of each axis' effort in motion held out. `inertia` (m n,): relative errors."""

    torque: np.ndarray
    inertia: np.ndarray
    seconds: float


def environment(folder: Path) -> Path:
    """Python of the peers' environment, made unless it is there."""
    python = folder / "bin/python"
    if not python.exists():
        subprocess.run([sys.executable, "-m", "venv", folder], check=True)
        subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
    return python


def judged(one: Log, parameters: np.ndarray, seconds: float, laws: dict[str, Law] | None = None) -> Answer:
    chain, axes = one.robot.chain, len(one.robot.axes)
    lower, upper = np.array([(joint.lower, joint.upper) for joint in chain.joints]).T
    poses = np.random.default_rng(1).uniform(lower, upper, (30, axes))
    found = np.stack([axis_rows(chain, k, poses) @ parameters[: 11 * axes] for k in range(axes)], -1)
    torque = errors(one.robot, one.held_out, parameters, laws)
    return Answer(torque, (found / one.inertia(poses) - 1).ravel(), seconds)


def by_sweepid(one: Log) -> Answer:
    began = time.process_time()
    found = combine(one.robot, (), (), free_motions(one.robot, one.sweeps))
    seconds = time.process_time() - began
    laws: dict[str, Law] = {joint: law.effort for joint, law in found.friction.items()}
    return judged(one, whole_parameters(one.robot, found.base, found.solution.values), seconds, laws)


def by_least_squares(one: Log) -> Answer:
    began = time.process_time()
    parameters = simple(one.robot, one.sweeps)["weighted"]
    return judged(one, parameters, time.process_time() - began)


def by_script(python: Path, script: str) -> Callable[[Log], Answer]:
    def fit(one: Log) -> Answer:
        moved = motion(one.sweeps)
        q, dq, ddq = moved.load
        with tempfile.TemporaryDirectory() as folder:
            files = [Path(folder) / name for name in ("log.npz", "robot.urdf", "result.npz")]
            np.savez(files[0], q=q, dq=dq, ddq=ddq, tau=moved.effort, gravity=np.array(one.robot.gravity))
            files[1].write_text(one.robot.urdf_text, "utf-8")
            subprocess.run([python, HERE / script, *files], check=True, capture_output=True)
            found = np.load(files[2])
            return judged(one, found["parameters"], float(found["seconds"]))

    return fit


def rows() -> Iterator[Sequence[str]]:
    """What, and its value of sweepid and of each peer."""
    python = environment(Path(sys.prefix) / "peers")
    tools = {"sweepid": by_sweepid, "least squares": by_least_squares}
    tools |= {name: by_script(python, script) for name, script in PEERS.items()}
    yield "", *tools
    for world, rough in WORLDS.items():
        every = (
            log(seed, family="arm", motion="wander", elastic=False, encoders=False, unknown_rotors=True, wall=False,
                rate=250.0, duration=20.0, rough=rough)
            for seed in count(500)
        )  # fmt: skip
        logs = list(islice((one for one in every if len(one.robot.axes) >= 5), ROBOTS))
        answers = [[fit(one) for one in logs] for fit in tools.values()]
        for what, value in MEASURES.items():
            if rough and value is _processor:
                continue  # it is the same
            yield f"{world}: {what}", *(f"{value(each):.3g}" for each in answers)


def _all(answers: Sequence[Answer], name: str) -> np.ndarray:
    return 100 * np.abs(np.concatenate([getattr(one, name) for one in answers]))


def _processor(answers: Sequence[Answer]) -> float:
    return float(np.median([one.seconds for one in answers]))


MEASURES: dict[str, Callable[[Sequence[Answer]], float]] = {
    "torque, median, %": lambda answers: float(np.median(_all(answers, "torque"))),
    "J, p95, %": lambda answers: float(np.percentile(_all(answers, "inertia"), 95)),
    "processor, s": _processor,
}
