"""Feedback of a foreign drive: the statusword with the bits of its mode, and actual values in its units."""

from math import inf
from typing import Protocol

from simulator.drive.measuring import Samples
from simulator.drive.states import State
from simulator.foreign.dictionary import ForeignDictionary
from simulator.foreign.faults import ErrorCode, ErrorLog
from simulator.foreign.modes import Guide, Mode
from simulator.foreign.units import Units

_STANDSTILL = 0.5 / 60  # rev/s
_PER_MILLE = 1000


class MotionValues(Protocol):
    """The properties of an axis used in the statusword."""

    position: float
    speed: float
    state: State
    mode: Mode
    emergency_stop: bool
    errors: ErrorLog
    guide: Guide
    units: Units

    @property
    def following(self) -> bool: ...


def statusword(axis: MotionValues, *, acknowledged: bool) -> int:
    """6041h: the state, voltage (4), remote (9), target reached (10), limit (11) and the mode's 12 and 13."""
    guide, enabled = axis.guide, axis.state is State.OPERATION_ENABLED
    reached = axis.state is State.QUICK_STOP_ACTIVE and not guide.moving
    twelve = False
    if enabled:
        match axis.mode:
            case Mode.PROFILE_POSITION:
                reached, twelve = not guide.moving and _arrived(axis), acknowledged
            case Mode.PROFILE_VELOCITY:
                reached, twelve = not guide.limited and _at_speed(axis), abs(axis.speed) < _STANDSTILL
            case Mode.INTERPOLATED_POSITION:
                twelve = axis.following and guide.running
            case Mode.CYCLIC_POSITION | Mode.CYCLIC_VELOCITY:
                twelve = axis.following
            case Mode.NONE:
                pass
    bits = {
        0x0010: not axis.emergency_stop,
        0x0200: True,
        0x0400: reached,
        0x0800: enabled and guide.limited,
        0x1000: twelve,
        0x2000: axis.errors.code == ErrorCode.FOLLOWING,
    }
    return int(axis.state) | sum(bit for bit, on in bits.items() if on)


def _arrived(axis: MotionValues) -> bool:
    target = axis.guide.target
    return abs(axis.speed) < _STANDSTILL and (target is None or abs(target - axis.position) < 1e-3)


def _at_speed(axis: MotionValues) -> bool:
    return abs(axis.speed - axis.guide.command) < max(0.05 * abs(axis.guide.command), _STANDSTILL)


def set_actual_values(
    dictionary: ForeignDictionary, units: Units, guide: Guide, samples: Samples, glitch: float, span: float
) -> None:
    """Position, speed, torque and current as means over the last cycles; the encoder is wrong by `glitch`, rev."""
    d, rated = dictionary, units.rated_torque
    position = float(samples.position.mean()) + glitch
    speed = float(samples.speed.mean()) + glitch / span
    permille = round(float(samples.torque.mean()) / rated * _PER_MILLE)
    d.set_actual(0x6064, round(position * units.position))
    d.set_actual(0x6063, round(position * d.maker.increments))
    d.set_actual(0x6062, round(guide.reference * units.position))
    for index in (0x6069, 0x606C):
        d.set_actual(index, round(speed * units.velocity))
    d.set_actual(0x606B, round(guide.command * units.velocity))
    for index in (0x6074, 0x6077):
        d.set_actual(index, permille)
    current = float(samples.torque.mean()) / units.plate.torque_constant
    rated_current = d.get(0x6075) * 1e-3 or inf
    d.set_actual(0x6078, round(current / rated_current * _PER_MILLE))
    if (0x60F4, 0) in d and guide.tracking:
        d.set_actual(0x60F4, round((guide.reference - position) * units.position))
