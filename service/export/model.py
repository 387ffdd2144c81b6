"""The robot with the parameters that an estimate found: what all exported files are written from."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, ValidationError

from service.configuration import bad_field
from service.errors import BadInput
from service.robot import INERTIAL_NAMES, Robot
from service.urdf import inertia_matrix

Array = NDArray[np.float64]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class _Sweep(_Part):
    viscous_friction: float


class _Axis(_Part):
    inertia: tuple[_Sweep, ...]


class _Standard(_Part):
    links: dict[str, dict[str, float]]
    motor_inertias: dict[str, float]


class BaseParameter(_Part):
    """As in the estimate; `std` null where the data do not determine it."""

    name: str
    symbolic: str
    value: float
    std: float | None


class Symbol(_Part):
    value: float
    unit: str
    meaning: str


class _Estimate(_Part):
    """What an export needs of the document of `sweepid identify --json`."""

    axes: dict[str, _Axis]
    standard_parameters: _Standard
    base_parameters: tuple[BaseParameter, ...]
    symbols: dict[str, Symbol]
    physical: dict[str, float | None]


@dataclass(frozen=True)
class Body:
    """A link with all that is fixed to it. SI; centre (3,) in the link's frame, inertia (3, 3) about the centre."""

    link: str
    mass: float
    centre: Array
    inertia: Array
    parameters: Array  # (10,) at the frame's origin


@dataclass(frozen=True)
class IdentifiedModel:
    """A robot's joints (n), in order, each with its body, its motor and, where it was measured, its friction."""

    robot: Robot
    bodies: tuple[Body, ...]
    motor_inertias: Array  # (n,) kg m^2 (kg) on the joint side, 0 where neither known nor measured
    friction: tuple[float | None, ...]  # viscous, N m s/rad (N s/m); None: the axis was not measured
    base_parameters: tuple[BaseParameter, ...]
    symbols: dict[str, Symbol]
    deviation_in_std: float


def identified_model(robot: Robot, document: Mapping[str, Any], place: str = "estimate") -> IdentifiedModel:
    """The robot as an estimate's document has it; BadInput where that is of another robot or identified nothing."""
    try:
        found = _Estimate.model_validate(document)
    except ValidationError as error:
        raise bad_field(place, error) from None
    deviation = found.physical.get("deviation_in_std")
    if not found.axes or deviation is None:
        raise BadInput(place, "identified nothing: there was no sweep that shows inertia")
    for joint in found.axes:
        robot.index(joint)
    standard = found.standard_parameters
    return IdentifiedModel(
        robot=robot,
        bodies=tuple(_body(standard, joint.link, place) for joint in robot.chain.joints),
        motor_inertias=np.array([_motor(standard, joint, place) for joint in robot.joints]),
        friction=tuple(_friction(found.axes.get(joint)) for joint in robot.joints),
        base_parameters=found.base_parameters,
        symbols=found.symbols,
        deviation_in_std=deviation,
    )


def _body(standard: _Standard, link: str, place: str) -> Body:
    values = standard.links.get(link)
    if values is None or set(values) != set(INERTIAL_NAMES):
        raise BadInput(f"{place} standard_parameters", f"has not the ten parameters of link {link}")
    if values["m"] <= 0:
        raise BadInput(f"{place} standard_parameters", f"mass of link {link} is {values['m']} kg, must exceed 0")
    return body(link, np.array([values[name] for name in INERTIAL_NAMES]))


def body(link: str, parameters: Array) -> Body:
    """From the ten parameters (10,) at the frame's origin; the mass is not 0."""
    mass = float(parameters[0])
    centre = parameters[1:4] / mass
    about = inertia_matrix(parameters) - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return Body(link, mass, centre, about, parameters)


def _motor(standard: _Standard, joint: str, place: str) -> float:
    value = standard.motor_inertias.get(f"Jm({joint})")
    if value is None:
        raise BadInput(f"{place} standard_parameters", f"has no motor inertia of joint {joint}")
    return value


def _friction(axis: _Axis | None) -> float | None:
    """Noise can make a friction of nearly nothing negative, which would drive the joint."""
    return None if axis is None else max(float(np.median([sweep.viscous_friction for sweep in axis.inertia])), 0.0)
