"""What anybody would try first on a log of all axes: least squares on filtered samples, with Pinocchio's regressor.

Five of them: ordinary, weighted by axis, weighted without the samples at rest, the same with a filter at half the
frequency, and weighted with a ridge. Parameters (14 n,) are in the order of `service...inverse_dynamics`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from service.model import Robot, Sweep

Array = NDArray[np.float64]
Moves = NDArray[np.bool_]

CUT = 8.0  # Hz


@dataclass(frozen=True)
class FilteredMotion:
    """Efforts of all axes with the motion of motors and loads, (m, n) each, filtered and thinned; where axes move."""

    effort: Array
    speed: Array
    gain: Array
    load: tuple[Array, Array, Array]  # position, speed, acceleration
    moves: Moves


def motion(sweeps: Sequence[Sweep], cut: float = CUT) -> FilteredMotion:
    """Of one log."""
    rate = sweeps[0].spec.sample_rate
    filtered = butter(4, min(cut, 0.3 * rate), fs=rate, output="sos")
    effort, motor, load = (
        sosfiltfilt(filtered, np.stack(columns, -1), axis=0)
        for columns in (
            [s.recording.effort for s in sweeps],
            [s.recording.position for s in sweeps],
            [s.recording.position if s.recording.load_position is None else s.recording.load_position for s in sweeps],
        )
    )
    speed, load_speed = (np.gradient(x, 1 / rate, axis=0) for x in (motor, load))
    gain, load_gain = (np.gradient(x, 1 / rate, axis=0) for x in (speed, load_speed))
    kept = slice(round(rate / 2), -round(rate / 2), max(1, round(rate / 50)))
    moves = np.abs(speed[kept]) > 0.02 * np.abs(speed).max(axis=0)
    return FilteredMotion(effort[kept], speed[kept], gain[kept], (load[kept], load_speed[kept], load_gain[kept]), moves)


def samples(robot: Robot, sweeps: Sequence[Sweep], cut: float = CUT) -> tuple[Array, Array, Moves]:
    """Rows (m, n, 14 n), efforts (m, n) and whether an axis moves (m, n)."""
    moved = motion(sweeps, cut)
    model = pin.buildModelFromXML(robot.urdf_text)
    model.gravity.linear = np.array(robot.gravity)
    data = model.createData()
    links = [pin.computeJointTorqueRegressor(model, data, *x).copy() for x in zip(*moved.load, strict=True)]
    own = (moved.gain, moved.speed, np.sign(moved.speed), np.ones_like(moved.speed))
    rows = np.concatenate([np.array(links), *(part[..., None] * np.eye(part.shape[1]) for part in own)], axis=-1)
    return rows, moved.effort, moved.moves


def simple(robot: Robot, sweeps: Sequence[Sweep]) -> dict[str, Array]:
    """The parameters (14 n,) of the five."""
    rows, effort, moves = samples(robot, sweeps)
    slow, slow_effort, slowly = samples(robot, sweeps, CUT / 2)
    everywhere = np.ones_like(moves)
    ordinary = _fit(rows, effort, everywhere, np.ones(effort.shape[1]))
    return {
        "ordinary": ordinary,
        "weighted": _weighted(rows, effort, everywhere, ordinary),
        "moving": _weighted(rows, effort, moves, ordinary),
        "slow": _weighted(slow, slow_effort, slowly, ordinary),
        "ridge": _weighted(rows, effort, moves, ordinary, 1e-4),
    }


Law = Callable[[Array], Array]


def errors(robot: Robot, sweeps: Sequence[Sweep], parameters: Array, laws: Mapping[str, Law] | None = None) -> Array:
    """RMS of the unpredicted effort of every axis where it moves, of the RMS of its effort, (n,). `laws` by joint:
    friction at a velocity beyond Coulomb and viscous.
    """
    rows, effort, moves = samples(robot, sweeps)
    left = effort - rows @ parameters
    for joint, law in (laws or {}).items():
        left[:, robot.index(joint)] -= law(rows[:, robot.index(joint), 11 * len(robot.axes) + robot.index(joint)])
    return np.sqrt(np.sum(left**2 * moves, axis=0) / np.sum(effort**2 * moves, axis=0))


def _weighted(rows: Array, effort: Array, used: Moves, start: Array, ridge: float = 0.0) -> Array:
    left = (effort - rows @ start) ** 2 * used
    return _fit(rows, effort, used, np.sqrt(left.sum(axis=0) / np.maximum(used.sum(axis=0), 1)), ridge)


def _fit(rows: Array, effort: Array, used: Moves, std: Array, ridge: float = 0.0) -> Array:
    white: Array = (rows / std[:, None])[used]
    scale = np.linalg.norm(white, axis=0)
    scale[scale == 0] = 1.0
    values = (effort / std)[used]
    more = np.sqrt(ridge) * np.eye(len(scale)) if ridge else np.zeros((0, len(scale)))
    stacked = np.vstack([white / scale, more])
    return np.linalg.lstsq(stacked, np.concatenate([values, np.zeros(len(more))]), rcond=1e-8)[0] / scale
