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

import numpy as np
from numpy.typing import NDArray

from service.formats.export.files import as_urdf
from service.formats.export.model import identified_model, observation
from service.identification.axis.nominal_priors import link_spread
from service.model.robot import Knowledge, Robot, build_robot

Array = NDArray[np.float64]


def started_from(robot: Robot, estimate: Mapping[str, object], source: str, place: str = "estimate") -> Robot:
    """`robot` with the rigid model of an estimate document (`sweepid identify --json`) and its uncertainty.

    `source`: name of the estimate in the diagnosis. BadInput if it identified nothing, or is of another robot (one
    with other base parameters).
    """
    model = identified_model(robot, estimate, place)
    observed = observation(robot, model.estimate, place)
    combination = observed.combination
    size = np.concatenate([link_spread(robot.chain.inertial, 1.0), np.abs(model.motor_inertias)])
    doubt = robot.prior.effort_gain**2 * (combination**2 @ size**2)
    axes = tuple(
        axis.model_copy(update={"motor_inertia": motor / axis.gear_ratio**2}) if motor > 0 else axis
        for axis, motor in zip(robot.axes, model.motor_inertias.tolist(), strict=True)
    )
    description = robot.description.model_copy(update={"axes": axes})
    started = build_robot(description, as_urdf(replace(model, friction=(None,) * len(robot.joints))), place)
    return replace(started, knowledge=Knowledge(combination, observed.covariance + np.diag(doubt), source))
