"""Effects of the load of the axis: gravity outside the tolerance of CAD, a payload, a hose, a counterbalance, a
parallelogram.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from service.diagnosis.effects.effect import (
    CatalogueEffect,
    Inexpressible,
    Model,
    Patch,
    Readout,
    Shape,
    ShapeParameter,
    named,
    positive,
)
from service.diagnosis.rows.rigid import changes, deviations_left, load_rows, parallelograms
from service.diagnosis.rows.signals import Tracks
from service.model import Array
from service.model.counterbalance import Counterbalance, Lever


def _gravity_readout(tracks: Tracks, change: Array, covariance: Array) -> Readout:
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


GRAVITY_ERROR = CatalogueEffect(
    name="gravity_error",
    physics="tau = A cos q + B sin q for each group of links: their first moments differ from CAD beyond its prior",
    source="Atkeson, An and Hollerbach, Int. J. Robotics Research 5 (1986): torque linear in first moments",
    sentence="Gravity pulls otherwise than CAD can be wrong: masses, centres of mass, or the base is out of level. "
    "A counterbalance of free length 0 that the robot file lacks pulls the same.",
    visible_in=("forward_slow", "backward_slow"),
    entry="links",
    readout=_gravity_readout,
    by_load=True,
)


def _payload_readout(tracks: Tracks, change: Array, covariance: Array) -> Readout:
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


PAYLOAD = CatalogueEffect(
    name="payload",
    physics="tau = Y(q, a) [m, m c, I] of a body on the last link: gravity and inertia",
    source="Khalil, Gautier and Lemoine, ICRA 2007, Identification of the payload inertial parameters",
    sentence="The robot carries a mass that the model does not know.",
    visible_in=("forward_slow", "backward_slow"),
    entry="links.added",
    readout=_payload_readout,
    by_test_mass=True,
    by_load=True,
    possible=lambda parameters, tracks, model: parameters["mass"] > 0,
)


def _hose_columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    return [tracks.position**k for k in (1, 0, 2, 3)]


def _hose_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    stiffness = positive(parameters, "stiffness")
    return {"train": {"hose": {"stiffness": stiffness, "rest": -parameters["torque_at_zero"] / stiffness}}}


HOSE_SPRING = CatalogueEffect(
    name="hose_spring",
    physics="tau = k (q - q0) = k q + c, and a little q^2 and q^3 as it hardens",
    source="Gautier, Janot and Vandanjon, IEEE Trans. Control Syst. Technol. 21 (2013): spring compensators",
    sentence="Something elastic, a hose or a cable, pulls the axis towards a rest position.",
    visible_in=("forward_slow", "backward_slow"),
    entry="hose",
    coefficients=named(
        ("stiffness", "N m/rad"), ("torque_at_zero", "N m"), ("bend", "N m/rad2"), ("hardening", "N m/rad3")
    ),
    contains=("effort_offset",),
    columns=_hose_columns,
    on_load=(True,),
    possible=lambda parameters, tracks, model: parameters["stiffness"] > 0,
    scenario=_hose_scenario,
)


def _on_paper(tracks: Tracks) -> Counterbalance | None:
    return tracks.robot.axis(tracks.joint).counterbalance


def _lever(tracks: Tracks, own: Counterbalance) -> Lever:
    return own.lever(tracks.robot.chain.joints[tracks.robot.index(tracks.joint)])


WEIGHT: Shape = (0.0,)
"""Shape with the columns cos q and sin q: what any weight pulls, and a spring whose free length is 0."""


def _balance_columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    """Of the robot file's: more of its force, and of its rate. Of one that it lacks, with x = q - zero and the length
    u = sqrt(1 - swing cos x): (sin x / u) (cos x / (1 + u))^k. Any force law F(l) dl/dq is such a sum; swing < 0 is the
    same with zero half a turn away.
    """
    if shape == WEIGHT:
        return [np.cos(tracks.position), np.sin(tracks.position)]
    own = _on_paper(tracks)
    if own is not None:
        lever = _lever(tracks, own)
        longer = lever.length(tracks.position) - own.length
        return [own.effort(lever, tracks.position), longer * lever.arm(tracks.position)]
    zero, swing = shape
    cosine = np.cos(tracks.position - zero)
    length = np.sqrt(1 - swing * cosine)
    return [np.sin(tracks.position - zero) / length * (cosine / (1 + length)) ** k for k in range(3)]


def _balance_coefficients(tracks: Tracks) -> Sequence[tuple[str, str]]:
    if _on_paper(tracks) is not None:
        return (("share", ""), ("rate", "N/m"))
    return (("torque", "N m"), ("torque_growth", "N m"), ("torque_bend", "N m"))


def _balance_shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    if _on_paper(tracks) is not None:
        return ()
    around = tuple(np.linspace(-np.pi / 2, np.pi / 2, 12, endpoint=False).tolist())
    return ShapeParameter("zero", "rad", around, -np.pi, np.pi), ShapeParameter("swing", "", (0.0,), -0.97, 0.97)


def _balance_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    own = _on_paper(tracks)
    if own is None:
        raise Inexpressible("only torques of the counterbalance are known, not where its points are")
    lost = own.off(parameters["share"] - 1, parameters["rate"])
    return {"train": {"counterbalance": [lost.entry(_lever(tracks, own))]}}


COUNTERBALANCE = CatalogueEffect(
    name="counterbalance",
    physics="tau = F(l) dl/dq between two points, l^2 = a - b cos(q - q0): F differs from that of the robot file, "
    "or the file lacks it",
    source="Gautier, Janot and Vandanjon, IEEE Trans. Control Syst. Technol. 21 (2013): spring compensators",
    sentence="The counterbalance does not pull as the robot file says: gas is lost, a spring is another, "
    "or the file lacks it.",
    visible_in=("forward_slow", "backward_slow"),
    entry="counterbalance",
    coefficients=_balance_coefficients,
    columns=_balance_columns,
    on_load=(True,),
    shape=_balance_shape,
    # -1: all of its gas is lost, or it is not there; less would push instead
    possible=lambda parameters, tracks, model: parameters.get("share", 0.0) > -1.1,
    as_weight=WEIGHT,
    scenario=_balance_scenario,
    applies=lambda tracks: not tracks.prismatic and bool(np.ptp(tracks.gravity) > 0),
)


def _parallelogram_readout(tracks: Tracks, change: Array, covariance: Array) -> Readout:
    """Share of the change that each possible parallelogram would make, named after the joint that it begins before."""
    robot, index = tracks.robot, tracks.robot.index(tracks.joint)
    linkages = parallelograms(robot, index, tracks.poses)
    columns = changes(robot, load_rows(robot, index, tracks.poses), linkages)
    weight = np.repeat(tracks.sizes, len(tracks.poses))
    turn = np.linalg.pinv(weight[:, None] * columns) * weight
    spread = np.sqrt(np.maximum(np.diag(turn @ covariance @ turn.T), 0.0))
    shares = zip(linkages, turn @ change.ravel(), spread, strict=True)
    return {f"share_{robot.joints[k]}": (float(share), float(sigma), "") for k, share, sigma in shares}


def _parallelogram_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    raise Inexpressible("the links of a scenario are a plain chain, and no masses make it a parallelogram")


PARALLELOGRAM = CatalogueEffect(
    name="parallelogram",
    physics="q_(k+1) = s_(k+1) - s_k of the drives' positions s: tau = C^T tau_q(C s), with CAD's links",
    source="Khalil and Dombre, Modeling, Identification and Control of Robots (2002), 7.3: robots with closed loops",
    sentence="A parallelogram, or a belt from the base, drives a link: it keeps its direction while the axis before it "
    "turns. The robot file describes a plain chain.",
    visible_in=("forward_slow", "backward_slow"),
    entry="links",
    readout=_parallelogram_readout,
    scenario=_parallelogram_scenario,
    by_load=True,
    exact=True,
    # CAD's plain chain is to be cancelled whole, whatever its links weigh
    possible=lambda parameters, tracks, model: abs(max(parameters.values()) - 1) < 0.1,
)
