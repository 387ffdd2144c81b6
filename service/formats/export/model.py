"""The robot with the parameters of an estimate: the source of all exported files."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service import BadInput
from service.identification.estimates.standard_parameters import AxisWorth, NominalModel, ObservedCombinations
from service.identification.model import dynamic_base, fold, lock
from service.identification.model.base_parameters import base_parameters
from service.model import INERTIAL_NAMES, Array, Robot, inertia_matrix
from service.model.counterbalance import Counterbalance, positions
from service.model.results.combination import Combination, FrictionPoint
from service.model.results.estimate import (
    BaseParameter,
    Estimate,
    EstimatedAxis,
    StandardParameters,
    Symbol,
    UsedEffect,
)
from service.model.results.part import Column, Shown, Table


@dataclass(frozen=True)
class LinkBody:
    """A link with all fixed children. SI; centre (3,) in the link's frame, inertia (3, 3) about the centre."""

    link: str
    mass: float
    centre: Array
    inertia: Array
    parameters: Array  # (10,) at the frame's origin


@dataclass(frozen=True, repr=False)
class IdentifiedModel(Shown):
    """A robot's joints (n), in order, each with its body, its motor and, if it was measured, its friction."""

    robot: Robot
    bodies: tuple[LinkBody, ...]
    motor_inertias: Array  # (n,) kg m^2 (kg) on the joint side, 0 if unknown
    friction: tuple[float | None, ...]  # viscous, N m s/rad (N s/m); None: the axis was not measured
    dry_friction: tuple[float | None, ...]  # Coulomb, N m (N); None: neither a motion nor an accepted effect states it
    offset: tuple[float, ...]  # constant effort of the drive, N m (N)
    curves: dict[str, tuple[FrictionPoint, ...]]  # by joint, friction that has another law than these two
    springs: dict[str, tuple[float, float]]  # by joint, stiffness and damping of the gear, N m/rad and N m s/rad
    hoses: dict[str, tuple[float, float]]  # by joint, stiffness of an accepted hose, N m/rad, and its rest, rad
    counterbalances: dict[str, Counterbalance]  # by joint, of the robot file, corrected by an accepted effect
    effects: tuple[UsedEffect, ...]  # of the accepted model
    base_parameters: tuple[BaseParameter, ...]
    symbols: dict[str, Symbol]
    deviation_in_std: float
    estimate: Estimate

    @cached_property
    def worth(self) -> tuple[AxisWorth, ...]:
        """Inertia and gravity of each axis over the workspace, CAD's beside; empty if the estimate does not say."""
        parameters = np.concatenate([*(body.parameters for body in self.bodies), self.motor_inertias])
        return _worth_of(self.robot, self.estimate, parameters)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know before the model is used."""
        found = [axis.warning for axis in self.worth if axis.warning]
        if self.deviation_in_std:
            found.append(
                "the model is the most probable physical robot, given CAD and the sweeps: its base parameters are "
                f"{self.deviation_in_std:.2g} standard deviations from the identified ones{self._not_held()}"
            )
        return (*found, *map(self._off_the_line, self.curves), *self._not_balanced())

    def tendon(self, joint: str) -> tuple[Array, float, float]:
        """Its counterbalance as a tendon of MJCF: factors (3,) of x, x^2, x^3 in its pull, x the length past the second
        number, m; the third is the largest torque by which that is off over the joint's range, N m.
        """
        own, moving = self.counterbalances[joint], self.robot.chain.joints[self.robot.index(joint)]
        angle, lever = positions(moving), own.lever(moving)
        length, arm, wanted = lever.length(angle), lever.arm(angle), own.effort(lever, angle)
        free = own.length - own.force / own.rate if own.column is None and own.rate else -1.0
        if free >= 0:
            return np.array([own.rate, 0.0, 0.0]), free, 0.0
        found: list[tuple[float, float, Array]] = []
        for start in np.linspace(0, float(length.max()), 41):
            rows = arm[:, None] * (length - start)[:, None] ** np.arange(1, 4)
            factors = np.asarray(np.linalg.lstsq(rows, wanted)[0], dtype=float)
            found.append((float(np.abs(rows @ factors - wanted).max()), float(start), factors))
        off, start, factors = min(found, key=lambda one: one[0])
        return factors, start, off

    def _not_balanced(self) -> list[str]:
        """What the files lack of counterbalances."""
        said = [
            f"counterbalance of {joint}: URDF cannot hold it; {_near(self.tendon(joint)[2])}, model.yaml has all of it"
            for joint in self.counterbalances
        ]
        unknown = {one.axis for one in self.effects if one.effect == "counterbalance"} - {*self.counterbalances}
        return said + [
            f"counterbalance of {joint}: the robot file has none, so only `effects` of model.yaml has its torque"
            for joint in sorted(unknown)
        ]

    def _not_held(self) -> str:
        """The gravity torque in which no physical robot agrees with the estimate, of the axis with most of it."""
        if not self.worth:
            return ""
        most = max(self.worth, key=lambda one: one.not_held / max(one.gravity.value, 1e-9))
        return (
            f"; gravity torque of {most.joint} by {most.not_held:.3g} of {most.gravity.value:.4g} N m (N), RMS over "
            "the workspace: the torque of a counterbalance is in no file"
        )

    def _off_the_line(self, joint: str) -> str:
        """How far MJCF and URDF are from the friction of an axis that has another law than they can hold."""
        k = self.robot.index(joint)
        points = [(abs(self._line(k, one.velocity) - one.effort), abs(one.velocity)) for one in self.curves[joint]]
        most, velocity = max(points)
        return (
            f"friction of {joint} is no straight line: damping and friction of URDF and MJCF are off by up to "
            f"{most:.3g} N m (N), at {velocity:.3g} rad/s (m/s); use friction_curve of model.yaml"
        )

    def _line(self, k: int, velocity: float) -> float:
        return (self.friction[k] or 0.0) * velocity + math.copysign(self.dry_friction[k] or 0.0, velocity)

    def table(self) -> Table:
        """One row a joint."""
        return Table(
            f"Identified model of the robot {self.robot.name}, SI",
            (
                Column("joint", self.robot.joints),
                Column("link", tuple(body.link for body in self.bodies)),
                Column("mass", tuple(body.mass for body in self.bodies)),
                Column("motor inertia", tuple(self.motor_inertias.tolist())),
                Column("viscous friction", self.friction),
                Column("dry friction", self.dry_friction),
            ),
        )


def identified_model(robot: Robot, document: object, place: str = "estimate") -> IdentifiedModel:
    """`model_of` for a stored document or one from a file; BadInput if it is no estimate."""
    return model_of(robot, Estimate.read(document, place), place)


def model_of(robot: Robot, found: Estimate, place: str = "estimate") -> IdentifiedModel:
    """The robot with the values of an estimate; BadInput if that is of another robot, is empty or is not finite."""
    deviation = found.physical.deviation_in_std
    if deviation is None or not (found.axes or found.combination):
        raise BadInput(place, "contains no identified parameters: no sweep and no free motion shows inertia")
    for joint in found.axes:
        robot.index(joint)
    for one in found.base_parameters:
        _finite(one.value, f"{place} base_parameters {one.name}")
        _finite(one.std or 0.0, f"{place} base_parameters {one.name} std")
    for name, symbol in found.symbols.items():
        _finite(symbol.value, f"{place} symbols {name}")
    standard = found.standard_parameters
    drives = [_of_motion(found, joint) or _of_sweeps(found, joint, place) for joint in robot.joints]
    return IdentifiedModel(
        robot=robot,
        bodies=tuple(_body(standard, joint.link, place) for joint in robot.chain.joints),
        motor_inertias=np.array([_motor(standard, joint, place) for joint in robot.joints]),
        friction=tuple(drive[0] for drive in drives),
        dry_friction=tuple(drive[1] for drive in drives),
        offset=tuple(drive[2] for drive in drives),
        curves={} if found.combination is None else _curves(found.combination),
        springs={joint: spring for joint, axis in found.axes.items() if (spring := _spring(axis)) is not None},
        counterbalances=_counterbalances(robot, found.effects, place),
        hoses={one.axis: _hose(one, place) for one in found.effects if one.effect == "hose_spring"},
        effects=found.effects,
        base_parameters=found.base_parameters,
        symbols=found.symbols,
        deviation_in_std=_finite(deviation, f"{place} physical deviation_in_std"),
        estimate=found,
    )


def _body(standard: StandardParameters, link: str, place: str) -> LinkBody:
    place = f"{place} standard_parameters"
    values = standard.links.get(link)
    if values is None or set(values) != set(INERTIAL_NAMES):
        raise BadInput(place, f"lacks the ten parameters of link {link}")
    if values["m"] <= 0:
        raise BadInput(place, f"mass of link {link} is {values['m']} kg, must exceed 0")
    return body_of(link, np.array([_finite(values[name], f"{place} {link} {name}") for name in INERTIAL_NAMES]))


def body_of(link: str, parameters: Array) -> LinkBody:
    """From the ten parameters (10,) at the frame's origin; the mass is not 0."""
    mass = float(parameters[0])
    centre = parameters[1:4] / mass
    about = inertia_matrix(parameters) - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return LinkBody(link, mass, centre, about, parameters)


