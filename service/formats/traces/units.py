"""What a heading says: what its unit measures, with the factor to SI, and which column of a bundle it names.

A unit that fits a column has one meaning on the joint side. ``rpm`` may be of joint or motor, N m too, and ``%`` of
anything: those are decided by the motion (`service.formats.traces.meaning`), or by the mapping.

A role is the column of a bundle: by what a channel measures and how it is called, in English and German. A reader that
knows its format (a control's signal, a joint state of ROS) states the role itself.
"""

import math
import re
from collections.abc import Mapping, Sequence
from itertools import pairwise

from service import BadInput
from service.formats.traces.containers import ListedChannel, shown
from service.formats.traces.mapping import Unit

Scaling = tuple[float, float]  # factor and offset

_TIME = {
    "s": 1.0,
    "ms": 1e-3,
    "us": 1e-6,
    "ns": 1e-9,
    "min": 60.0,
    "sec": 1.0,
    "seconds": 1.0,
    "msec": 1e-3,
    "usec": 1e-6,
}
_DEGREE = math.radians(1.0)
_ANGLE = {"rad": 1.0, "mrad": 1e-3, **dict.fromkeys(("deg", "degree", "degrees", "Grad", "grad"), _DEGREE)}
_LENGTH = {"m": 1.0, "mm": 1e-3, "um": 1e-6}


def _speeds(ways: Mapping[str, float]) -> dict[str, float]:
    return {f"{name}/{per}": factor / _TIME[per] for name, factor in ways.items() for per in ("s", "min", "sec")}


QUANTITIES: Mapping[str, Mapping[str, float]] = {
    "time": _TIME,
    "angle": _ANGLE,
    "length": _LENGTH,
    "angular speed": {**_speeds(_ANGLE), "dps": _DEGREE},
    "speed": _speeds(_LENGTH),
    "turns": dict.fromkeys(("rev", "turn", "turns", "U", "Umdr"), math.tau),
    "turns per time": {
        **dict.fromkeys(
            ("rpm", "1/min", "min^-1", "min-1", "rev/min", "U/min", "r/min", "/min", "min⁻¹", "Upm"), math.tau / 60
        ),
        **dict.fromkeys(("rev/s", "1/s", "rps", "U/s"), math.tau),
    },
    "torque": {"Nm": 1.0, "kNm": 1e3, "mNm": 1e-3, "Ncm": 1e-2},
    "force": {"N": 1.0, "kN": 1e3, "mN": 1e-3},
    "current": {"A": 1.0, "mA": 1e-3, "Aeff": 1.0, "Arms": 1.0, "A_rms": 1.0, "Apk": math.sqrt(0.5)},
    "part": {"%": 1e-2, "percent": 1e-2, "Prozent": 1e-2, "‰": 1e-3, "permille": 1e-3, "0.1%": 1e-3},
    "temperature": {"degC": 1.0, "C": 1.0, "K": 1.0, "celsius": 1.0},
}
"""Factor to SI by unit; turns in rad, parts of one."""
_FOLDED = {
    name.casefold(): (quantity, factor)
    for quantity, units in QUANTITIES.items()
    for name, factor in units.items()
    if len(name) > 2 and name not in ("mNm", "kNm")
}

_SAID: Mapping[Unit, tuple[str, float]] = {
    "deg": ("angle", _DEGREE),
    "mm": ("length", 1e-3),
    "motor rev": ("turns", math.tau),
    "motor rev/min": ("turns per time", math.tau / 60),
    "motor N m": ("torque", 1.0),
    "percent": ("part", 1e-2),
    "ms": ("time", 1e-3),
}


def plain(unit: str) -> str:
    """The unit in its simplest notation: ``N·m`` and ``N m`` are ``Nm``, ``°/s`` is ``deg/s``."""
    for sign, word in (("°", "deg"), ("º", "deg"), ("µ", "u"), ("μ", "u"), ("·", ""), ("⋅", ""), ("*", ""), (" ", "")):
        unit = unit.replace(sign, word)
    return unit


def measures(unit: str) -> tuple[str, float] | None:
    """Quantity and factor of a unit; None if it is not known."""
    bare = plain(unit)
    for quantity, units in QUANTITIES.items():
        if bare in units:
            return quantity, units[bare]
    return _FOLDED.get(bare.casefold())


def known_unit(unit: str) -> str | None:
    """Quantity of a unit; None if it is not known."""
    return (measures(unit) or (None,))[0]


