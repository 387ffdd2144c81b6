"""The axis in the format of a scenario: the data of the robot file, with the patches of its effects.

Differences of links from CAD in the format of a scenario: factor of the mass, shift of its centre, added bodies.

Masses and first moments determine gravity. They are those of the URDF links themselves; bodies fixed to them stay.
"""

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from scipy.optimize import lsq_linear

from service.diagnosis.effects.effect import (
    Bar,
    FrictionEntry,
    Inexpressible,
    LinkEntry,
    Parts,
    Patch,
    TrainEntry,
    merged,
)
from service.identification.model import gravity_terms, inertia_rows
from service.model import Array, Robot, inertia_vector, transform_inertial
from service.model.urdf import read_inertial

Links = Mapping[str, LinkEntry]
"""The links of a scenario, by name."""

FACTORS = (0.1, 10.0)


def deviations(robot: Robot, changes: Array) -> Links:
    """Links by name for changes (n, 4) of [mass, kg; first moment, kg m] of the moving links; Inexpressible if a mass
    is not above 0.
    """
    result: dict[str, LinkEntry] = {}
    for joint, own, change in zip(robot.chain.joints, _own(robot), changes, strict=True):
        if not change.any():
            continue
        mass = float(own[0] + change[0])
        if own[0] <= 0 or mass <= 0:
            raise Inexpressible(f"mass of {joint.link} = {mass:.3g} kg against {own[0]:.3g} kg of CAD")
        shift = (own[1:] + change[1:]) / mass - own[1:] / own[0]
        result[joint.link] = {"mass": mass / float(own[0]), "shift": shift.tolist()}
    return result


def moments(robot: Robot, links: Links) -> Array:
    """The changes (n, 4) that the `links` of a scenario describe."""
    result = np.zeros((len(robot.chain.joints), 4))
    for k, (joint, own) in enumerate(zip(robot.chain.joints, _own(robot), strict=True)):
        link = links.get(joint.link, {})
        mass = link.get("mass", 1.0) * own[0]
        moment = link.get("mass", 1.0) * own[1:] + mass * np.array(link.get("shift", (0.0, 0.0, 0.0)))
        for body in link.get("added", ()):
            mass += body["mass"]
            moment = moment + body["mass"] * (np.array(body["start"]) + np.array(body["end"])) / 2
        result[k] = np.append(mass, moment) - own
    return result


def gravity(robot: Robot, links: Links, joint: int, poses: Array) -> Array:
    """(m, 2): cosine and sine part, N m, of gravity about a joint by its own angle, all others as in `poses` (m, n)."""
    inertial = robot.chain.inertial.copy()
    inertial[:, :4] += moments(robot, links)
    return gravity_of(robot, inertial, joint, poses)


def joined(robot: Robot, wanted: Sequence[tuple[int, Array, Array]]) -> Array:
    """The most likely changes (n, 4) of [mass, first moment] for given gravity on several joints: for each its number,
    poses (m, n), and the change of cosine and sine part (m, 2), N m.
    """
    chain = robot.chain
    own = _own(robot)
    changes = np.zeros_like(own)
    if not wanted:
        return changes
    first = min(joint for joint, _, _ in wanted)
    size = robot.prior.gravity * np.column_stack([own[:, 0], *[np.linalg.norm(own[:, 1:], axis=1)] * 3])
    places = [(link, part) for link in range(first, len(own)) for part in range(4) if size[link, part] > 0]
    columns: list[Array] = []
    for link, part in places:
        unit = np.zeros_like(chain.inertial)
        unit[link, part] = size[link, part]
        columns.append(np.concatenate([gravity_of(robot, unit, joint, poses).ravel() for joint, poses, _ in wanted]))
    if columns:
        right = np.concatenate([change.ravel() for _, _, change in wanted])
        # 1e-4 of the largest torque: accuracy with which the links give gravity
        scale = 1e-4 * max(float(np.abs(right).max(initial=0.0)), 1e-12)
        matrix = np.vstack([np.stack(columns, axis=-1) / scale, np.eye(len(columns))])
        solution = np.linalg.lstsq(matrix, np.append(right / scale, np.zeros(len(columns))), rcond=None)[0]
        for (link, part), value in zip(places, solution, strict=True):
            changes[link, part] = value * size[link, part]
    return changes


def gravity_of_fit(poses: Array, joint: int, torque: Array, slope: Array) -> Array:
    """(m, 2): cosine and sine part by the angle of this axis, from torque and slope (m,) in each pose."""
    cosine, sine = np.cos(poses[:, joint]), np.sin(poses[:, joint])
    return np.stack([torque * cosine - slope * sine, torque * sine + slope * cosine], axis=-1)


def gravity_of(robot: Robot, inertial: Array, joint: int, poses: Array) -> Array:
    """(m, 2): cosine and sine part, N m, about a joint by its own angle, of links (n, 10); linear in them."""
    torque, stiffness = gravity_terms(robot.chain, inertial.ravel(), robot.gravity, joint, poses).T
    return gravity_of_fit(poses, joint, torque, stiffness)


