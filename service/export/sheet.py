"""The result in the values that controls and drives take, with uncertainty, validity, and the place to type it.

A control takes one inertia an axis, although J depends on the pose: the sheet tells the median over the measured
poses and how far it goes. On the motor's side that is J / u^2, u motor revolutions per joint revolution (rad per m),
the motor included as the sweep measures it. Standard deviations: of the model over the workspace where it is known,
else the median of the sweeps, and that of the torque constant.

What a load is (mass, centre, inertia) an estimate of the robot does not tell: only combinations of the links'
parameters show. It comes from `sweepid payload`.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from service.configuration import bad_field
from service.errors import BadInput
from service.identification.model.certainty import UNSURE, share_of_value
from service.identification.model.physical_consistency import is_physical
from service.robot import Robot

Array = NDArray[np.float64]
Document = dict[str, Any]

FORMAT = "sweepid-sheet"


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class _Sweep(_Part):
    sweep: str
    value: float
    std: float
    reference: float
    identified: float


class _Gain(_Part):
    value: float
    std: float


class _Axis(_Part):
    inertia: tuple[_Sweep, ...]
    torque_gain: _Gain
    confidence_percent: float | None


class _Parameter(_Part):
    name: str
    value: float
    std: float | None


class _Estimate(_Part):
    axes: dict[str, _Axis]
    base_parameters: tuple[_Parameter, ...]


@dataclass(frozen=True)
class AxisSheet:
    """One axis; kg m^2, of a prismatic one kg; `motor` always kg m^2.

    `cad` and `identified`: medians over the measured poses, `lowest` and `highest` of the identified. `std` total.
    `left_out`: why no value may be used, or "".
    """

    joint: str
    kind: Literal["revolute", "prismatic"]
    gear_ratio: float
    cad: float
    identified: float
    std: float
    lowest: float
    highest: float
    motor: float
    motor_std: float
    motor_lowest: float
    motor_highest: float
    differs_in_std: float
    left_out: str


def sheet(
    robot: Robot, estimate: Mapping[str, Any], place: str, poses: Mapping[str, Sequence[float]] | None = None
) -> Document:
    """The sheet of an estimate's document as JSON-able data; BadInput where it is of another robot or not physical.

    `poses`: by sweep, rad (m), where they are known (a bundle).
    """
    try:
        found = _Estimate.model_validate(estimate)
    except ValidationError as error:
        raise bad_field(place, error) from None
    if not found.axes:
        raise BadInput(place, "identified nothing: there was no sweep that shows the inertia of an axis")
    _check_physical(estimate, place)
    axes = [_axis(robot, joint, axis) for joint, axis in found.axes.items()]
    told: Document = {
        "format": FORMAT,
        "robot": robot.name,
        "source": place,
        "axes": [asdict(axis) for axis in axes],
        "poses": _ranges(robot, found, poses),
        "base_parameters": [parameter.model_dump() for parameter in found.base_parameters],
    }
    return told | {"fingerprint": fingerprint(told)}


def fingerprint(document: Mapping[str, Any]) -> str:
    """Of robot, axes and base parameters, to six digits: equal for the same result, wherever the sheet was made."""
    kept = {key: _rounded(document[key]) for key in ("robot", "axes", "base_parameters")}
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()[:16]


def check_sheet(document: Mapping[str, Any], place: str) -> None:
    """BadInput where a sheet is none, or was altered since it was made."""
    try:
        right = document["format"] == FORMAT and fingerprint(document) == document["fingerprint"]
    except (KeyError, TypeError):
        raise BadInput(place, "is not a sheet that `sweepid export-sheet` wrote") from None
    if not right:
        raise BadInput(place, f"was altered: its fingerprint is {fingerprint(document)}, not {document['fingerprint']}")


def _axis(robot: Robot, joint: str, axis: _Axis) -> AxisSheet:
    index = robot.index(joint)
    ratio = robot.axes[index].gear_ratio
    identified = np.array([sweep.identified for sweep in axis.inertia])
    value, cad = float(np.median(identified)), float(np.median([sweep.reference for sweep in axis.inertia]))
    share = share_of_value(axis.model_dump())
    std = share * abs(value)
    left_out = ""
    if not identified.min() > 0:
        left_out = f"the model has an inertia of {identified.min():.3g} in a measured pose: no robot has that"
    elif share > UNSURE:
        left_out = f"known to {100 * share:.0f} % only, limit {100 * UNSURE:.0f} %"
    factor = 1 / ratio**2
    return AxisSheet(
        joint=joint,
        kind="prismatic" if robot.chain.joints[index].kind == "prismatic" else "revolute",
        gear_ratio=ratio,
        cad=cad,
        identified=value,
        std=std,
        lowest=float(identified.min()),
        highest=float(identified.max()),
        motor=value * factor,
        motor_std=std * factor,
        motor_lowest=float(identified.min()) * factor,
        motor_highest=float(identified.max()) * factor,
        differs_in_std=(value - cad) / std if std > 0 else 0.0,
        left_out=left_out,
    )


def _check_physical(estimate: Mapping[str, Any], place: str) -> None:
    """Every link of the robot that the estimate stands for can be built, and no motor has a negative inertia."""
    try:
        standard = estimate["standard_parameters"]
        links = {link: np.array(list(values.values()), dtype=float) for link, values in standard["links"].items()}
        bad = [link for link, values in links.items() if not bool(is_physical(values))]
        bad += [name for name, value in standard["motor_inertias"].items() if not value >= 0]
    except (KeyError, TypeError, AttributeError, ValueError, IndexError, OverflowError):
        raise BadInput(f"{place} standard_parameters", "cannot be read") from None
    if bad:
        raise BadInput(f"{place} standard_parameters", f"no body can have those of {', '.join(bad)}")


def _ranges(robot: Robot, found: _Estimate, poses: Mapping[str, Sequence[float]] | None) -> Document | None:
    """By axis and joint, lowest and highest position, rad (m), that the value was measured in."""
    if poses is None:
        return None
    ranges: Document = {}
    for joint, axis in found.axes.items():
        own = np.array([poses[sweep.sweep] for sweep in axis.inertia])
        ranges[joint] = {name: [float(own[:, k].min()), float(own[:, k].max())] for k, name in enumerate(robot.joints)}
    return ranges


def _rounded(value: Any) -> Any:
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, Mapping):
        return {key: _rounded(each) for key, each in value.items()}  # pyright: ignore[reportUnknownVariableType]
    if isinstance(value, list | tuple):
        return [_rounded(each) for each in value]  # pyright: ignore[reportUnknownVariableType]
    return value
