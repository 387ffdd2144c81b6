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

import numpy as np
from pydantic import JsonValue, ValidationError

from service.configuration import bad_field
from service.errors import BadInput
from service.identification.model.certainty import UNSURE, share_of_value
from service.identification.model.physical_consistency import is_physical
from service.results.estimate import Estimate, EstimatedAxis, StandardParameters
from service.results.identified.sheet import AxisSheet, Ranges, Sheet, SheetParameter
from service.robot import INERTIAL_NAMES, Robot


def sheet(robot: Robot, estimate: Estimate, place: str, poses: Mapping[str, Sequence[float]] | None = None) -> Sheet:
    """The sheet of an estimate; BadInput where it is of another robot, not physical or not finite.

    `poses`: by sweep, rad (m), where they are known (a bundle).
    """
    if not estimate.axes:
        raise BadInput(place, "identified nothing: there was no sweep that shows the inertia of an axis")
    _check_physical(estimate.standard_parameters, place)
    try:
        made = Sheet(
            format="sweepid-sheet",
            robot=robot.name,
            source=place,
            axes=tuple(_axis(robot, joint, axis) for joint, axis in estimate.axes.items()),
            poses=None if poses is None else _ranges(robot, estimate, poses),
            base_parameters=tuple(
                SheetParameter(name=one.name, value=one.value, std=one.std) for one in estimate.base_parameters
            ),
            fingerprint="",
        )
    except ValidationError as error:
        raise bad_field(place, error) from None
    return made.model_copy(update={"fingerprint": fingerprint(made)})


def fingerprint(sheet: Sheet) -> str:
    """Of robot, axes and base parameters, to six digits: equal for the same result, wherever the sheet was made."""
    document = sheet.as_json()
    kept = {key: _rounded(document[key]) for key in ("robot", "axes", "base_parameters")}
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()[:16]


def check_sheet(sheet: Sheet, place: str) -> None:
    """BadInput where a sheet was altered since it was made."""
    right = fingerprint(sheet)
    if right != sheet.fingerprint:
        raise BadInput(place, f"was altered: its fingerprint is {right}, not {sheet.fingerprint}")


def _axis(robot: Robot, joint: str, axis: EstimatedAxis) -> AxisSheet:
    index = robot.index(joint)
    ratio = robot.axes[index].gear_ratio
    identified = np.array([sweep.identified for sweep in axis.inertia])
    value, cad = float(np.median(identified)), float(np.median([sweep.reference for sweep in axis.inertia]))
    share = share_of_value(axis)
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


def _check_physical(standard: StandardParameters, place: str) -> None:
    """Every link of the robot that the estimate stands for can be built, and no motor has a negative inertia."""
    where = f"{place} standard_parameters"
    for link, values in standard.links.items():
        if set(values) != set(INERTIAL_NAMES):
            raise BadInput(where, f"has not the ten parameters of link {link}")
    links = {link: np.array([values[name] for name in INERTIAL_NAMES]) for link, values in standard.links.items()}
    bad = [link for link, values in links.items() if not (np.isfinite(values).all() and is_physical(values))]
    bad += [name for name, value in standard.motor_inertias.items() if not 0 <= value < np.inf]
    if bad:
        raise BadInput(where, f"no body can have those of {', '.join(bad)}")


def _ranges(robot: Robot, estimate: Estimate, poses: Mapping[str, Sequence[float]]) -> Ranges:
    ranges: Ranges = {}
    for joint, axis in estimate.axes.items():
        own = np.array([poses[sweep.sweep] for sweep in axis.inertia])
        ranges[joint] = {name: (float(own[:, k].min()), float(own[:, k].max())) for k, name in enumerate(robot.joints)}
    return ranges


def _rounded(value: JsonValue) -> JsonValue:
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: _rounded(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    return value
