"""The drive's measuring function through registers: a sweep's parameters, and the samples in a trace page. Pure."""

from collections.abc import Mapping, Sequence

import numpy as np

from drivers.errors import CommunicationLost, LimitExceeded, WrongConfiguration
from drivers.modbus.codec import Array
from drivers.modbus.profile import ModbusAxis
from drivers.modbus.registers import Signal, Trace
from drivers.modbus.unit import Setting
from drivers.modbus.units import Gear
from drivers.ports import SampleBlock, SweepCommand

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
