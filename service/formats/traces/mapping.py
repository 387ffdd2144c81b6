"""The mapping file of a trace import (docs/how-to/your-own-trace.md): meaning and unit of each column of a trace.

A unit determines scale and offset from the data of the sweep's axis, so the user need not enter a gear ratio twice.
"""

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, model_validator

from service.model import Axis, Most, Name, Position, Prior, SweepSpec, Velocity

Unit = Literal[
    "axis position",  # deg or mm as the CNC displays it: with the direction and zero of the CNC axis
    "deg",
    "mm",
    "motor rev",
    "motor rev/min",
    "motor N m",
    "percent",  # of the rated torque
    "ms",
    "samples",  # counts at the sweep's sample rate
]
Group = str | int  # MDF4: name or number; HDF5: path


class _MappingPart(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class CncAxis(_MappingPart):
    """A joint in the CNC: the CNC position is ``zero + direction * joint position``, in deg (mm)."""

    name: str = Field(default="axis", pattern=r"^[A-Za-z_][A-Za-z0-9_]{0,30}$")
    direction: Literal[1, -1] = 1
    zero: float = 0.0
    torque_constant: float | None = Field(default=None, gt=0)  # N m per A, of the motor


class SourceColumn(_MappingPart):
    """A column of the source: ``scale * source + offset`` is in SI units on the joint side; a unit determines both.

    Without any of them, the unit in the file itself is converted; without a unit the values are SI.
    """

    source: str  # of a matrix a column, from 0: `q[2]`
    group: Group | None = None  # instead of that of the sweep
    column: int | None = Field(default=None, ge=0)  # the same
    unit: Unit | None = None
    scale: float = 1.0
    offset: float = 0.0

    @property
    def name(self) -> str:
        """The source, with the column of a matrix."""
        return self.source if self.column is None else f"{self.source}[{self.column}]"

    @property
    def scaled(self) -> bool:
        """True if the mapping determines the conversion to SI, so that the unit in the file is ignored."""
        return bool(self.model_fields_set & {"scale", "offset"})

    @model_validator(mode="after")
    def _one_way(self) -> "SourceColumn":
        if self.unit is not None and self.scaled:
            raise ValueError("give a unit, or scale and offset")
        return self

    def to_si(self, axis: Axis, cnc: CncAxis, position_unit: float, sample_rate: float) -> tuple[float, float]:
        """Scale and offset for a sweep of `axis`; `position_unit` is 1 deg (1 mm) in rad (m)."""
        turn = math.tau / axis.gear_ratio
        scales: dict[Unit, float] = {
            "axis position": cnc.direction * position_unit,
            "deg": math.radians(1.0),
            "mm": 1e-3,
            "motor rev": turn,
            "motor rev/min": turn / 60,
            "motor N m": axis.gear_ratio,
            "percent": math.copysign(axis.rated_effort / 100, axis.gear_ratio),
            "ms": 1e-3,
            "samples": 1 / sample_rate,
        }
        if self.unit is None:
            return self.scale, self.offset
        scale = scales[self.unit]
        return scale, -scale * cnc.zero if self.unit == "axis position" else 0.0


class FromPosition(_MappingPart):
    """Velocity by differentiating the position; low-pass corner in Hz."""

    from_position: float = Field(gt=0)


# the alternative is selected before its fields are checked, so that an error message names the right field
def _velocity_kind(given: Any) -> str:
    derived = "from_position" in given if isinstance(given, dict) else isinstance(given, FromPosition)
    return "derived" if derived else "measured"


def _robot_kind(given: Any) -> str:
    return "axis" if isinstance(given, dict | SingleAxis) else "file"


class Columns(_MappingPart):
    """Source of each column of the bundle. Those that are not named are found by name and unit in the file;
    without `time`, the clock of the file is used, else it follows from the sample rate.

    `set_position` is not a column of the bundle: it is used to find the start of the sweep in the trace.
    """

    time: SourceColumn | None = None
    effort: SourceColumn | None = None
    velocity: (
        Annotated[
            Annotated[SourceColumn, Tag("measured")] | Annotated[FromPosition, Tag("derived")],
            Discriminator(_velocity_kind),
        ]
        | None
    ) = None
    position: SourceColumn | None = None
    velocity_setpoint: SourceColumn | None = None
    excitation_effort: SourceColumn | None = None
    load_velocity: SourceColumn | None = None
    load_position: SourceColumn | None = None
    temperature: SourceColumn | None = None
    set_position: SourceColumn | None = None

    @property
    def sources(self) -> dict[str, SourceColumn]:
        """The columns that are in the trace, by name."""
        there = ((name, getattr(self, name)) for name in Columns.model_fields)
        return {name: column for name, column in there if isinstance(column, SourceColumn)}


class SingleAxis(_MappingPart):
    """A robot with one axis, defined without a URDF: it rotates about or moves along the base's x.

    What is not given is taken from the trace.
    """

    name: Name
    joint: str = Field(min_length=1, pattern=r"^[\w.-]+$")
    kind: Literal["revolute", "prismatic"] | None = None
    inertia: float | None = Field(default=None, gt=0)  # nominal, load side: kg m^2 about the axis; prismatic: kg
    lower: float | None = None  # rad (m)
    upper: float | None = None
    velocity: float | None = Field(default=None, gt=0)  # rad/s (m/s)
    rated_effort: float | None = Field(default=None, gt=0)  # N m (N)
    gear_ratio: float | None = None  # None: that of two speeds in the file, else 1
    motor_inertia: float | None = Field(default=None, ge=0)
    viscous_friction: float | None = Field(default=None, ge=0)
    prior: Prior = Prior()


class Csv(_MappingPart):
    """Format of a text source, where it is not to be found by content; rows before the heading are skipped."""

    delimiter: str | None = Field(default=None, min_length=1, max_length=1)
    decimal_point: str | None = Field(default=None, min_length=1, max_length=1)
    skip_rows: int = Field(default=0, ge=0, le=10**6)


class SweepTimes(_MappingPart):
    """Data for the path of the sweep in addition to its fields, s; `measure_from` is then found in the trace."""

    ramp: float = Field(gt=0)
    settle: float = Field(ge=0)


class TraceSweep(SweepSpec):
    """One sweep of BUNDLE.md with its trace file, relative to the mapping file. What is not given is taken from the
    trace: the axis of a robot with one, the pose of such, the sample rate; a motion without sines is a trajectory.
    """

    id: Name = "0001"
    axis: Name = "axis"
    pose: tuple[Position, ...] = ()
    offset_velocity: Velocity = 0.0
    sample_rate: float = Field(default=1.0, gt=0, le=Most.frequency)
    source: Path
    group: Group | None = None  # of its channels in an MDF4 or HDF5 file; the session of a control's trace
    file_axis: str | int | None = None  # number or name of the axis in a file of several
    path: SweepTimes | None = None

    @model_validator(mode="after")
    def _known_path(self) -> "TraceSweep":
        if self.path is not None and not self.periodic:
            raise ValueError("path needs sines, period and periods")
        return self


class Mapping(_MappingPart):
    """The mapping file. `robot`: a side file of ``config/robots`` relative to this file, or one axis defined here."""

    robot: Annotated[Annotated[Path, Tag("file")] | Annotated[SingleAxis, Tag("axis")], Discriminator(_robot_kind)]
    axes: dict[str, CncAxis] = {}  # by joint; default: the joint's direction and zero
    columns: Columns = Columns()
    csv: Csv = Csv()
    sweeps: tuple[TraceSweep, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _can_be_aligned(self) -> "Mapping":
        if self.columns.set_position is None and any(sweep.path is not None for sweep in self.sweeps):
            raise ValueError("a sweep with a path needs columns.set_position")
        return self
