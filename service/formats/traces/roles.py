"""Which channel of a file is which column of a bundle: by what it measures and how it is called, in English and German.

A reader that knows its format (a control's signal, a joint state of ROS) states the role itself.
"""

import re
from collections.abc import Sequence
from itertools import pairwise

from service.formats.traces.containers.request import Listed, shown
from service.formats.traces.units import known_unit
from service.model.errors import BadInput

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
_SET = re.compile(
    r"^(set\w*|soll\w*|\w*soll|cmd\w*|command\w*|demand\w*|target\w*|ref\w*|desired|des|sp|nom\w*|\w*setpoint|\w*sollwert)$"
)
_ACTUAL = re.compile(r"^(act\w*|ist\w*|\w*ist|\w*istwert|real|meas\w*|fb|fbk|feedback|\w*actual\w*)$")
_OTHER = re.compile(
    r"^(err\w*|\w*fehler\w*|\w*err(or)?|dev\w*|\w*abweichung\w*|schlepp\w*|following|diff\w*|limit\w*|max\w*|min\w*|acc\w*|"
    r"beschl\w*|jerk|ruck|qdd|ddq|ddphi|tcp|cart\w*|pose|volt\w*|spannung|status\w*|state|mode|control|ff|feedforward|"
    r"friction|gravity|coriolis|model)$"
)
_SECOND = re.compile(r"^(2nd\w*|enc2|encoder2|load|abtrieb\w*|direct|ext\w*|link|secondary|ms2|messsystem2)$")
_AXIS = re.compile(
    r"\[(?:u\d+,\s*)?(\d+)\]|(?:axis|achse|joint|gelenk|drive|antrieb|robax|ax|[aj])[ _.]?(\d+)(?!\d)"
    r"|[A-Za-z_ .](\d{1,2})$",
    re.IGNORECASE,
)
_CAMEL = re.compile(r"(?<=[a-zäöü])(?=[A-ZÄÖÜ])|(?<=[A-ZÄÖÜ])(?=[A-ZÄÖÜ][a-zäöü])")


def axis_of(channel: Listed) -> str:
    """Number or name of the axis of a channel; "" if it states none."""
    if channel.axis:
        return channel.axis
    found = _AXIS.search(channel.name)
    return "" if found is None else next(part for part in found.groups() if part)


def role_of(channel: Listed) -> tuple[str, int]:
    """Role and rank, the smallest of the best; "" if it is of no use."""
    if channel.role:
        return channel.role, 0
    name = _AXIS.sub(lambda found: found[0][0] if found[3] else " ", channel.name)
    words = [word for word in re.split(r"[^0-9a-zäöüß]+", _CAMEL.sub("_", name).lower()) if word]
    words += [f"{one}_{other}" for one, other in pairwise(words)]
    quantity = known_unit(channel.unit)
    if any(_OTHER.match(word) for word in words):
        return "", 0
    role = next(
        (
            role
            for role, pattern in _WORDS.items()
            if (quantity is None or quantity in _QUANTITY[role])
            and any(re.fullmatch(pattern, word) for word in words if role == "load" or not _SECOND.match(word))
        ),
        _BY_QUANTITY.get(quantity or "", ""),
    )
    rank = 0 if any(_ACTUAL.match(word) for word in words) else 1
    if any(_SET.match(word) for word in words):
        # a torque set-point is nearly what the drive does, but a target (of a Universal Robot) is that of a model
        wanted = {"position": "set_position", "velocity": "velocity_setpoint"}
        role, rank = ("" if "target" in words and role in ("effort", "current") else wanted.get(role, role)), 2
    elif role in ("position", "velocity") and any(_SECOND.match(word) for word in words):
        role = f"load_{role}"
    return role, rank


def find_roles(listed: Sequence[Listed], file_axis: str, place: str) -> dict[str, Listed]:
    """The best channel of each role, of one axis. BadInput if there are several axes and none is chosen."""
    ranked = sorted(
        ((role_of(one)[1], k, role_of(one)[0], one) for k, one in enumerate(listed)), key=lambda one: one[:2]
    )
    of_axes = [(role, one) for _, _, role, one in ranked if role not in ("", "time", "temperature")]
    axes = list(dict.fromkeys(axis_of(one) for _, one in of_axes if axis_of(one)))
    roles = [role for role, _ in of_axes]
    numbered = len(axes) > 1 and any(roles.count(role) > 1 for role in roles)
    if file_axis and file_axis not in axes and axes:
        raise BadInput(place, f"has no channel of axis {file_axis!r}; there are those of {shown(sorted(axes))}")
    if numbered and not file_axis:
        raise BadInput(
            place, f"has channels of axes {shown(sorted(axes))}: choose one by --axis, or by `file_axis` of the sweep"
        )
    found: dict[str, Listed] = {}
    for _, _, role, one in ranked:
        if role and (not file_axis or axis_of(one) in ("", file_axis)):
            found.setdefault(role, one)
    return found
