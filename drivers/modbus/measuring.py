"""The drive's measuring function through registers: a sweep's parameters, and the samples in a trace page. Pure."""

from collections.abc import Mapping, Sequence

import numpy as np

from drivers.cia402.device import trace_cycle
from drivers.cia402.profile import Gear
from drivers.errors import LimitExceeded
from drivers.modbus.registers import Array, RegisterSignal, TraceLayout
from drivers.modbus.unit import RegisterSetting
from drivers.ports import SweepCommand


def parameters(command: SweepCommand, signals: Mapping[str, RegisterSignal], gear: Gear) -> list[RegisterSetting]:
    """All parameters of a sweep in the units of their signals. Raises LimitExceeded for more sines than the map has.

    A register may change a parameter by 1e-4 of it, a phase by 1e-4 rad, and let a sine drift by 1e-3 of a period.
    """
    near = 1e-4
    single = {
        "offset_speed": gear.rev_per_min(command.offset_velocity),
        "ramp": command.ramp,
        "settle": command.settle,
        "period": command.period,
        "periods": float(command.periods),
        "sines": float(len(command.sines)),
        "trace_cycle": float(trace_cycle(command)),
    }
    settings = [RegisterSetting(signals[name], value, near * abs(value)) for name, value in single.items()]
    frequencies, amplitudes, phases = (signals[name].elements() for name in ("frequency", "amplitude", "phase"))
    room = min(len(frequencies), len(amplitudes), len(phases))
    if len(command.sines) > room:
        raise LimitExceeded(command.joint, f"{len(command.sines)} sines are more than the register map's {room}")
    for sine, frequency, amplitude, phase in zip(command.sines, frequencies, amplitudes, phases, strict=False):
        # A negative gear ratio makes the amplitude negative and does not change the phase.
        speed = gear.rev_per_min(sine.amplitude)
        settings += [
            RegisterSetting(frequency, sine.frequency, 1e-3 / command.duration),
            RegisterSetting(amplitude, speed, near * abs(speed)),
            RegisterSetting(phase, sine.phase, near),
        ]
    return settings


def columns(registers: Sequence[int], count: int, trace: TraceLayout) -> dict[str, Array]:
    """(count,) of each signal. The lowest value of an integer register means that there is no load encoder: NaN."""
    table = np.asarray(registers, np.uint16).reshape(count, trace.width)
    found: dict[str, Array] = {}
    start = 0
    for name, each in trace.sample:
        values = each.decode(table[:, start : start + each.width])
        start += each.width
        if name == "load_position" and each.whole:
            values[values == each.least] = np.nan
        found[name] = values
    return found
