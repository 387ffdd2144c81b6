"""Gravity torque outside the tolerance of CAD: wrong masses, wrong centres of mass, or a base that is not level."""

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Readout
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]


def _readout(tracks: Tracks, change: Array, covariance: Array) -> Readout:
    """As a function of the angle q of this axis, mean over the poses: torque = cosine cos q + sine sin q."""
    count = len(tracks.poses)
    if tracks.prismatic:
        turn, names, unit = np.full((1, count), 1 / count), ("force",), "N"
        turn = np.hstack([0 * turn, turn, 0 * turn])
    else:
        angle = tracks.poses[:, tracks.robot.index(tracks.joint)]
        cosine, sine, none = np.cos(angle) / count, np.sin(angle) / count, np.zeros(count)
        turn = np.stack([np.concatenate([none, cosine, -sine]), np.concatenate([none, sine, cosine])])
        names, unit = ("cosine", "sine"), "N m"
    values, spread = turn @ change.ravel(), turn @ covariance @ turn.T
    return {
        name: (float(value), float(np.sqrt(max(variance, 0.0))), unit)
        for name, value, variance in zip(names, values, np.diag(spread), strict=True)
    }


EFFECT = Effect(
    name="gravity_error",
    physics="tau = A cos q + B sin q for each group of links: their first moments differ from CAD beyond its prior",
    source="Atkeson, An and Hollerbach, Int. J. Robotics Research 5 (1986): torque linear in first moments",
    sentence="Gravity pulls otherwise than CAD can be wrong: masses, centres of mass, or the base is out of level.",
    visible_in=("forward_slow", "backward_slow"),
    entry="links",
    readout=_readout,
    by_load=True,
)
