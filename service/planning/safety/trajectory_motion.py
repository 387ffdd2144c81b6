"""The motion of all joints while several axes run their sweeps together, as commanded."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.ports import SweepCommand
from service.identification.design.excitation import Excitation, velocity_setpoint, way
from service.identification.model.inverse_dynamics import JointMotion
from service.model.recording import Sine

Array = NDArray[np.float64]

PATH_RATE = 50.0  # Hz, at which a trajectory is checked: its harmonics are far below


def commanded_motion(joints: Sequence[str], commands: Sequence[SweepCommand], pose: Sequence[float]) -> JointMotion:
    """From standstill at `pose` (n,) to standstill, (m, n); joints without a command stand."""
    duration = commands[0].duration
    time = np.linspace(0.0, duration, max(2, round(duration * PATH_RATE) + 1))
    position = np.tile(np.asarray(pose, dtype=float), (len(time), 1))
    velocity = np.zeros_like(position)
    for command in commands:
        index = joints.index(command.joint)
        position[:, index] += path_of(command, time)
        velocity[:, index] = velocity_setpoint(_excitation(command), time)
    return JointMotion(position, velocity, np.asarray(np.gradient(velocity, time, axis=0), dtype=float))


def path_of(command: SweepCommand, time: Array) -> Array:
    """Position relative to the start at `time` (m,), s since the start; rad (m)."""
    return way(_excitation(command), time)


def _excitation(command: SweepCommand) -> Excitation:
    sines = tuple(Sine(frequency=sine.frequency, amplitude=sine.amplitude, phase=sine.phase) for sine in command.sines)
    return Excitation(command.offset_velocity, sines, command.period, command.periods, command.ramp, command.settle)
