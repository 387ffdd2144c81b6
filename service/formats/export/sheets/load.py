"""A payload in the form of the load data of a control."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.model.errors import BadInput
from service.model.results.payload import Payload
from service.model.robot import INERTIAL_NAMES
from service.model.urdf import LARGEST

Array = NDArray[np.float64]
_PLACE = "--payload"


@dataclass(frozen=True)
class Load:
    """A physical body, in the frame of a joint: kg, m, kg m^2; the columns of `axes` (3, 3) are principal axes."""

    frame: str
    mass: float
    mass_std: float
    centre: tuple[float, float, float]
    moments: tuple[float, float, float]
    axes: Array


def load_of(found: Payload) -> Load:
    """BadInput if a value that a control needs is missing, or no body can have these values."""
    figures = {"mass": found.mass, **found.center, **found.inertia}
    open_ = [name for name, part in figures.items() if part.value is None]
    if open_:
        raise BadInput(_PLACE, f"lacks {', '.join(open_)}: its motions did not excite them")
    if found.mass.std_total is None:
        raise BadInput(f"{_PLACE} mass.std_total", "is missing")
    near = found.physical.nearest
    if set(near.inertia) != set(INERTIAL_NAMES[4:]):
        raise BadInput(f"{_PLACE} physical.nearest.inertia", f"lacks {', '.join(INERTIAL_NAMES[4:])}")
    for value in (found.mass.std_total, near.mass, *near.center, *near.inertia.values()):
        if not abs(value) <= LARGEST:
            raise BadInput(_PLACE, f"has {value}, must be a number of at most {LARGEST:g}")
    of = near.inertia
    tensor = np.array(
        [[of["Ixx"], of["Ixy"], of["Ixz"]], [of["Ixy"], of["Iyy"], of["Iyz"]], [of["Ixz"], of["Iyz"], of["Izz"]]]
    )
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    if not moments[0] > 0 or moments[2] > moments[0] + moments[1] + 1e-9:
        raise BadInput(_PLACE, "has moments of inertia that are not physically possible")
    least, middle, most = moments.tolist()
    return Load(found.frame, near.mass, found.mass.std_total, near.center, (least, middle, most), axes)


def zyx(rotation: Array) -> tuple[float, float, float]:
    """A, B, C of a KUKA, deg: about Z, then the new Y, then the new X."""
    b = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    a = math.atan2(rotation[1, 0], rotation[0, 0])
    c = math.atan2(rotation[2, 1], rotation[2, 2])
    return math.degrees(a), math.degrees(b), math.degrees(c)
