"""The values to enter into controls and drives, with uncertainty, validity, and the place of each.

A control takes one inertia per axis, although J depends on the pose: the sheet contains the median over the measured
poses and the range. On the motor side that is J / u^2, u motor revolutions per joint revolution (rad per m),
including the motor as in the measurement. Standard deviations: of the model over the workspace if known,
else the median of the sweeps, and that of the torque constant.

An estimate of the robot does not contain mass, centre and inertia of a load, only combinations of the links'
parameters. A load comes from `sweepid estimate payload`; the supplementary loads of A1 to A3 are the smallest bodies
that reproduce the difference from CAD (`supplementary`).
"""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from pydantic import ValidationError
from scipy.special import chdtrc

from service import BadInput
from service.formats.export.model import IdentifiedModel, model_of
from service.formats.export.sheets.inertias import UPRIGHT, Inertias, of_estimate, of_sheet, supplementary
from service.identification.model.physical_consistency import is_physical
from service.model import INERTIAL_NAMES, Array, Robot
from service.model.configuration import bad_field
from service.model.results.estimate import (
    UNSURE,
    Estimate,
    EstimatedAxis,
    StandardParameters,
    axis_figures,
    share_of_value,
)
from service.model.results.sheet import (
    AxisCheck,
    AxisSheet,
    Ranges,
    Sheet,
    SheetBody,
    SheetCheck,
    SheetParameter,
    SheetVerdict,
)


def sheet(
    robot: Robot,
    estimate: Estimate,
    place: str,
    poses: Mapping[str, Sequence[float]] | None = None,
    upright: float = UPRIGHT,
) -> Sheet:
    """The sheet of an estimate; BadInput if that is of another robot, not physical or not finite.

    `poses`: by sweep, rad (m), if known (from a bundle). `upright`: deg, position of the second joint in the
    URDF at which a KUKA displays A2 = -90 deg.
    """
    if not estimate.axes:
        # motions of all axes give a model, but a sheet compares inertias that sweeps measured
        model = "export the model instead (`sweepid export model`)"
        way = "measure one (`sweepid plan`)" if estimate.combination is None else model
        told = "contains no identified parameters of a sweep of one axis, which a sheet is made of"
        raise BadInput(place, f"{told}: {way}")
    _check_physical(estimate.standard_parameters, place)
    for joint, axis in estimate.axes.items():
        if not np.isfinite(share_of_value(axis)):
            told = "its inertia or torque_gain has the value 0, or a standard deviation without a finite share of it"
            raise BadInput(f"{place} axes.{joint}", told)
    known = of_estimate(robot, estimate, place)
    gain = max((axis.torque_gain.std or 0.0) / axis.torque_gain.value for axis in estimate.axes.values())
    model = model_of(robot, estimate, place)
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
            serial=robot.description.serial or "",
            base=estimate.base,
            supplementary=supplementary(robot, known, estimate.standard_parameters, gain, math.radians(upright)),
            bodies=tuple(_bodies(model)),
            kinds={joint.name: joint.kind for joint in robot.chain.joints},
        )
    except ValidationError as error:
        raise bad_field(place, error) from None
    return made.model_copy(update={"fingerprint": fingerprint(made)})


def fingerprint(sheet: Sheet) -> str:
    """Hash of robot, axes and base parameters, to six digits: equal for the same result, wherever it was made."""
    document = sheet.as_json()
    names = ("robot", "axes", "base_parameters", *(("base",) if sheet.base is not None else ()))
    kept = json.dumps({name: document[name] for name in names})
    rounded = json.loads(kept, parse_float=lambda number: float(f"{float(number):.6g}"))
    return hashlib.sha256(json.dumps(rounded, sort_keys=True).encode()).hexdigest()[:16]


def check_sheet(sheet: Sheet, place: str) -> None:
    """BadInput if a sheet was changed after it was made."""
    right = fingerprint(sheet)
    if right != sheet.fingerprint:
        raise BadInput(place, f"was altered: its fingerprint is {right}, not {sheet.fingerprint}")


def _bodies(model: IdentifiedModel) -> Iterator[SheetBody]:
    parts = zip(model.robot.joints, model.bodies, model.motor_inertias, model.friction, strict=True)
    for joint, body, motor, friction in parts:
        x, y, z = body.centre.tolist()
        xx, yy, zz, xy, xz, yz = body.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]].tolist()
        yield SheetBody(
            link=body.link,
            joint=joint,
            mass=body.mass,
            centre=(x, y, z),
            inertia=(xx, yy, zz, xy, xz, yz),
            armature=float(motor),
            damping=friction,
        )


def _axis(robot: Robot, joint: str, axis: EstimatedAxis) -> AxisSheet:
    index = robot.index(joint)
    ratio = robot.axes[index].gear_ratio
    found = axis_figures(axis)
    share = share_of_value(axis)
    left_out = ""
    if not found.lowest > 0:
        left_out = f"the model has an inertia of {found.lowest:.3g} in a measured pose, limit above 0"
    elif share > UNSURE:
        left_out = f"uncertainty {100 * share:.0f} %, limit {100 * UNSURE:.0f} %"
    factor = 1 / ratio**2
    return AxisSheet(
        joint=joint,
        kind=robot.chain.joints[index].kind,
        gear_ratio=ratio,
        cad=found.cad,
        identified=found.identified,
        std=found.std,
        lowest=found.lowest,
        highest=found.highest,
        motor=found.identified * factor,
        motor_std=found.std * factor,
        motor_lowest=found.lowest * factor,
        motor_highest=found.highest * factor,
        differs_in_std=(found.identified - found.cad) / found.std if found.std > 0 else 0.0,
        left_out=left_out,
    )