def unit_in(heading: str) -> tuple[str, str]:
    """Name and unit of a heading, as ``M [Nm]``, ``n / rpm``, ``position_deg``; "" if it has none."""
    suffix = re.compile(
        r"^(?P<name>.+?)_(?P<unit>rad_?p?s|deg_?p?s|mm_?p?s|m_?p?s|rad|deg|mm|nm|rpm|ms|us|ns|sec|pct|percent|amps?|s|a)$",
        re.IGNORECASE,
    )
    brackets = re.compile(
        r"^(?P<name>.*?)[\s_]*(?:[\[(<{]\s*(?P<unit>[^\])>}]+?)\s*[\])>}]|\s(?:in|/)\s+(?P<bare>\S+)|,\s*(?P<after>\S+))$"
    )
    if found := brackets.match(heading):
        unit = (found["unit"] or found["bare"] or found["after"]).strip()
        if found["name"] and (
            known_unit(unit) or (found["unit"] and not re.fullmatch(r"[A-Za-z]?\d[\d, ]*|[xyzXYZ]|u\d+,.*", unit))
        ):
            return found["name"].strip(), unit
    if found := suffix.match(heading):
        unit = per = found["unit"].lower()
        if len(unit) > 2 and unit.endswith("s") and unit != "amps":
            per = re.sub(r"(?<=[dgm])s$", "/s", unit.replace("_", "").replace("ps", "/s"))
        return heading, {"nm": "Nm", "amp": "A", "amps": "A", "a": "A", "pct": "%"}.get(per, per)
    return heading, ""


def check_same(said: Unit, unit: str, place: str) -> None:
    """BadInput if the unit in the mapping contradicts the unit in the file."""
    given = measures(unit)
    match said:
        case "samples":
            fits = plain(unit) in ("1", "samples")
        case "axis position":
            fits = given in (("angle", _DEGREE), ("length", 1e-3))
        case _:
            fits = given == _SAID[said]
    if not fits:
        raise BadInput(
            place, f"the mapping says {said!r}, the file says {unit!r}: correct the mapping, or give scale and offset"
        )


def to_si(column: str, unit: str, prismatic: bool, place: str) -> Scaling:
    """Factor and offset from a file's unit to SI of a bundle's column; values are assumed to be on the joint side.

    BadInput for a unit that is unknown or ambiguous: ``rpm`` may be of joint or motor, ``%`` of anything.
    """
    known, found = QUANTITIES[quantity_of(column, prismatic)], measures(unit)
    if found is None or found[0] != quantity_of(column, prismatic):
        raise BadInput(
            place,
            f"unit {unit!r} of the file is not a unit of {column} ({', '.join(known)}); "
            "give a unit, or scale and offset, in the mapping",
        )
    return found[1], -273.15 if column == "temperature" and plain(unit) == "K" else 0.0


def quantity_of(column: str, prismatic: bool) -> str:
    """What a bundle's column measures on the joint side."""
    match column:
        case "time" | "temperature":
            return column
        case "effort" | "excitation_effort":
            return "force" if prismatic else "torque"
        case "position" | "load_position" | "set_position":
            return "length" if prismatic else "angle"
        case _:
            return "speed" if prismatic else "angular speed"


_WORDS: dict[str, str] = {
    "time": r"time|zeit|uhrzeit|t|timestamps?|zeitstempel|clock|stamp|sec|seconds|cycle|datetime|datum_zeit|date_time",
    "temperature": r"temp\w*|therm\w*",
    "current": r"i|iq|i_q|curr\w*|strom\w*|i_?ist|amps?|motorstrom",
    "effort": r"effort\w*|torq\w*|trq|\w*moment\w*|m|m_?ist|mact|tau|force|kraft|6077|tq|antriebsmoment",
    "load": r"load|auslastung|drvload\w*|utili[sz]ation",
    "velocity": r"vel\w*|speed\w*|\w*drehzahl\w*|\w*geschw\w*|n|n_?ist|nact|omega|w|qd|dq|v|v_?ist|rpm|606c|qvel|"
    r"qdot|phidot",
    "position": r"pos\w*|\w*lage\w*|\w*position\w*|\w*winkel\w*|ang\w*|phi\w*|q|theta|enc\w*|axis_?act|6064|way|weg|"
    r"s|x_?ist|s_?ist|qpos",
}
_QUANTITY = {
    "time": ("time",),
    "temperature": ("temperature",),
    "current": ("current",),
    "effort": ("torque", "force", "part"),
    "load": ("part",),
    "velocity": ("angular speed", "speed", "turns per time", "part"),
    "position": ("angle", "length", "turns"),
}
_BY_QUANTITY = {
    "time": "time", "temperature": "temperature", "current": "current", "torque": "effort", "force": "effort",
    "angular speed": "velocity", "speed": "velocity", "turns per time": "velocity", "angle": "position",
    "length": "position", "turns": "position",
}  # fmt: skip
_AXIS = re.compile(
    r"\[(?:u\d+,\s*)?(\d+)\]|(?:axis|achse|joint|gelenk|drive|antrieb|robax|ax|[aj])[ _.]?(\d+)(?!\d)"
    r"|[A-Za-z_ .](\d{1,2})$",
    re.IGNORECASE,
)


