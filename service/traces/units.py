"""Units in measurement files, converted to SI on the joint side. A unit that is not listed here is rejected."""

import math
from collections.abc import Mapping

from service.errors import BadInput
from service.traces.mapping import Unit

Scaling = tuple[float, float]  # factor and offset

_TIME: Mapping[str, float] = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_ANGLE: Mapping[str, float] = {
    **{"rad": 1.0, "mrad": 1e-3},
    **dict.fromkeys(("deg", "degree", "degrees"), math.radians(1.0)),
}
_LENGTH: Mapping[str, float] = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
_TORQUE: Mapping[str, float] = {"Nm": 1.0, "kNm": 1e3, "mNm": 1e-3}
_FORCE: Mapping[str, float] = {"N": 1.0, "kN": 1e3, "mN": 1e-3}
_TEMPERATURE: Mapping[str, Scaling] = {"degC": (1.0, 0.0), "C": (1.0, 0.0), "K": (1.0, -273.15)}

# synonyms in files for each unit name in the mapping
_SAME: Mapping[Unit, frozenset[str]] = {
    "axis position": frozenset(("deg", "degree", "degrees", "mm")),
    "deg": frozenset(("deg", "degree", "degrees")),
    "mm": frozenset(("mm",)),
    "motor rev": frozenset(("rev", "turn", "turns", "U")),
    "motor rev/min": frozenset(("rpm", "1/min", "min^-1", "rev/min", "U/min")),
    "motor N m": frozenset(("Nm",)),
    "percent": frozenset(("%", "percent")),
    "ms": frozenset(("ms",)),
    "samples": frozenset(("1", "samples")),
}


def plain(unit: str) -> str:
    """The unit in its simplest notation: ``N·m`` and ``N m`` are ``Nm``, ``°/s`` is ``deg/s``."""
    for sign, word in (("°", "deg"), ("µ", "u"), ("μ", "u"), ("·", ""), ("⋅", ""), ("*", ""), (" ", "")):
        unit = unit.replace(sign, word)
    return unit


def check_same(said: Unit, unit: str, place: str) -> None:
    """BadInput if the unit in the mapping contradicts the unit in the file."""
    if plain(unit) not in _SAME[said]:
        raise BadInput(
            place,
            f"the mapping says {said!r}, the file says {unit!r}: correct the mapping, or give scale and offset",
        )


def to_si(column: str, unit: str, prismatic: bool, place: str) -> Scaling:
    """Factor and offset from a file's unit to SI of a bundle's column; values are assumed to be on the joint side.

    BadInput for a unit that is unknown or ambiguous: ``rpm`` may be of joint or motor, ``%`` of anything.
    """
    known = _units_of(column, prismatic)
    found = known.get(plain(unit))
    if found is None:
        raise BadInput(
            place,
            f"unit {unit!r} of the file is not a unit of {column} ({', '.join(known)}); "
            "give a unit, or scale and offset, in the mapping",
        )
    return found


def _units_of(column: str, prismatic: bool) -> Mapping[str, Scaling]:
    match column:
        case "time":
            factors = _TIME
        case "effort" | "excitation_effort":
            factors = _FORCE if prismatic else _TORQUE
        case "temperature":
            return _TEMPERATURE
        case "position" | "load_position" | "set_position":
            factors = _LENGTH if prismatic else _ANGLE
        case _:
            factors = _speeds(_LENGTH if prismatic else _ANGLE)
    return {name: (factor, 0.0) for name, factor in factors.items()}


def _speeds(ways: Mapping[str, float]) -> Mapping[str, float]:
    return {f"{name}/{per}": factor / _TIME[per] for name, factor in ways.items() for per in ("s", "min")}