def _check_physical(standard: StandardParameters, place: str) -> None:
    """Every link of the robot in the estimate is physical, and no motor has a negative inertia."""
    where = f"{place} standard_parameters"
    for link, values in standard.links.items():
        if set(values) != set(INERTIAL_NAMES):
            raise BadInput(where, f"lacks the ten parameters of link {link}")
    links = {link: np.array([values[name] for name in INERTIAL_NAMES]) for link, values in standard.links.items()}
    bad = [link for link, values in links.items() if not (np.isfinite(values).all() and is_physical(values))]
    bad += [name for name, value in standard.motor_inertias.items() if not 0 <= value < np.inf]
    if bad:
        raise BadInput(where, f"not physically possible for {', '.join(bad)}")


def _ranges(robot: Robot, estimate: Estimate, poses: Mapping[str, Sequence[float]]) -> Ranges:
    ranges: Ranges = {}
    for joint, axis in estimate.axes.items():
        own = np.array([poses[sweep.sweep] for sweep in axis.inertia])
        ranges[joint] = {name: (float(own[:, k].min()), float(own[:, k].max())) for k, name in enumerate(robot.joints)}
    return ranges


def compare(sheet: Sheet, robot: Robot, estimate: Estimate, poses: Mapping[str, Array], place: str) -> SheetCheck:
    """The sheet compared with a later estimate of `robot`; `poses` (m, n), rad (m): those measured later, by axis.

    BadInput: an altered sheet, another robot, no common axis, or an inertia that one of them does not determine.
    """
    check_sheet(sheet, "sheet")
    if sheet.robot != robot.name:
        raise BadInput("sheet", f"is of robot {sheet.robot}, and {place} of {robot.name}")
    serial = robot.description.serial or ""
    if sheet.serial and serial and sheet.serial != serial:
        raise BadInput("sheet", f"is of serial number {sheet.serial}, and {place} of {serial}")
    before, after = of_sheet(robot, sheet, "sheet"), of_estimate(robot, estimate, place)
    joints = [joint for joint in before.joints if joint in after.joints and len(poses.get(joint, ()))]
    if not joints:
        raise BadInput(place, f"has no axis of the sheet: it has {', '.join(after.joints)}")
    old, covariance = _modelled(before, joints, poses)
    if all(after.knows(joint, poses[joint]) for joint in joints):
        new, own = _modelled(after, joints, poses)
    else:
        new, own = _measured(estimate, joints)
    covariance = covariance + own
    std = np.sqrt(np.diag(covariance))
    if not std.min() > 0:
        raise BadInput(
            place, f"gives {joints[int(np.argmin(std))]} without uncertainty: the significance cannot be computed"
        )
    difference = new - old
    probability = _probability(difference / std, covariance / np.outer(std, std))
    axes = tuple(
        AxisCheck(
            joint=joint,
            sheet=float(old[k]),
            now=float(new[k]),
            std=float(std[k]),
            differs_percent=100 * float(difference[k] / old[k]),
            differs_in_std=float(difference[k] / std[k]),
            poses=len(poses[joint]),
        )
        for k, joint in enumerate(joints)
    )
    return SheetCheck(
        robot=robot.name,
        fingerprint=sheet.fingerprint,
        source=place,
        verdict=_verdict(probability),
        probability=probability,
        axes=axes,
        not_compared=tuple(joint for joint in before.joints if joint not in joints),
    )


def _modelled(of: Inertias, joints: Sequence[str], poses: Mapping[str, Array]) -> tuple[Array, Array]:
    """Mean inertia (k,) of each axis over its poses by the base parameters, and its covariance (k, k)."""
    rows = np.array([of.rows(joint, poses[joint]).mean(axis=0) for joint in joints])
    return rows @ of.values, rows @ of.covariance @ rows.T


def _measured(estimate: Estimate, joints: Sequence[str]) -> tuple[Array, Array]:
    """The same from the sweeps alone."""
    sweeps = [estimate.axes[joint].inertia for joint in joints]
    means = np.array([float(np.mean([sweep.value for sweep in own])) for own in sweeps])
    stds = np.array([float(np.mean([sweep.std for sweep in own])) for own in sweeps])
    return means, np.diag(stds**2)


def _probability(standardised: Array, correlation: Array) -> float:
    """Probability of at least this difference by chance, for all axes together."""
    distance = float(standardised @ np.linalg.lstsq(correlation, standardised, rcond=None)[0])
    return float(chdtrc(float(np.linalg.matrix_rank(correlation)), distance))


def _verdict(probability: float) -> SheetVerdict:
    """Limits: two-sided probabilities of 2 and 4 standard deviations, as in the daily check."""
    if probability >= 0.0455:
        return "the same"
    return "perhaps changed" if probability >= 6.33e-5 else "changed"