def _motor(standard: StandardParameters, joint: str, place: str) -> float:
    value = standard.motor_inertias.get(f"Jm({joint})")
    if value is None:
        raise BadInput(f"{place} standard_parameters", f"lacks the motor inertia of joint {joint}")
    return _finite(value, f"{place} standard_parameters Jm({joint})")


def _of_sweeps(found: Estimate, joint: str, place: str) -> tuple[float | None, float | None, float]:
    """Viscous friction of the sweeps; dry friction and offset of the accepted effects, which sweeps do not show."""
    viscous = _friction(found.axes[joint], f"{place} axes {joint}") if joint in found.axes else None
    stated = [
        _finite(one.parameters["offset"].value, f"{place} effects {joint} offset")
        for one in found.effects
        if (one.axis, one.effect) == (joint, "effort_offset") and "offset" in one.parameters
    ]
    return viscous, _dry_friction(found.effects, joint, place), sum(stated)


def _of_motion(found: Estimate, joint: str) -> tuple[float, float, float] | None:
    """Viscous and dry friction and offset that trajectories or free motions determine together; None without them.

    Friction with another law becomes the straight line nearest to it over the speeds of the motion. An offset that a
    weight cannot be told from, as on a vertical slide, is in the weight.
    """
    if found.combination is None:
        return None
    named = {one.name: one for one in found.combination.base_parameters}
    own = [named.get(f"{name}({joint})") for name in ("Fv", "Fc", "offset")]
    if None in own[:2] or all(one is None or one.std is None for one in own):
        return None
    viscous, dry, offset = (0.0 if one is None else one.value for one in own)
    if curve := _curves(found.combination).get(joint):
        weights = 1 / np.array([one.std for one in curve])
        rows = np.array([(one.velocity, np.sign(one.velocity)) for one in curve]) * weights[:, None]
        viscous, dry = np.linalg.lstsq(rows, np.array([one.effort for one in curve]) * weights, rcond=None)[0].tolist()
    return max(viscous, 0.0), max(dry, 0.0), offset


