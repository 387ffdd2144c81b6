"""Wrong nominal data and broken records, as they come from shop floors; the machine behind them is sound."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.model import Recording, Robot, Sweep, build_robot

Array = NDArray[np.float64]
Random = np.random.Generator
Broken = tuple[Robot, str, list[Sweep]]

WITH_RIPPLE = ("gear_ratio_off", "ripple_orders_missing")  # faults that ripple alone can show


@dataclass(frozen=True)
class Neighbour:
    """Another axis that held still meanwhile: what its drive told, an array (samples,) a sweep."""

    joint: str
    efforts: Sequence[Array]


def broken(
    fault: str, robot: Robot, joint: str, sweeps: Sequence[Sweep], neighbour: Neighbour, random: Random
) -> Broken:
    """The bundle with that fault, and the joint that it says was moved."""
    if fault in _ROBOTS:
        return _ROBOTS[fault](robot, joint, random), joint, list(sweeps)
    if fault == "axes_swapped":
        return robot, *_swapped(robot, joint, sweeps, neighbour, random)
    if fault == "torque_clipped":
        return robot, joint, _clipped(sweeps, random)
    change = _RECORDS[fault](robot.axis(joint).rated_effort, random)
    return robot, joint, [replace(sweep, recording=change(sweep)) for sweep in sweeps]


def _gear_ratio_off(robot: Robot, joint: str, random: Random) -> Robot:
    factor = 1.0 + 0.002 * float(random.choice([-1.0, 1.0]))
    return _other_axis(robot, joint, gear_ratio=robot.axis(joint).gear_ratio * factor)


def _ripple_orders_missing(robot: Robot, joint: str, random: Random) -> Robot:
    return _other_axis(robot, joint, cogging_orders=(), transmission_orders=())


def _other_axis(robot: Robot, joint: str, **fields: object) -> Robot:
    axes = tuple(axis.model_copy(update=fields) if axis.joint == joint else axis for axis in robot.axes)
    return build_robot(robot.description.model_copy(update={"axes": axes}), robot.urdf_text)


def _swapped(
    robot: Robot, joint: str, sweeps: Sequence[Sweep], neighbour: Neighbour, random: Random
) -> tuple[str, list[Sweep]]:
    """Either the torque column is of another axis, which held still; or the whole record bears another axis' name."""
    if random.random() < 0.5:
        rows = zip(sweeps, neighbour.efforts, strict=True)
        return joint, [replace(s, recording=replace(s.recording, effort=effort)) for s, effort in rows]
    here, there = robot.index(joint), robot.index(neighbour.joint)

    def renamed(sweep: Sweep) -> Sweep:
        pose = list(sweep.spec.pose)
        pose[here], pose[there] = pose[there], pose[here]
        return replace(sweep, spec=sweep.spec.model_copy(update={"axis": neighbour.joint, "pose": tuple(pose)}))

    return neighbour.joint, [renamed(sweep) for sweep in sweeps]


def _clipped(sweeps: Sequence[Sweep], random: Random) -> list[Sweep]:
    """The trace's range ends where some in a hundred of its samples lie beyond."""
    sizes = np.abs(np.concatenate([s.recording.effort for s in sweeps if s.spec.excitation != "standstill"]))
    limit = float(np.percentile(sizes, random.uniform(88.0, 97.0)))
    return [
        replace(s, recording=replace(s.recording, effort=np.clip(s.recording.effort, -limit, limit))) for s in sweeps
    ]


Change = Callable[[Sweep], Recording]


def _sign(rated: float, random: Random) -> Change:
    return lambda sweep: replace(sweep.recording, effort=-sweep.recording.effort)


def _speed_scaled(rated: float, random: Random) -> Change:
    factor = 1.0 + 0.03 * float(random.choice([-1.0, 1.0]))

    def change(sweep: Sweep) -> Recording:
        record = sweep.recording
        wanted = record.velocity_setpoint
        scaled = None if wanted is None else factor * wanted
        return replace(record, velocity=factor * record.velocity, velocity_setpoint=scaled)

    return change


