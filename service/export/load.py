"""What a control's load data need of the document of `sweepid payload --json`."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from service.configuration import bad_field
from service.errors import BadInput
from service.urdf import LARGEST

Array = NDArray[np.float64]
_PLACE = "--payload"

Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class _Figure(_Part):
    value: Number | None
    std_total: Number | None


class _Tensor(_Part):
    """By name: the product writes xx, xy, yy, xz, yz, zz, and JSON has no order."""

    Ixx: Number
    Ixy: Number
    Iyy: Number
    Ixz: Number
    Iyz: Number
    Izz: Number


class _Body(_Part):
    mass: Number
    center: tuple[Number, Number, Number]
    inertia: _Tensor


class _Physical(_Part):
    nearest: _Body


class _Payload(_Part):
    frame: str
    mass: _Figure
    center: dict[str, _Figure]
    inertia: dict[str, _Figure]
    physical: _Physical


@dataclass(frozen=True)
class Load:
    """A body that can exist, in the frame of a joint: kg, m, kg m^2; the columns of `axes` (3, 3) are principal."""

    frame: str
    mass: float
    mass_std: float
    centre: tuple[float, float, float]
    moments: tuple[float, float, float]
    axes: Array


def read_load(document: Mapping[str, Any]) -> Load:
    """BadInput where it is no payload's document, or lacks a number that a control needs."""
    try:
        found = _Payload.model_validate(document)
    except ValidationError as error:
        raise bad_field(_PLACE, error) from None
    figures = {"mass": found.mass, **found.center, **found.inertia}
    open_ = [name for name, part in figures.items() if part.value is None]
    if open_:
        raise BadInput(_PLACE, f"does not know {', '.join(open_)}: its motions did not excite them")
    if found.mass.std_total is None:
        raise BadInput(f"{_PLACE} mass.std_total", "is missing")
    near, of = found.physical.nearest, found.physical.nearest.inertia
    tensor = np.array([[of.Ixx, of.Ixy, of.Ixz], [of.Ixy, of.Iyy, of.Iyz], [of.Ixz, of.Iyz, of.Izz]])
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    if not moments[0] > 0 or moments[2] > moments[0] + moments[1] + 1e-9:
        raise BadInput(_PLACE, "no body has these moments of inertia")
    least, middle, most = moments.tolist()
    return Load(found.frame, near.mass, found.mass.std_total, near.center, (least, middle, most), axes)
