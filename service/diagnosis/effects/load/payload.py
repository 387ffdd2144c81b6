"""A mass at the flange that is not in the model."""

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Readout
from service.diagnosis.rows.rigid import deviations_left, load_rows
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]

CERTAIN = 3.0  # standard deviations: a mass more negative than that is impossible


def _readout(tracks: Tracks, change: Array, covariance: Array) -> Readout:
    """Mass and first moments of a payload on the last link: the most likely values for this change of the load."""
    farthest = 1.0  # m from the origin of the last joint to the centre of mass, one sigma
    robot, index = tracks.robot, tracks.robot.index(tracks.joint)
    last = robot.chain.inertial.size
    # 0.3 of the mass of the links of the robot, one sigma
    mass = 0.3 * float(np.abs(robot.chain.inertial[:, 0]).sum())
    sigma = mass * np.repeat([1.0, farthest, farthest**2], (1, 3, 6))
    weight = np.repeat(tracks.sizes, len(tracks.poses))
    rows = weight[:, None] * load_rows(robot, index, tracks.poses)[:, last - 10 : last] * sigma
    noise, slack = covariance * np.outer(weight, weight), 1e-4 * float(np.abs(weight * change.ravel()).max())
    gain = rows.T @ np.linalg.inv(rows @ rows.T + noise + slack**2 * np.eye(len(noise)))
    values = sigma * (gain @ (weight * change.ravel()))
    spread = deviations_left(np.eye(10), rows, noise, slack) * sigma
    names = (("mass", "kg"), ("moment_x", "kg m"), ("moment_y", "kg m"), ("moment_z", "kg m"))
    return {name: (float(values[k]), float(spread[k]), unit) for k, (name, unit) in enumerate(names)}


EFFECT = Effect(
    name="payload",
    physics="tau = Y(q, a) [m, m c, I] of a body on the last link: gravity and inertia",
    source="Khalil, Gautier and Lemoine, ICRA 2007, Identification of the payload inertial parameters",
    sentence="The robot carries a mass that the model does not know.",
    visible_in=("forward_slow", "backward_slow"),
    entry="links.added",
    readout=_readout,
    by_test_mass=True,
    by_load=True,
    possible=lambda parameters, tracks, model: parameters["mass"] > 0,
)
