"""What may be wrong with a bundle: one function a fault, its size drawn by the generator it gets.

A fault of wiring or of the robot file is in all sweeps of the axis; one of a record in some of them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from service.recording import Array, Sweep
from service.robot import Robot, build_robot
from service.store.files.bundle import Bundle
from tests.numeric.check_bundles import Sound

Random = np.random.Generator
Break = Callable[[Random, Sound], Bundle]


@dataclass(frozen=True)
class Fault:
    """`codes`: a finding with one of them, on that axis or the robot, names it."""

    codes: tuple[str, ...]
    apply: Break


def columns(change: Callable[[Random, Sound, Sweep], dict[str, Array]], *, some: bool = False) -> Break:
    """A fault that changes columns of every sweep of the axis, or of a few that turn."""

    def apply(random: Random, sound: Sound) -> Bundle:
        mine = [sweep for sweep in sound.bundle.sweeps if sweep.spec.axis == sound.joint]
        if some:
            turning = [sweep for sweep in mine if sweep.spec.offset_velocity]
            mine = [turning[k] for k in random.permutation(len(turning))[: max(1, len(turning) // 4)]]
        ids = {sweep.spec.id for sweep in mine}
        return replace(
            sound.bundle,
            sweeps=tuple(
                replace(sweep, recording=replace(sweep.recording, **change(random, sound, sweep)))
                if sweep.spec.id in ids
                else sweep
                for sweep in sound.bundle.sweeps
            ),
        )

    return apply


def scaled(factor: Callable[[Random, Sound], float], *names: str) -> Break:
    """Columns times one factor, drawn once."""

    def apply(random: Random, sound: Sound) -> Bundle:
        value = factor(random, sound)
        return columns(lambda _, __, sweep: {name: value * getattr(sweep.recording, name) for name in names})(
            random, sound
        )

    return apply


def described(change: Callable[[Random, Sound], dict[str, Any]], *, axis: bool = False) -> Break:
    """A robot file with other fields, of the whole or of the axis."""

    def apply(random: Random, sound: Sound) -> Bundle:
        robot, update = sound.bundle.robot, change(random, sound)
        if axis:
            update = {
                "axes": tuple(one.model_copy(update=update) if one.joint == sound.joint else one for one in robot.axes)
            }
        description = robot.description.model_copy(update=update)
        return replace(sound.bundle, robot=build_robot(description, robot.urdf_text))

    return apply


def respecified(change: Callable[[Random, Sound, Sweep], dict[str, Any]]) -> Break:
    """Another entry of bundle.json for the sweeps of the axis."""

    def apply(random: Random, sound: Sound) -> Bundle:
        return replace(
            sound.bundle,
            sweeps=tuple(
                replace(sweep, spec=sweep.spec.model_copy(update=change(random, sound, sweep)))
                if sweep.spec.axis == sound.joint
                else sweep
                for sweep in sound.bundle.sweeps
            ),
        )

    return apply


def rated(sound: Sound) -> float:
    return sound.bundle.robot.axis(sound.joint).rated_effort


def gear(sound: Sound) -> float:
    return sound.bundle.robot.axis(sound.joint).gear_ratio


def late(values: Array, sweep: Sweep, delay: float) -> Array:
    time = sweep.recording.time
    return np.interp(time - delay, time, values)


def _delayed(name: str, low: float, high: float) -> Break:
    def apply(random: Random, sound: Sound) -> Bundle:
        delay = random.uniform(low, high)
        return columns(lambda _, __, sweep: {name: late(getattr(sweep.recording, name), sweep, delay)})(random, sound)

    return apply


def _window(sweep: Sweep) -> slice:
    spec = sweep.spec
    first = round(spec.measure_from * spec.sample_rate)
    return slice(first, first + round((spec.period or 1.0) * (spec.periods or 1) * spec.sample_rate))


def _clipped(random: Random, sound: Sound) -> Bundle:
    """At one limit for all sweeps, which the quarter that needs most is beyond in a part of the window."""
    windows = [s.recording.effort[_window(s)] for s in sound.bundle.sweeps if s.spec.offset_velocity]
    tops = [float(np.quantile(np.abs(part), random.uniform(0.8, 0.97))) for part in windows]
    limit = float(np.quantile(tops, 0.75))
    return columns(lambda _, __, sweep: {"effort": np.clip(sweep.recording.effort, -limit, limit)})(random, sound)


def _bits(name: str, whole: Callable[[Sound, Sweep], float]) -> Break:
    def change(_: Random, sound: Sound, sweep: Sweep) -> dict[str, Array]:
        if not (step := 2 * whole(sound, sweep) / 255):
            return {}  # it stands
        return {name: np.round(getattr(sweep.recording, name) / step) * step}

    return columns(change)


def _spikes(name: str, size: Callable[[Random, Sound, Sweep], float]) -> Break:
    def change(random: Random, sound: Sound, sweep: Sweep) -> dict[str, Array]:
        values = getattr(sweep.recording, name).copy()
        part = _window(sweep)
        where = random.choice(np.arange(part.start + 10, part.stop - 10), random.integers(1, 12), replace=False)
        values[where] += random.choice([-1.0, 1.0], len(where)) * size(random, sound, sweep)
        return {name: values}

    return columns(change, some=True)


def _dropped(random: Random, sound: Sound, sweep: Sweep) -> dict[str, Array]:
    """Frames in which all channels read zero."""
    part = _window(sweep)
    where = random.choice(np.arange(part.start + 10, part.stop - 10), random.integers(1, 5), replace=False)
    result: dict[str, Array] = {}
    for name in ("effort", "velocity", "position"):
        result[name] = getattr(sweep.recording, name).copy()
        result[name][where] = 0.0
    return result


def _held(name: str, low: float, high: float) -> Break:
    def change(random: Random, _: Sound, sweep: Sweep) -> dict[str, Array]:
        values, part = getattr(sweep.recording, name).copy(), _window(sweep)
        count = round(random.uniform(low, high) * sweep.spec.sample_rate)
        first = int(random.integers(part.start, max(part.stop - count, part.start + 1)))
        values[first : first + count] = values[first]
        return {name: values}

    return columns(change, some=True)


def _lost(random: Random, sound: Sound) -> Bundle:
    """Some samples are missing and the clock was made anew."""

    def cut(sweep: Sweep) -> Sweep:
        part, record = _window(sweep), sweep.recording
        lost = int(random.integers(2, 50))
        first = int(random.integers(part.start + 50, part.stop - 150))
        keep = np.r_[0:first, first + lost : len(record.time)]
        step = 1 / sweep.spec.sample_rate
        fill = {n: getattr(record, n)[keep] for n in ("effort", "velocity", "position")}
        tail = {n: np.concatenate([v, v[-lost:]]) for n, v in fill.items()}
        time = np.asarray(np.arange(len(record.time)) * step, np.float64)
        return Sweep(sweep.spec, type(record)(time=time, **tail))

    turning = [s.spec.id for s in sound.bundle.sweeps if s.spec.axis == sound.joint and s.spec.offset_velocity]
    chosen = set(random.choice(turning, max(1, len(turning) // 4), replace=False).tolist())
    sweeps = tuple(cut(sweep) if sweep.spec.id in chosen else sweep for sweep in sound.bundle.sweeps)
    return replace(sound.bundle, sweeps=sweeps)


def _gap(random: Random, _: Sound, sweep: Sweep) -> dict[str, Array]:
    time = sweep.recording.time.copy()
    time[random.integers(10, len(time) - 10) :] += random.uniform(2, 100) / sweep.spec.sample_rate
    return {"time": time}


def _jitter(random: Random, _: Sound, sweep: Sweep) -> dict[str, Array]:
    """Half of the samples early and half late, by up to 0.4 of one."""
    time = sweep.recording.time
    off = random.uniform(0.25, 0.4) / sweep.spec.sample_rate * random.choice([-1.0, 1.0], len(time))
    off[0] = 0.0
    return {"time": time + off}


def _vibrating(random: Random, sound: Sound) -> Bundle:
    """The floor shakes at one frequency, with a phase of its own in each sweep."""
    size, frequency = random.uniform(0.005, 0.02) * rated(sound), random.uniform(4.0, 15.0)

    def change(random: Random, sound: Sound, sweep: Sweep) -> dict[str, Array]:
        if sweep.spec.excitation == "standstill":
            return {}
        wave = np.sin(2 * np.pi * frequency * sweep.recording.time + random.uniform(0, 2 * np.pi))
        return {"effort": sweep.recording.effort + size * wave}

    return columns(change)(random, sound)


def _sticking(random: Random, sound: Sound, sweep: Sweep) -> dict[str, Array]:
    """Torque builds up and breaks loose, some times in a sweep, never twice alike."""
    if sweep.spec.excitation == "standstill":
        return {}
    effort, part = sweep.recording.effort.copy(), _window(sweep)
    length = round(0.08 * sweep.spec.sample_rate)
    for _ in range(random.integers(1, 5)):
        first = int(random.integers(part.start, max(part.stop - length, part.start + 1)))
        saw = np.linspace(0, random.uniform(0.02, 0.05) * rated(sound), length)
        effort[first : first + length] += saw[: len(effort) - first]
    return {"effort": effort}


def _other_pose(_: Random, sound: Sound) -> Bundle:
    """Recordings of one pose told for the next."""
    poses = list(dict.fromkeys(sweep.spec.pose for sweep in sound.bundle.sweeps))
    after = dict(zip(poses, poses[1:] + poses[:1], strict=True))
    return respecified(lambda _, __, sweep: {"pose": after[sweep.spec.pose]})(_, sound)


def _other_axis(random: Random, sound: Sound) -> Bundle:
    """`axis` names a joint beside the one that moved."""
    joints, index = sound.bundle.robot.joints[:3], sound.bundle.robot.index(sound.joint)
    joint = joints[(index + int(random.integers(1, 3))) % 3]
    return respecified(lambda _, __, ___: {"axis": joint})(random, sound)


def _foreign_effort(random: Random, sound: Sound, sweep: Sweep) -> dict[str, Array]:
    """That of an axis which holds: its weight and noise."""
    noise = 0.002 * rated(sound) * random.standard_normal(len(sweep.recording.time))
    return {"effort": random.uniform(-0.3, 0.3) * rated(sound) + noise}


def _degrees(value: Sequence[float]) -> tuple[float, ...]:
    return tuple(float(np.degrees(angle)) for angle in value)


def _robot(sound: Sound) -> Robot:
    return sound.bundle.robot


def _peak(_: Random, __: Sound, sweep: Sweep) -> float:
    return abs(sweep.spec.offset_velocity) + sum(sine.amplitude for sine in sweep.spec.sines)


SPEED = (-0.05, -0.04, -0.03, -0.02, -0.01, 0.01, 0.02, 0.03, 0.04, 0.05)
DEGREES = 180 / np.pi

FAULTS: dict[str, Fault] = {
    "effort in N mm": Fault(("effort_unit",), scaled(lambda _, __: 1e3, "effort")),
    "effort in percent of rated": Fault(("effort_unit",), scaled(lambda _, s: 100 / rated(s), "effort")),
    "effort on the motor side": Fault(("effort_unit",), scaled(lambda _, s: 1 / gear(s), "effort")),
    "effort reversed": Fault(("effort_sign",), scaled(lambda _, __: -1.0, "effort")),
    "effort of an axis that holds": Fault(("wrong_axis",), columns(_foreign_effort)),
    "effort late": Fault(("channel_delay",), _delayed("effort", 8e-3, 20e-3)),
    "effort clipped": Fault(("clipped",), _clipped),
    "effort of 8 bit": Fault(("coarse_steps",), _bits("effort", lambda s, _: rated(s))),
    "effort spiky": Fault(("spikes",), _spikes("effort", lambda r, s, _: r.uniform(0.05, 0.5) * rated(s))),
    "effort held": Fault(("frozen",), _held("effort", 0.05, 0.3)),
    "effort dead": Fault(("frozen",), columns(lambda _, __, s: {"effort": np.zeros_like(s.recording.effort)})),
    "velocity in degrees": Fault(("velocity_unit",), scaled(lambda _, __: DEGREES, "velocity")),
    "velocity in motor rev/min": Fault(("velocity_unit",), scaled(lambda _, s: gear(s) * 30 / np.pi, "velocity")),
    "velocity reversed": Fault(("velocity_sign",), scaled(lambda _, __: -1.0, "velocity")),
    "velocity off by 1 to 5 %": Fault(("velocity_scale",), scaled(lambda r, _: 1 + r.choice(SPEED), "velocity")),
    "velocity late": Fault(("channel_delay",), _delayed("velocity", 3e-3, 20e-3)),
    "velocity coarse": Fault(("coarse_steps",), _bits("velocity", lambda _, s: 10 * _peak(None, None, s))),  # type: ignore[arg-type]
    "velocity spiky": Fault(("spikes",), _spikes("velocity", lambda r, s, w: r.uniform(0.3, 2) * _peak(r, s, w))),
    "velocity dead": Fault(("frozen",), columns(lambda _, __, s: {"velocity": np.zeros_like(s.recording.velocity)})),
    "position in degrees": Fault(("position_unit",), scaled(lambda _, __: DEGREES, "position")),
    "position reversed": Fault(("position_sign",), scaled(lambda _, __: -1.0, "position")),
    "position spiky": Fault(("spikes",), _spikes("position", lambda r, *_: r.uniform(1e-3, 0.1))),
    "motion in degrees": Fault(("position_unit",), scaled(lambda _, __: DEGREES, "position", "velocity")),
    "motion on the motor side": Fault(("position_unit",), scaled(lambda _, s: gear(s), "position", "velocity")),
    "motion reversed": Fault(("motion_sign",), scaled(lambda _, __: -1.0, "position", "velocity")),
    "frames of zeros": Fault(("spikes",), columns(_dropped, some=True)),
    "samples lost": Fault(("time_jump",), _lost),
    "gap in time": Fault(("clock",), columns(_gap, some=True)),
    "jitter of the clock": Fault(("clock",), columns(_jitter)),
    "another sample rate": Fault(("clock",), respecified(lambda r, _, s: {"sample_rate": s.spec.sample_rate / 2})),
    "window after the record": Fault(
        ("clock",), respecified(lambda _, __, s: {"measure_from": s.spec.measure_from + 9})
    ),
    "another axis": Fault(("wrong_axis",), _other_axis),
    "another pose": Fault(("wrong_pose",), _other_pose),
    "pose in degrees": Fault(("wrong_pose",), respecified(lambda _, __, s: {"pose": _degrees(s.spec.pose)})),
    "floor vibration": Fault(("not_repeatable",), _vibrating),
    "stick events": Fault(("not_repeatable",), columns(_sticking)),
    "gravity in mm/s^2": Fault(("gravity",), described(lambda _, __: {"gravity": (0.0, 0.0, -9810.0)})),
    "gravity in g": Fault(("gravity",), described(lambda _, __: {"gravity": (0.0, 0.0, -1.0)})),
    "prior in percent": Fault(
        ("prior",), described(lambda _, s: {"prior": _robot(s).prior.model_copy(update={"inertia": 30.0})})
    ),
    "rated torque of the motor": Fault(
        ("rated_effort",), described(lambda _, s: {"rated_effort": rated(s) / gear(s)}, axis=True)
    ),
    "motor inertia in kg cm^2": Fault(
        ("motor_inertia",),
        described(lambda _, s: {"motor_inertia": 1e4 * (_robot(s).axis(s.joint).motor_inertia or 0.0)}, axis=True),
    ),
    "no nominal friction": Fault(("missing_nominal",), described(lambda _, __: {"viscous_friction": None}, axis=True)),
}