def _curves(found: Combination) -> dict[str, tuple[FrictionPoint, ...]]:
    return {joint: axis.friction for joint, axis in found.free_motion_axes.items() if axis.friction}


def _spring(axis: EstimatedAxis) -> tuple[float, float] | None:
    """Of the joint fit, where its sweeps show that the gear gives way: two standard deviations."""
    train = axis.drive_train or {}
    if not {"compliance", "damping_time"} <= set(train):
        return None
    compliance, time = train["compliance"], train["damping_time"]
    if not compliance.value > 2 * (compliance.std or 0.0):
        return None
    return 1 / compliance.value, max(time.value, 0.0) / compliance.value


def _counterbalances(robot: Robot, effects: Iterable[UsedEffect], place: str) -> dict[str, Counterbalance]:
    found = {axis.joint: axis.counterbalance for axis in robot.axes if axis.counterbalance is not None}
    for one in effects:
        if one.effect == "counterbalance" and one.axis in found and {"share", "rate"} <= set(one.parameters):
            here = f"{place} effects {one.axis} counterbalance"
            share, rate = (_finite(one.parameters[name].value, here) for name in ("share", "rate"))
            found[one.axis] = found[one.axis].off(share, rate)
    return found


def _near(off: float) -> str:
    return "MJCF has it as a tendon" + (f", off by up to {off:.3g} N m" if off else "")


def _hose(effect: UsedEffect, place: str) -> tuple[float, float]:
    """Stiffness and rest of ``k q + torque_at_zero``."""
    here = f"{place} effects {effect.axis} hose_spring"
    stiffness, torque = (effect.parameters.get(name) for name in ("stiffness", "torque_at_zero"))
    if stiffness is None or torque is None or not _finite(stiffness.value, here) > 0:
        return 0.0, 0.0
    return stiffness.value, -_finite(torque.value, here) / stiffness.value


