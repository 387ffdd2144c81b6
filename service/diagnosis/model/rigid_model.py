"""The identified rigid model in base parameters: CAD value, value from these sweeps, standard deviation."""

import numpy as np

from service.diagnosis.fit.equations import Equations
from service.diagnosis.model.held_out_check import Fit
from service.diagnosis.rows.rigid import SLACK, deviations_left, load_rows, nominal_parameters, parameter_spread
from service.identification.model import joint_ranges, parameter_names, reduce_columns
from service.model.results.diagnosis import RigidParameter

VISCOUS = "viscous_friction"


def rigid_model(given: Equations, fit: Fit) -> tuple[RigidParameter, ...]:
    """Base parameters (Gautier 1991) of inertia and gravity about the axis over the workspace, then viscous friction.
    Combinations that the measured poses do not determine keep the CAD value and the uncertainty of the prior.
    """
    tracks = given.tracks
    robot, joint, poses = tracks.robot, tracks.joint, tracks.poses
    index = robot.index(joint)
    lower, upper = joint_ranges(robot.chain)
    # 60 poses that represent the workspace
    anywhere = np.random.default_rng(0).uniform(lower, upper, (60, len(lower)))
    base = reduce_columns(load_rows(robot, index, anywhere), parameter_names(robot.chain))
    nominal = base.combination @ nominal_parameters(robot)
    spread = base.combination @ parameter_spread(robot, index, poses)
    prior = spread @ spread.T
    weight = np.repeat(tracks.sizes, len(poses))
    rows = weight[:, None] * load_rows(robot, index, poses)[:, list(base.columns)]
    noise, slack = fit.covariance * np.outer(weight, weight), SLACK * robot.axis(joint).rated_effort
    gain = prior @ rows.T @ np.linalg.inv(rows @ prior @ rows.T + noise + slack**2 * np.eye(len(noise)))
    values = nominal + gain @ (weight * fit.load.ravel() - rows @ nominal)
    std = deviations_left(spread, rows, noise, slack)
    result = [
        RigidParameter(name=name, nominal=cad, value=value, std=deviation)
        for name, cad, value, deviation in zip(base.names, nominal.tolist(), values.tolist(), std.tolist(), strict=True)
    ]
    viscous = robot.axis(tracks.joint).viscous_friction
    return (*result, RigidParameter(name=VISCOUS, nominal=viscous, value=fit.viscous, std=fit.viscous_std))
