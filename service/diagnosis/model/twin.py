"""The twin: simulation along recorded motor motion. The only module of the service that imports the simulator."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from pydantic import ValidationError

from service.diagnosis.effects.effect import Inexpressible
from service.diagnosis.model.scenario import AxisEntry
from service.model import Array, Robot, Sweep
from simulator import DriveTrain, Gravity, Measurement, Motion, MovingAxis, Turn, replay, warmth

Part = TypeVar("Part", DriveTrain, Measurement)


@dataclass(frozen=True)
class TwinRun:
    """Sweep number `sweep` with an axis of a total inertia, kg m^2 as recorded, and gravity [cosine, sine], N m."""

    sweep: int
    entry: AxisEntry
    inertia: float
    gravity: tuple[float, float]


@dataclass(frozen=True)
class Way:
    """The motion of the motor in a sweep, with its times."""

    motion: Motion
    turn: Turn


def ways(sweeps: Sequence[Sweep]) -> list[Way]:
    """The motions as recorded."""
    return [
        Way(
            Motion(sweep.recording.time, sweep.recording.position, sweep.recording.velocity),
            Turn(sweep.spec.started_at, 1 / sweep.spec.sample_rate, sweep.recording.velocity),
        )
        for sweep in sweeps
    ]


def torques(robot: Robot, joint: str, ways: Sequence[Way], runs: Sequence[TwinRun]) -> list[Array]:
    """Simulated effort of each run, N m (N), at the samples of its sweep; all in one call.

    The gear temperature at the start of a sweep follows from the sweeps before it, by `started_at`. Inexpressible if no
    scenario can contain an entry, or the simulator is unstable with it (a spring much too stiff for its load).
    """
    ratio = robot.axis(joint).gear_ratio
    trains = {id(run.entry): _held(DriveTrain, run.entry.train) for run in runs}
    measurements = {id(run.entry): _held(Measurement, run.entry.measurement) for run in runs}
    warm = {key: warmth(train, [way.turn for way in ways]) for key, train in trains.items()}
    axes: list[MovingAxis] = []
    for run in runs:
        train, inertia = trains[id(run.entry)], run.inertia / run.entry.scale
        # 0.02 of the axis' inertia: minimum inertia of the load
        load = max(inertia - train.motor_inertia * ratio**2, 0.02 * inertia)
        # the total inertia is the measured one, whatever motor inertia the entry has
        exact = train.model_copy(update={"motor_inertia": (inertia - load) / ratio**2})
        axes.append(MovingAxis(exact, ratio, load, Gravity(*run.gravity), float(warm[id(run.entry)][run.sweep])))
    led, recorded = [ways[run.sweep].motion for run in runs], [measurements[id(run.entry)] for run in runs]
    try:
        with np.errstate(over="raise", invalid="raise"):
            return replay(axes, led, recorded)
    except FloatingPointError:
        raise Inexpressible("the simulated load does not stay with its motor") from None


def _held(part: type[Part], entry: Mapping[str, object]) -> Part:
    try:
        return part.model_validate(entry)
    except ValidationError as error:
        first = error.errors()[0]
        raise Inexpressible(f"{'.'.join(str(part) for part in first['loc'])}: {first['msg']}") from None
