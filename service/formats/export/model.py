"""The robot with the parameters of an estimate: the source of all exported files."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from service.identification.estimates.standard_parameters import AxisWorth, NominalModel, ObservedCombinations
from service.identification.model.base_parameters import base_parameters
from service.identification.model.regressor import fold, lock
from service.model.arrays import Array
from service.model.errors import BadInput
from service.model.results.estimate import (
    BaseParameter,
    Estimate,
    EstimatedAxis,
    StandardParameters,
    Symbol,
    UsedEffect,
)
from service.model.results.table import Column, Shown, Table
from service.model.robot import INERTIAL_NAMES, Robot
from service.model.urdf import inertia_matrix


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
    dry_friction: tuple[float | None, ...]  # Coulomb, N m (N); None: no effect of the accepted model states it
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
        return tuple(axis.warning for axis in self.worth if axis.warning)

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
    return IdentifiedModel(
        robot=robot,
        bodies=tuple(_body(standard, joint.link, place) for joint in robot.chain.joints),
        motor_inertias=np.array([_motor(standard, joint, place) for joint in robot.joints]),
        friction=tuple(
            _friction(found.axes[joint], f"{place} axes {joint}") if joint in found.axes else _of_motion(found, joint)
            for joint in robot.joints
        ),
        dry_friction=tuple(_dry_friction(found.effects, joint, place) for joint in robot.joints),
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


def _of_motion(found: Estimate, joint: str) -> float | None:
    """Viscous friction that trajectories or free motions identified."""
    parameters = () if found.combination is None else found.combination.base_parameters
    values = [one.value for one in parameters if one.name == f"Fv({joint})" and one.identified]
    return max(values[0], 0.0) if values else None


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


def _worth_of(robot: Robot, found: Estimate, parameters: Array) -> tuple[AxisWorth, ...]:
    """Of the parameters (11 n,) of an estimate; empty if it determines none, or is of another robot."""
    try:
        observed = observation(robot, found, "") if found.axes else None
    except BadInput:
        observed = None
    if observed is None or not len(observed.values):
        return ()
    motors = np.array([axis.reflected_motor_inertia or 0.0 for axis in robot.axes])
    unknown = motors == 0
    motors[unknown] = parameters[-len(motors) :][unknown]
    nominal = np.concatenate([robot.chain.inertial.ravel(), motors])
    spread = robot.prior.inertia, np.where(unknown, 1.0, robot.prior.motor_inertia)
    return NominalModel(robot, nominal, spread).worth(observed, parameters)
