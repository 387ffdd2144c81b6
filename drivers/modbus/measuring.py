"""The drive's measuring function through registers: a sweep's parameters, and the samples in a trace page. Pure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.errors import CommunicationLost, LimitExceeded, WrongConfiguration
from drivers.modbus.profile import ModbusAxis
from drivers.modbus.registers import Array, Signal, Trace
from drivers.modbus.unit import Setting
from drivers.ports import SampleBlock, SweepCommand

Value = TypeVar("Value", float, NDArray[np.float64])


@dataclass(frozen=True, slots=True)
class Gear:
    """Conversions of one axis."""

    ratio: float
    position_offset: float  # rad (m)
    rated_torque: float  # N m of the motor

    def position(self, revolutions: Value) -> Value:
        """Motor rev -> rad (m)."""
        return revolutions * (math.tau / self.ratio) + self.position_offset

    def velocity(self, rev_per_min: Value) -> Value:
        """Motor rev/min -> rad/s (m/s)."""
        return rev_per_min * (math.tau / 60 / self.ratio)

    def effort(self, torque: Value) -> Value:
        """Motor N m -> N m (N)."""
        return torque * self.ratio

    def effort_of_permille(self, permille: float) -> float:
        """Per mille of the rated torque -> N m (N)."""
        return self.effort(permille * 1e-3 * self.rated_torque)

    def revolutions(self, position: float) -> float:
        """rad (m) -> motor rev."""
        return (position - self.position_offset) * (self.ratio / math.tau)

    def rev_per_min(self, velocity: float) -> float:
        """rad/s (m/s) -> motor rev/min, signed."""
        return velocity * (self.ratio * 60 / math.tau)

    def speed(self, speed: float) -> float:
        """As `rev_per_min` for a magnitude; also rad/s^2 (m/s^2) -> rev/min/s."""
        return abs(self.rev_per_min(speed))

    def permille(self, effort: float) -> float:
        """Magnitude of an effort, N m (N) -> per mille of the rated torque."""
        return effort / (self.rated_torque * abs(self.ratio)) * 1e3

    def window(self, window: tuple[float, float]) -> tuple[float, float]:
        """Joint limits -> motor rev, low before high whatever the gear's sign."""
        low, high = sorted(self.revolutions(limit) for limit in window)
        return low, high


NONE, START, ABORT = 0, 1, 2  # measuring_command

REASONS = {1: "axis not enabled, or not at standstill", 2: "speed", 3: "position window", 4: "parameters"}

NEAR = 1e-4  # relative error of a parameter allowed by the resolution of its register; phases: rad
DRIFT = 1e-3  # periods, drift of a sine over the sweep allowed by the resolution of its frequency


def trace_cycle(command: SweepCommand) -> int:
    """Trace cycle in ms, as close to the requested sample rate as the drive supports."""
    return max(1, round(1e3 / command.sample_rate))


def parameters(command: SweepCommand, signals: Mapping[str, Signal], gear: Gear) -> list[Setting]:
    """All parameters of a sweep in the units of their signals. Raises LimitExceeded for more sines than the map has."""
    single = {
        "offset_speed": gear.rev_per_min(command.offset_velocity),
        "ramp": command.ramp,
        "settle": command.settle,
        "period": command.period,
        "periods": float(command.periods),
        "sines": float(len(command.sines)),
        "trace_cycle": float(trace_cycle(command)),
    }
    settings = [Setting(signals[name], value, NEAR * abs(value)) for name, value in single.items()]
    frequencies, amplitudes, phases = (signals[name].elements() for name in ("frequency", "amplitude", "phase"))
    room = min(len(frequencies), len(amplitudes), len(phases))
    if len(command.sines) > room:
        raise LimitExceeded(command.joint, f"{len(command.sines)} sines are more than the register map's {room}")
    for sine, frequency, amplitude, phase in zip(command.sines, frequencies, amplitudes, phases, strict=False):
        # A negative gear ratio makes the amplitude negative and does not change the phase.
        speed = gear.rev_per_min(sine.amplitude)
        settings += [
            Setting(frequency, sine.frequency, DRIFT / command.duration),
            Setting(amplitude, speed, NEAR * abs(speed)),
            Setting(phase, sine.phase, NEAR),
        ]
    return settings


def samples(
    registers: Sequence[int], first: int, count: int, trace: Trace, axis: ModbusAxis, gear: Gear, cycle_ms: int
) -> SampleBlock:
    """The samples `first` to `first + count` from the registers of a page. Raises CommunicationLost if it has others.

    Raises WrongConfiguration if they lack the direct encoder of the profile.
    """
    place = f"{axis.joint} (unit {axis.unit_id})"
    columns = _columns(registers, count, trace)
    index = columns["cycle"].astype(np.int64)
    if not np.array_equal(index, np.arange(first, first + count)):
        raise CommunicationLost(place, f"trace page from {first} holds other samples")
    load = columns.pop("load_position", None)
    if not all(np.isfinite(column).all() for column in columns.values()):
        raise CommunicationLost(place, f"trace page from {first} holds no numbers")
    load_position = None
    if axis.load_encoder:
        if load is None or np.isnan(load).any():
            raise WrongConfiguration(place, "the profile says load_encoder, the trace holds none")
        load_position = load * (axis.load_encoder_direction * 2 * np.pi)
    return SampleBlock(
        joint=axis.joint,
        index=index,
        time=index.astype(float) * (cycle_ms * 1e-3),
        effort=gear.effort(columns["torque"]),
        velocity=gear.velocity(columns["speed"]),
        position=gear.position(columns["position"]),
        velocity_setpoint=gear.velocity(columns["set_speed"]),
        load_position=load_position,
    )


def _columns(registers: Sequence[int], count: int, trace: Trace) -> dict[str, Array]:
    """(count,) of each signal. The lowest value of an integer register means that there is no load encoder: NaN."""
    table = np.asarray(registers, np.uint16).reshape(count, trace.width)
    columns: dict[str, Array] = {}
    start = 0
    for name, each in trace.sample:
        values = each.decode(table[:, start : start + each.width])
        start += each.width
        if name == "load_position" and each.whole:
            values[values == each.least] = np.nan
        columns[name] = values
    return columns