def _friction(axis: EstimatedAxis, place: str) -> float | None:
    """Noise can make a very small friction negative, which would accelerate the joint."""
    frictions = [sweep.viscous_friction for sweep in axis.inertia if sweep.viscous_friction is not None]
    if not frictions or len(frictions) < len(axis.inertia):
        raise BadInput(place, "has a sweep without viscous_friction, or no sweep at all")
    return max(float(np.median([_finite(value, f"{place} viscous_friction") for value in frictions])), 0.0)


def _dry_friction(effects: Iterable[UsedEffect], joint: str, place: str) -> float | None:
    """Several effects may contain dry friction, each the whole of it: the largest."""
    stated = [
        effect.parameters["coulomb"] for effect in effects if effect.axis == joint and "coulomb" in effect.parameters
    ]
    values = [_finite(each.value, f"{place} effects {joint} coulomb") for each in stated]
    return max([*values, 0.0]) if values else None


def _finite(value: float, place: str) -> float:
    """External data may contain NaN and Infinity, which are not allowed in JSON."""
    if not math.isfinite(value):
        raise BadInput(place, f"{value} is not a finite number")
    return value


def observation(robot: Robot, found: Estimate, place: str) -> ObservedCombinations:
    """The base parameters that an estimate determines. BadInput if it is of another robot.

    Estimates of an earlier version have no base: then nothing was locked, and the parameters are independent.
    """
    fixed = {robot.index(joint): position for joint, position in found.base.locked.items()}
    left = [k for k in range(len(robot.joints)) if k not in fixed]
    moved = sorted(robot.index(joint) for joint in found.axes)
    if not set(moved) <= set(left):
        raise BadInput(f"{place} base.locked", "names a joint that was measured")
    own, stated = base_parameters(lock(robot.chain, fixed), tuple(left.index(k) for k in moved)), found.base_parameters
    if tuple(one.name for one in stated) != own.names:
        other = next((one.name for one in stated if one.name not in own.names), f"{len(stated)} parameters")
        raise BadInput(
            f"{place} base_parameters",
            f"are not those of robot {robot.name}: {other}; give an estimate of this very robot",
        )
    if len({len(row) for row in found.base.covariance}) > 1:
        raise BadInput(f"{place} base.covariance", "has rows of different lengths")
    known = [k for k, one in enumerate(stated) if one.std is not None]
    covariance = np.array(found.base.covariance, dtype=float)
    if covariance.shape != (len(stated), len(stated)):
        covariance = np.diag([(one.std or 0.0) ** 2 for one in stated])
    return ObservedCombinations(
        own.combination[known] @ fold(robot.chain, fixed),
        np.array([stated[k].value for k in known]),
        covariance[np.ix_(known, known)],
    )


def _of_combination(robot: Robot, found: Combination | None) -> ObservedCombinations | None:
    """The base parameters of links and motors that motions determine; None if they are of another robot."""
    if found is None or not found.covariance:
        return None
    names, count = tuple(one.name for one in found.base_parameters), 11 * len(robot.axes)
    base = dynamic_base(robot, apart=[joint for joint in robot.joints if f"Jm({joint})" in names])
    if names != base.names:
        return None
    own = [k for k, one in enumerate(found.base_parameters) if base.columns[k] < count and one.std is not None]
    return ObservedCombinations(
        base.combination[own, :count],
        np.array([found.base_parameters[k].value for k in own]),
        np.array(found.covariance)[np.ix_(own, own)],
    )


def _worth_of(robot: Robot, found: Estimate, parameters: Array) -> tuple[AxisWorth, ...]:
    """Of the parameters (11 n,) of an estimate; empty if it determines none, or is of another robot."""
    try:
        observed = observation(robot, found, "") if found.axes else _of_combination(robot, found.combination)
    except BadInput:
        observed = None
    if observed is None or not len(observed.values):
        return ()
    motors = np.array([axis.reflected_motor_inertia or 0.0 for axis in robot.axes])
    unknown = motors == 0
    motors[unknown] = parameters[-len(motors) :][unknown]
    nominal = np.concatenate([robot.chain.inertial.ravel(), motors])
    spread = robot.prior.inertia, np.where(unknown, 1.0, robot.prior.motor_inertia)
    moved = {} if found.combination is None else found.combination.free_motion_axes
    unpredicted = [moved[joint].held_out_rms if joint in moved else 0.0 for joint in robot.joints]
    return NominalModel(robot, nominal, spread).worth(observed, parameters, np.array(unpredicted))