def axis_of(channel: ListedChannel) -> str:
    """Number or name of the axis of a channel; "" if it states none."""
    if channel.axis:
        return channel.axis
    found = _AXIS.search(channel.name)
    return "" if found is None else next(part for part in found.groups() if part)


def role_of(channel: ListedChannel) -> tuple[str, int]:
    """Role and rank, the smallest of the best; "" if it is of no use."""
    second = re.compile(r"^(2nd\w*|enc2|encoder2|load|abtrieb\w*|direct|ext\w*|link|secondary|ms2|messsystem2)$")
    camel = re.compile(r"(?<=[a-zäöü])(?=[A-ZÄÖÜ])|(?<=[A-ZÄÖÜ])(?=[A-ZÄÖÜ][a-zäöü])")
    different = re.compile(
        r"^(err\w*|\w*fehler\w*|\w*err(or)?|dev\w*|\w*abweichung\w*|schlepp\w*|following|diff\w*|limit\w*|max\w*|min\w*|acc\w*|"
        r"beschl\w*|jerk|ruck|qdd|ddq|ddphi|tcp|cart\w*|pose|volt\w*|spannung|status\w*|state|mode|control|ff|feedforward|"
        r"friction|gravity|coriolis|model)$"
    )
    actual = re.compile(r"^(act\w*|ist\w*|\w*ist|\w*istwert|real|meas\w*|fb|fbk|feedback|\w*actual\w*)$")
    commanded = re.compile(
        r"^(set\w*|soll\w*|\w*soll|cmd\w*|command\w*|demand\w*|target\w*|ref\w*|desired|des|sp|nom\w*|\w*setpoint|\w*sollwert)$"
    )
    if channel.role:
        return channel.role, 0
    name = _AXIS.sub(lambda found: found[0][0] if found[3] else " ", channel.name)
    words = [word for word in re.split(r"[^0-9a-zäöüß]+", camel.sub("_", name).lower()) if word]
    words += [f"{one}_{other}" for one, other in pairwise(words)]
    quantity = known_unit(channel.unit)
    if any(different.match(word) for word in words):
        return "", 0
    role = next(
        (
            role
            for role, pattern in _WORDS.items()
            if (quantity is None or quantity in _QUANTITY[role])
            and any(re.fullmatch(pattern, word) for word in words if role == "load" or not second.match(word))
        ),
        _BY_QUANTITY.get(quantity or "", ""),
    )
    rank = 0 if any(actual.match(word) for word in words) else 1
    if any(commanded.match(word) for word in words):
        # a torque set-point is nearly what the drive does, but a target (of a Universal Robot) is that of a model
        wanted = {"position": "set_position", "velocity": "velocity_setpoint"}
        role, rank = ("" if "target" in words and role in ("effort", "current") else wanted.get(role, role)), 2
    elif role in ("position", "velocity") and any(second.match(word) for word in words):
        role = f"load_{role}"
    return role, rank


def find_roles(listed: Sequence[ListedChannel], file_axis: str, place: str) -> dict[str, ListedChannel]:
    """The best channel of each role, of one axis. BadInput if there are several axes and none is chosen."""
    ranked = sorted(((*role_of(one), one) for one in listed), key=lambda one: one[1])
    of_axes = [(role, one) for role, _, one in ranked if role not in ("", "time", "temperature")]
    axes = list(dict.fromkeys(axis_of(one) for _, one in of_axes if axis_of(one)))
    roles = [role for role, _ in of_axes]
    numbered = len(axes) > 1 and any(roles.count(role) > 1 for role in roles)
    if file_axis and file_axis not in axes and axes:
        raise BadInput(place, f"has no channel of axis {file_axis!r}; there are those of {shown(sorted(axes))}")
    if numbered and not file_axis:
        raise BadInput(
            place, f"has channels of axes {shown(sorted(axes))}: choose one by --axis, or by `file_axis` of the sweep"
        )
    found: dict[str, ListedChannel] = {}
    for role, _, one in ranked:
        if role and (not file_axis or axis_of(one) in ("", file_axis)):
            found.setdefault(role, one)
    return found
