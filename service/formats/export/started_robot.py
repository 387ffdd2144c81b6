r"""A robot whose initial rigid model is an estimate instead of CAD.

Its links and motors are those of the estimate: the physical parameters nearest to CAD that give the identified base
parameters beta = K phi. They are not averaged with CAD again, because the estimate already used CAD where the data
were not sufficient. Their uncertainty is the prior P of CAD with beta as an observation of covariance C,

    P' = P - P K' (K P K' + C)^-1 K P       (`rigid.parameter_spread`)

so that no direction is less certain than with the prior alone (relative to these values), and a direction without data
keeps the prior. C is larger than the covariance in the estimate: that one is conditional on one torque gain and on a
machine without unnamed effects, which change an inertia by percents. This additional error is assumed as large as that
of a torque gain (`prior.effort_gain`), in each parameter of a base parameter. A base parameter that the estimate leaves
undetermined is not an observation.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from service import BadInput
from service.formats.export import identified_model
from service.formats.export.files import as_urdf
from service.identification.axis.nominal_priors import link_spread
from service.identification.model import fold, lock
from service.identification.model.base_parameters import base_parameters
from service.model import Knowledge, Robot, build_robot


class _Base(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)
    locked: dict[str, float] = {}
    covariance: tuple[tuple[float, ...], ...] = ()


def started_from(robot: Robot, estimate: Mapping[str, Any], source: str, place: str = "estimate") -> Robot:
    """`robot` with the rigid model of an estimate document (`sweepid identify --json`) and its uncertainty.

    `source`: name of the estimate in the diagnosis. BadInput if it identified nothing, or is of another robot (one
    with other base parameters).
    """
    model = identified_model(robot, estimate, place)
    base = _base(estimate, place)
    for joint in base.locked:
        robot.index(joint)
    fixed = {robot.index(joint): position for joint, position in base.locked.items()}
    unlocked = [k for k in range(len(robot.joints)) if k not in fixed]
    moved = sorted(robot.index(joint) for joint in cast("Mapping[str, Any]", estimate["axes"]))
    if not set(moved) <= set(unlocked):
        raise BadInput(f"{place} base.locked", "names a joint that was measured")
    own = base_parameters(lock(robot.chain, fixed), tuple(unlocked.index(k) for k in moved))
    stated_parameters = model.base_parameters
    if tuple(one.name for one in stated_parameters) != own.names:
        other = next(
            (one.name for one in stated_parameters if one.name not in own.names), f"{len(stated_parameters)} parameters"
        )
        raise BadInput(
            f"{place} base_parameters",
            f"are not those of robot {robot.name}: {other}; give an estimate of this very robot",
        )
    known = [k for k, one in enumerate(stated_parameters) if one.std is not None]
    std = np.array([stated_parameters[k].std for k in known], dtype=np.float64)
    whole = np.array(base.covariance, dtype=np.float64)
    stated = (
        whole[np.ix_(known, known)]
        if whole.shape == (len(stated_parameters), len(stated_parameters))
        else np.diag(std**2)
    )
    combination = own.combination[known] @ fold(robot.chain, fixed)
    size = np.concatenate([link_spread(robot.chain.inertial, 1.0), np.abs(model.motor_inertias)])
    doubt = robot.prior.effort_gain**2 * (combination**2 @ size**2)
    axes = tuple(
        axis.model_copy(update={"motor_inertia": motor / axis.gear_ratio**2}) if motor > 0 else axis
        for axis, motor in zip(robot.axes, model.motor_inertias.tolist(), strict=True)
    )
    description = robot.description.model_copy(update={"axes": axes})
    started = build_robot(description, as_urdf(replace(model, friction=(None,) * len(robot.joints))), place)
    return replace(started, knowledge=Knowledge(combination, stated + np.diag(doubt), source))


def _base(estimate: Mapping[str, Any], place: str) -> _Base:
    """Estimates of an earlier version have no base: then nothing was locked, and the parameters are independent."""
    try:
        found = _Base.model_validate(estimate.get("base", {}))
    except ValidationError as error:
        raise BadInput(f"{place} base", str(error.errors(include_url=False)[0]["msg"])) from None
    if len({len(row) for row in found.covariance}) > 1:
        raise BadInput(f"{place} base.covariance", "has rows of different lengths")
    return found