def inertia_factors(
    robot: Robot, links: Links, wanted: Sequence[tuple[int, Array, Array]], steps: int | None = None
) -> dict[str, float]:
    """Factors of the links' inertias about their centres, fitted to axis inertias: for each joint its number, poses
    (m, n), and inertias (m,) without motor, kg m^2. A part that such links cannot represent is ignored.
    Inexpressible if the fit is not finite or does not converge within `steps` (None: SciPy's limit).
    """
    close = 0.01  # relative accuracy with which they give inertias
    count = len(robot.chain.joints)
    bare = _inertial(robot, links, np.zeros(count))
    own = np.stack([_inertial(robot, links, unit) - bare for unit in np.eye(count)])
    rows = [inertia_rows(robot.chain, joint, poses) / inertia[:, None] for joint, poses, inertia in wanted]
    if not rows:
        return {}
    matrix = np.vstack([row @ own.reshape(count, -1).T for row in rows]) / close
    right = np.concatenate([1 - row @ bare.ravel() for row in rows]) / close
    prior = np.eye(count) / robot.prior.inertia
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise Inexpressible("inertias of the links: those of the axes are not finite")
    whole = np.vstack([matrix, prior])
    found = lsq_linear(whole, np.append(right, prior.sum(axis=0)), bounds=FACTORS, max_iter=steps)
    if found.status <= 0:
        raise Inexpressible(f"inertias of the links: their fit did not converge: {' '.join(found.message.split())}")
    factors = np.where(np.abs(matrix).max(axis=0) > 0, found.x, 1.0)
    return {joint.link: float(factor) for joint, factor in zip(robot.chain.joints, factors, strict=True)}


def _inertial(robot: Robot, links: Links, factors: Array) -> Array:
    """(n, 10) of the real links, with the inertias about their centres multiplied by factors (n,)."""
    result = robot.chain.inertial.copy()
    changed = moments(robot, links)
    for k, (joint, own) in enumerate(zip(robot.chain.joints, _whole(robot), strict=True)):
        if own[0] <= 0:
            continue
        bodies = links.get(joint.link, {}).get("added", ())
        central = transform_inertial(own, np.eye(3), -own[1:4] / own[0])[4:]
        mass, moment = own[0] + changed[k, 0], own[1:4] + changed[k, 1:]
        for body in bodies:
            mass, moment = mass - body["mass"], moment - body["mass"] * _centre(body)
        moved = transform_inertial(np.append([mass, 0, 0, 0], factors[k] * central), np.eye(3), moment / mass)
        result[k] += moved - own + sum((_bar(body) for body in bodies), start=np.zeros(10))
    return result


def _bar(body: Bar) -> Array:
    """Ten parameters of a solid cylindrical bar."""
    mass, radius = body["mass"], body["radius"]
    way = np.array(body["end"]) - np.array(body["start"])
    length = float(np.linalg.norm(way))
    along = np.outer(way, way) / length**2
    inertia = mass * (radius**2 / 2 * along + (3 * radius**2 + length**2) / 12 * (np.eye(3) - along))
    return transform_inertial(np.concatenate([[mass, 0, 0, 0], inertia_vector(inertia)]), np.eye(3), _centre(body))


def _centre(body: Bar) -> Array:
    return (np.array(body["start"]) + np.array(body["end"])) / 2


def _own(robot: Robot) -> Array:
    """[mass, first moment] (n, 4) of the URDF links that the moving joints carry."""
    return _whole(robot)[:, :4]


def _whole(robot: Robot) -> Array:
    """All ten parameters (n, 10)."""
    elements = {element.get("name"): element for element in ET.fromstring(robot.urdf_text).findall("link")}
    return np.array([read_inertial(elements[joint.link], robot.name) for joint in robot.chain.joints])


