"""What may be wrong with a bundle beside what an axis by formula (`tests/unit/service/data_check`) and the second plant
have: one function a fault, its size drawn by the generator it gets.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from service.model import Array, Axis, Sweep, SweepSpec, build_robot
from service.store.files.bundle import Bundle
from tests.numeric.second_plant.cases import Kind, case, make
from tests.numeric.second_plant.effects import CATALOGUE

HIDDEN = (None, *CATALOGUE)


@dataclass(frozen=True)
class Sound:
    """A sound bundle of one axis that was swept."""

    bundle: Bundle
    joint: str


def sound(number: int) -> Sound:
    """Nothing is hidden in the first, then each effect of the catalogue in turn."""
    name = HIDDEN[number % len(HIDDEN)]
    one = case(60, number, Kind.SINGLE, (name,)) if name else case(60, number, Kind.NONE, size="none")
    robot, joint, sweeps, _ = make(one, small=True)
    return Sound(Bundle(robot, sweeps), joint)


Random = np.random.Generator
Break = Callable[[Random, Sound], Bundle]


@dataclass(frozen=True)
class Fault:
    """`codes`: a finding with one of them, on that axis or the robot, names it."""

    codes: tuple[str, ...]
    apply: Break


def columns(change: Callable[[Random, Axis, Sweep], dict[str, Array]], *, some: bool = False) -> Break:
    """A fault that changes columns of every sweep, or of a few that turn."""

    def apply(random: Random, sound: Sound) -> Bundle:
        sweeps, axis = list(sound.bundle.sweeps), sound.bundle.robot.axis(sound.joint)
        chosen = range(len(sweeps))
        if some:
            turning = [k for k in chosen if sweeps[k].spec.offset_velocity]
            chosen = random.permutation(turning)[: max(1, len(turning) // 4)]
        for k in chosen:
            sweeps[k] = replace(sweeps[k], recording=replace(sweeps[k].recording, **change(random, axis, sweeps[k])))
        return replace(sound.bundle, sweeps=tuple(sweeps))

    return apply


def scaled(factor: Callable[[Axis], float]) -> Break:
    """Position and velocity times one factor."""
    return columns(
        lambda _, axis, sweep: {n: factor(axis) * getattr(sweep.recording, n) for n in ("position", "velocity")}
    )


def respecified(change: Callable[[SweepSpec], dict[str, Any]]) -> Break:
    """Another entry of bundle.json for every sweep."""
    return lambda _, sound: replace(
        sound.bundle,
        sweeps=tuple(replace(s, spec=s.spec.model_copy(update=change(s.spec))) for s in sound.bundle.sweeps),
    )


def _window(sweep: Sweep) -> slice:
    spec = sweep.spec
    first = round(spec.measure_from * spec.sample_rate)
    return slice(first, first + round((spec.period or 1.0) * (spec.periods or 1) * spec.sample_rate))


def _coarse(_: Random, __: Axis, sweep: Sweep) -> dict[str, Array]:
    """8 bits over ten times the fastest speed."""
    peak = abs(sweep.spec.offset_velocity) + sum(sine.amplitude for sine in sweep.spec.sines)
    step = 2 * 10 * peak / 255
    return {"velocity": np.round(sweep.recording.velocity / step) * step} if step else {}


def _dropped(random: Random, _: Axis, sweep: Sweep) -> dict[str, Array]:
    """Frames in which all channels read zero."""
    part = _window(sweep)
    where = random.choice(np.arange(part.start + 10, part.stop - 10), random.integers(1, 5), replace=False)
    result: dict[str, Array] = {}
    for name in ("effort", "velocity", "position"):
        result[name] = getattr(sweep.recording, name).copy()
        result[name][where] = 0.0
    return result


def _jitter(random: Random, _: Axis, sweep: Sweep) -> dict[str, Array]:
    """Half of the samples early and half late, by up to 0.4 of one."""
    time = sweep.recording.time
    off = random.uniform(0.25, 0.4) / sweep.spec.sample_rate * random.choice([-1.0, 1.0], len(time))
    off[0] = 0.0
    return {"time": time + off}


def _sticking(random: Random, axis: Axis, sweep: Sweep) -> dict[str, Array]:
    """Torque builds up and breaks loose, some times in a sweep, never twice alike."""
    if sweep.spec.excitation == "standstill":
        return {}
    effort, part = sweep.recording.effort.copy(), _window(sweep)
    length = round(0.08 * sweep.spec.sample_rate)
    for _ in range(random.integers(1, 5)):
        first = int(random.integers(part.start, max(part.stop - length, part.start + 1)))
        saw = np.linspace(0, random.uniform(0.02, 0.05) * axis.rated_effort, length)
        effort[first : first + length] += saw[: len(effort) - first]
    return {"effort": effort}


def _other_pose(random: Random, sound: Sound) -> Bundle:
    """Recordings of one pose told for the next."""
    poses = list(dict.fromkeys(sweep.spec.pose for sweep in sound.bundle.sweeps))
    after = dict(zip(poses, poses[1:] + poses[:1], strict=True))
    return respecified(lambda spec: {"pose": after[spec.pose]})(random, sound)


def _gravity_in_g(_: Random, sound: Sound) -> Bundle:
    robot = sound.bundle.robot
    description = robot.description.model_copy(update={"gravity": (0.0, 0.0, -1.0)})
    return replace(sound.bundle, robot=build_robot(description, robot.urdf_text))


FAULTS: dict[str, Fault] = {
    "velocity coarse": Fault(("coarse_steps",), columns(_coarse)),
    "motion in degrees": Fault(("position_unit",), scaled(lambda _: 180 / np.pi)),
    "motion on the motor side": Fault(("position_unit",), scaled(lambda axis: axis.gear_ratio)),
    "frames of zeros": Fault(("spikes",), columns(_dropped, some=True)),
    "jitter of the clock": Fault(("clock",), columns(_jitter)),
    "another sample rate": Fault(("clock",), respecified(lambda spec: {"sample_rate": spec.sample_rate / 2})),
    "window after the record": Fault(("clock",), respecified(lambda spec: {"measure_from": spec.measure_from + 9})),
    "another pose": Fault(("wrong_pose",), _other_pose),
    "stick events": Fault(("not_repeatable",), columns(_sticking)),
    "gravity in g": Fault(("gravity",), _gravity_in_g),
}