def _eight_bits(rated: float, random: Random) -> Change:
    step = 2.0 * 1.5 * rated / 256.0

    def change(sweep: Sweep) -> Recording:
        return replace(sweep.recording, effort=np.round(sweep.recording.effort / step) * step)

    return change


def _spikes(rated: float, random: Random) -> Change:
    """Single samples of nonsense, a few in a thousand."""
    share = random.uniform(0.001, 0.004)

    def change(sweep: Sweep) -> Recording:
        effort = sweep.recording.effort.copy()
        hit = random.random(effort.size) < share
        effort[hit] += random.choice([-1.0, 1.0], int(hit.sum())) * rated * random.uniform(0.3, 1.5, int(hit.sum()))
        return replace(sweep.recording, effort=effort)

    return change


def _scaled_effort(by: Callable[[float], float]) -> Callable[[float, Random], Change]:
    def make(rated: float, random: Random) -> Change:
        return lambda sweep: replace(sweep.recording, effort=by(rated) * sweep.recording.effort)

    return make


def _degrees(rated: float, random: Random) -> Change:
    """Position and nothing else: the speed came from another channel."""
    return lambda sweep: replace(sweep.recording, position=np.degrees(sweep.recording.position))


def _channels_apart(rated: float, random: Random) -> Change:
    """The torque is several milliseconds later than the speed; or the speed than the position and the torque."""
    late, of_speed = random.uniform(5e-3, 12e-3), random.random() < 0.5

    def change(sweep: Sweep) -> Recording:
        record, rate = sweep.recording, sweep.spec.sample_rate
        if of_speed:
            return replace(record, velocity=_later(record.velocity, late * rate))
        return replace(record, effort=_later(record.effort, late * rate))

    return change


def _clock_jumps(rated: float, random: Random) -> Change:
    """Samples were lost and the rest moved up: the time column counts on as if nothing had happened."""

    def change(sweep: Sweep) -> Recording:
        record, count = sweep.recording, sweep.recording.time.size
        lost = round(random.uniform(0.02, 0.06) * sweep.spec.sample_rate)
        at = int(random.uniform(0.45, 0.8) * count)
        kept = np.minimum(np.where(np.arange(count) < at, np.arange(count), np.arange(count) + lost), count - 1)
        wanted = record.velocity_setpoint
        return Recording(
            time=record.time, effort=record.effort[kept], velocity=record.velocity[kept],
            position=record.position[kept], velocity_setpoint=None if wanted is None else wanted[kept],
        )  # fmt: skip

    return change


def _unlike_repeats(rated: float, random: Random) -> Change:
    """The second of each pair ran against something: more drag, another offset."""
    drag, offset = random.uniform(0.03, 0.08) * rated, random.uniform(-0.05, 0.05) * rated

    def change(sweep: Sweep) -> Recording:
        record = sweep.recording
        if sweep.spec.repeat == 0:
            return record
        other = random.uniform(0.5, 1.5)
        return replace(record, effort=record.effort + other * (drag * np.tanh(record.velocity / 0.01) + offset))

    return change


def _later(column: Array, samples: float) -> Array:
    place = np.arange(column.size)
    return np.interp(place - samples, place, column)


_ROBOTS: dict[str, Callable[[Robot, str, Random], Robot]] = {
    "gear_ratio_off": _gear_ratio_off,
    "ripple_orders_missing": _ripple_orders_missing,
}

_RECORDS: dict[str, Callable[[float, Random], Change]] = {
    "torque_sign": _sign,
    "speed_scaled": _speed_scaled,
    "torque_8_bit": _eight_bits,
    "torque_spikes": _spikes,
    "effort_in_percent": _scaled_effort(lambda rated: 100.0 / rated),
    "effort_in_n_mm": _scaled_effort(lambda rated: 1000.0),
    "position_in_degrees": _degrees,
    "channels_apart": _channels_apart,
    "clock_jumps": _clock_jumps,
    "repeats_unlike": _unlike_repeats,
}

FAULTS = (*_ROBOTS, "axes_swapped", "torque_clipped", *_RECORDS)