UNKNOWN_MOTOR = 0.1  # of the axis' inertia: assumed motor inertia if the robot file has none
NOT_NEGATIVE = (
    "motor_friction.viscous", "motor_friction.backward_viscous", "motor_friction.coulomb",
    "motor_friction.backward_coulomb", "warming.viscous_loss", "lugre.damping", "spring.damping", "spring.backlash",
)  # fmt: skip
TORQUES = (
    "motor_inertia", "motor_friction.viscous", "motor_friction.backward_viscous", "motor_friction.coulomb",
    "motor_friction.backward_coulomb", "motor_friction.stribeck.extra", "motor_friction.power.coefficient",
    "warming.heat_capacity", "lugre.stiffness", "lugre.damping", "lugre.coulomb", "lugre.breakaway",
    "spring.stiffness", "spring.damping", "spring.hardening", "hose.stiffness",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class AxisEntry:
    """`train`, `measurement` and `links` of a scenario for one axis; `held`: descriptions of limited values."""

    train: TrainEntry
    measurement: Parts
    links: Links
    held: tuple[str, ...]
    scale: float  # of the torques and inertias used here, over the true ones


def axis_entry(
    robot: Robot, joint: str, inertia: float, viscous: float, patches: Sequence[Patch], *, true: bool = False
) -> AxisEntry:
    """An axis of about `inertia`, kg m^2, with its effects; Inexpressible if no drive train can represent them.

    Inertia and torques are as recorded by a drive, perhaps with a wrong torque constant, or `true` values.
    """
    axis = robot.axis(joint)
    motor = axis.motor_inertia or UNKNOWN_MOTOR * inertia / axis.gear_ratio**2
    friction = FrictionEntry(viscous=viscous, backward_viscous=viscous, coulomb=0.0, backward_coulomb=0.0)
    train = TrainEntry(motor_inertia=motor, motor_friction=friction, effort_gain=1.0, effort_offset=0.0)
    measurement, links = Parts(), dict[str, LinkEntry]()
    for patch in patches:
        train = merged(train, patch.get("train", {}))
        measurement = merged(measurement, patch.get("measurement", {}))
        links = merged(links, patch.get("links", {}))
    if train["effort_gain"] <= 0:
        raise Inexpressible(f"effort_gain = {train['effort_gain']:.3g} is not above 0")
    # 0.1 of the value in the robot file
    held = _held(train, 0.1 * motor)
    scale = 1.0 if true else train["effort_gain"]
    for path in TORQUES:
        part, key = _place(train, path)
        if key in part:
            part[key] *= 1 / scale
    if "cogging" in train:
        train["cogging"] = [ripple | {"amplitude": ripple["amplitude"] / scale} for ripple in train["cogging"]]
    own, known = train.get("counterbalance", []), axis.counterbalance
    own = [{**one, "force": one["force"] / scale, "rate": one["rate"] / scale} for one in own]
    if known is not None:  # of true torque
        own.insert(0, known.entry(known.lever(robot.chain.joints[robot.index(joint)])))
    if own:
        train["counterbalance"] = own
    if "gear_error" in train or "spring" in train:
        _sprung(train, inertia / scale, axis.gear_ratio)
    _tidied(train)
    return AxisEntry(train, measurement, links, held, scale)


def stiffened(entry: AxisEntry, inertia: float, ratio: float) -> AxisEntry:
    """The entry with a stiff spring if it has none: in a scenario either all axes have springs or none has."""
    train = entry.train.copy()
    _sprung(train, inertia / entry.scale, ratio)
    return replace(entry, train=train)


def _held(train: TrainEntry, least_motor: float) -> tuple[str, ...]:
    """Set values beyond the limits of the scenario to the limit, and describe each change."""
    held: list[str] = []
    for path in NOT_NEGATIVE:
        part, key = _place(train, path)
        if part.get(key, 0.0) < 0:
            held.append(f"{path} = {part[key]:.3g} is held at 0")
            part[key] = 0.0
    if train["motor_inertia"] < least_motor:
        held.append(f"motor_inertia = {train['motor_inertia']:.3g} is held at {least_motor:.3g}")
        train["motor_inertia"] = least_motor
    return tuple(held)


def _place(train: TrainEntry, path: str) -> tuple[Parts, str]:
    """The part of a drive train that a path names, and the last key."""
    *way, key = path.split(".")
    part: Any = train
    for name in way:
        part = part.get(name, {})
    return part, key


def _sprung(train: TrainEntry, inertia: float, ratio: float) -> None:
    """Add a stiff spring to a gear that has none."""
    spring = train.setdefault("spring", {})
    if "stiffness" in spring:
        return
    motor = train["motor_inertia"] * ratio**2
    load = max(inertia - motor, UNKNOWN_MOTOR * inertia)
    swing = motor * load / (motor + load)
    # Hz, locked rotor, for a gear with backlash or transmission error but no known elasticity
    # Hz, resonance of motor against load: limit of the time step of the simulator
    spring["stiffness"] = min(load * (2 * np.pi * 350.0) ** 2, swing * (2 * np.pi * 1000.0) ** 2)
    # 0.3 damping ratio of such a gear
    spring["damping"] = 0.3 * float(np.sqrt(spring["stiffness"] * load))


def _tidied(train: TrainEntry) -> None:
    """Remove backward values equal to the forward ones; with bristles, dry friction moves to the load side."""
    friction = train["motor_friction"]
    if "lugre" in train:
        moved = FrictionEntry(coulomb=friction.pop("coulomb"), backward_coulomb=friction.pop("backward_coulomb"))
        if any(moved.values()):
            train["load_friction"] = moved
    for part in (cast("Parts", friction), cast("Parts", train.get("load_friction", {}))):
        for key in ("viscous", "coulomb"):
            if f"backward_{key}" in part and np.isclose(part[f"backward_{key}"], part[key], rtol=1e-12, atol=0.0):
                del part[f"backward_{key}"]
