"""Known units other than SI on the joint side, found from the factor by which a channel is wrong."""

import numpy as np

from service.data_check.record import AxisRecords

TURN = 2 * np.pi


def motion_unit(axis: AxisRecords, gain: float, *, velocity: bool) -> str | None:
    """The unit in which a position (or velocity) is `gain` times the SI value; None if there is none."""
    close = 0.04  # relative: a wrong unit gives an exact factor
    if gain == 0:
        return None
    ratio = abs(axis.axis.gear_ratio)
    side = {"": 1.0} | ({" on the motor side": ratio} if abs(ratio - 1) > close else {})
    turning = {"rad": 1.0, "degrees": 360 / TURN, "turns": 1 / TURN}
    # a control that treats a linear axis as a rotary one gives degrees
    own = {"mm": 1e3, "degrees": 360 / TURN} if axis.prismatic else turning
    rates = {"/s": 1.0, "/min": 60.0} if velocity else {"": 1.0}
    names = {
        f"{unit}{rate}{where}": factor * per * gear
        for where, gear in side.items()
        for unit, factor in (turning if where else own).items()
        for rate, per in rates.items()
    }
    near = {name: abs(np.log(abs(gain) / factor)) for name, factor in names.items() if abs(factor - 1) > close}
    best = min(near, key=lambda name: near[name], default=None)
    return best if best is not None and near[best] < close else None


def effort_units(axis: AxisRecords) -> dict[str, float]:
    """Units other than SI on the joint side, and their factors."""
    rated, ratio = axis.axis.rated_effort, abs(axis.axis.gear_ratio)
    unit = axis.unit
    return {
        "mN" if axis.prismatic else "N mm": 1e3,
        f"k{unit}": 1e-3,
        "percent of rated effort": 100 / rated,
        "per mille of rated effort": 1000 / rated,
        "parts of rated effort": 1 / rated,
        f"{unit} on the motor side": 1 / ratio,
        "N mm on the motor side": 1e3 / ratio,
    }


def effort_unit(axis: AxisRecords, gain: float, within: float) -> str | None:
    """The unit in which effort is `gain` times that of the model, within a factor exp(`within`); None if none."""
    near = {name: abs(np.log(abs(gain) / factor)) for name, factor in effort_units(axis).items()} if gain else {}
    best = min(near, key=lambda name: near[name], default=None)
    return best if best is not None and near[best] < within else None
