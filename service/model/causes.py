"""Causes in words, from the English texts of the pages: what happened and the next step, in degrees and mm."""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from drivers.errors import Cause, CauseCode, distinct

_UNITS = {"rad": (math.degrees(1), "°"), "rad/s": (math.degrees(1), "°/s"), "m": (1e3, " mm"), "m/s": (1e3, " mm/s")}


@cache
def _texts() -> Mapping[str, str]:
    return json.loads((Path(__file__).parents[1] / "web/hmi/texts/en.json").read_text("utf-8"))


def in_words(cause: Cause) -> str:
    """As in ``joint_2: outside its limits (30.01°, limit 30°). Find out why ...``, with the sentence of the log."""
    words = {"axis": cause.joint or _texts()["cause-of.machine"], "by": cause.by, "why": cause.detail}
    told, step = (_texts()[f"{kind}.{cause.code}"].format(**words) for kind in ("cause", "step"))
    measured = _measured(cause)
    log = "" if cause.code is CauseCode.STOPPED or not cause.detail else f" [{cause.detail}]"
    return f"{told}{f' ({measured})' if measured else ''}. {step}{log}"


def read(answer: Mapping[str, Any]) -> Cause:
    """The cause in an answer of the API."""
    return replace(Cause(**answer), code=CauseCode(answer["code"]))


def _measured(cause: Cause) -> str:
    scale, unit = _UNITS.get(cause.unit, (1.0, f" {cause.unit}"))
    if cause.value is not None and cause.unit == "hex":
        return f"{round(cause.value):04X}h"
    if cause.value is None:
        return "" if cause.limit is None else f"limit {cause.limit * scale:.4g}{unit}"
    if cause.limit is None:
        return f"{cause.value * scale:.4g}{unit}"
    value, limit = distinct(cause.value * scale, cause.limit * scale, digits=4)
    return f"{value}{unit}, limit {limit}{unit}"
