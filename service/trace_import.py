r"""Turns trace exports (.mat, .csv, .parquet) into a bundle, as a mapping file tells (docs/how-to/your-own-trace.md).

A machine that records no velocity gives position alone; the mapping then says ``velocity: {from_position: 100}``, the
number being the corner of a low-pass filter in Hz. The way from position to velocity must not look like inertia:

- a central difference of second order passes ``sin(w T) / (w T) = 1 - (w T)^2 / 6`` of the velocity, an error that
  grows with f^2 exactly as joint elasticity does; of order 8 the error is ``-(w T)^8 / 630``, 1e-10 at 20 Hz and
  1 kHz;
- the filter is a Butterworth of order 4 run forwards and backwards: no phase, hence no delay of speed against torque
  and no false friction; it passes ``1 / (1 + (f / f_c)^8)``, 3e-6 short of one at a fifth of the corner.

Both ends are continued by odd reflection, which keeps value and slope. Identification looks at bins below 20 Hz; keep
the corner five times above.
"""

from pathlib import Path
from typing import Annotated, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag
from scipy.io import loadmat
from scipy.signal import butter, sosfiltfilt

from service.configuration import read_robot, read_yaml
from service.errors import BadInput
from service.recording import Recording, Sweep, SweepSpec
from service.robot import Axis, Prior, Robot, RobotDescription, build_robot
from service.store.columns import CsvForm, read_table

Array = NDArray[np.float64]

# f'(x) h of order 8 from samples at x+1 h ... x+4 h minus those at x-1 h ... x-4 h (Fornberg 1988, table 1)
_CENTRAL = (4 / 5, -1 / 5, 4 / 105, -1 / 280)


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Column(_Part):
    """A column of the source: ``scale * source + offset`` is SI on the joint side."""

    source: str
    scale: float = 1.0
    offset: float = 0.0


class FromPosition(_Part):
    """Velocity by differentiating the position; low-pass corner in Hz."""

    from_position: float = Field(gt=0)


# which of the two is meant decides before the fields do, so that a complaint names the right field
def _velocity_kind(given: Any) -> str:
    return "derived" if isinstance(given, dict) and "from_position" in given else "measured"


def _robot_kind(given: Any) -> str:
    return "axis" if isinstance(given, dict) else "file"


class Columns(_Part):
    """Where each column of the bundle comes from; without `time` the sample rate makes it."""

    time: Column | None = None
    effort: Column
    velocity: Annotated[
        Annotated[Column, Tag("measured")] | Annotated[FromPosition, Tag("derived")], Discriminator(_velocity_kind)
    ]
    position: Column
    velocity_setpoint: Column | None = None
    excitation_effort: Column | None = None
    load_velocity: Column | None = None
    load_position: Column | None = None
    temperature: Column | None = None


class SingleAxis(_Part):
    """A robot of one axis, told without a URDF: it turns about or slides along the base's x."""

    name: str = Field(min_length=1)
    joint: str = Field(min_length=1, pattern=r"^[\w.-]+$")
    kind: Literal["revolute", "prismatic"]
    inertia: float = Field(gt=0)  # nominal, load side: kg m^2 about the axis; prismatic: kg
    lower: float  # rad (m)
    upper: float
    velocity: float = Field(gt=0)  # rad/s (m/s)
    rated_effort: float = Field(gt=0)  # N m (N)
    gear_ratio: float = 1.0
    motor_inertia: float | None = Field(default=None, ge=0)
    viscous_friction: float | None = Field(default=None, ge=0)
    prior: Prior = Prior()


class Csv(_Part):
    """How a CSV source is written."""

    delimiter: str = Field(default=",", min_length=1, max_length=1)
    decimal_point: str = Field(default=".", min_length=1, max_length=1)
    skip_rows: int = Field(default=0, ge=0)


class TraceSweep(SweepSpec):
    """One sweep of BUNDLE.md with the trace it was recorded in, relative to the mapping file."""

    source: Path


class Mapping(_Part):
    """The mapping file. `robot`: a side file of ``config/robots`` relative to this file, or one axis in place."""

    robot: Annotated[Annotated[Path, Tag("file")] | Annotated[SingleAxis, Tag("axis")], Discriminator(_robot_kind)]
    columns: Columns
    csv: Csv = Csv()
    sweeps: tuple[TraceSweep, ...] = Field(min_length=1)


def import_trace(mapping_file: Path, source: Path | None = None) -> tuple[Robot, tuple[Sweep, ...]]:
    """Robot and sweeps as a mapping file describes them, not yet checked for gaps: `write_bundle` does that.

    `source` replaces the trace file of a mapping with one sweep. BadInput names file, field and reason.
    """
    mapping = read_yaml(mapping_file, Mapping)
    if source is not None and len(mapping.sweeps) > 1:
        raise BadInput(str(mapping_file), f"names {len(mapping.sweeps)} traces, so none can be given in their place")
    if isinstance(mapping.robot, SingleAxis):
        robot = _single_axis_robot(mapping.robot, str(mapping_file))
    else:
        robot = read_robot(mapping_file.parent / mapping.robot)
    sweeps: list[Sweep] = []
    for entry in mapping.sweeps:
        path = source or mapping_file.parent / entry.source
        spec = SweepSpec.model_validate(entry.model_dump(exclude={"source"}))
        sweeps.append(Sweep(spec, _recording(mapping, path, spec.sample_rate)))
    return robot, tuple(sweeps)


def differentiate(signal: Array, sample_rate: float, corner: float) -> Array:
    """Time derivative (n,) of a signal (n,) sampled at `sample_rate` Hz, without phase; see the module's header."""
    sections = cast(Array, butter(4, corner, fs=sample_rate, output="sos"))
    run_in = _run_in(sample_rate, corner)
    smooth = np.pad(sosfiltfilt(sections, signal, padlen=run_in), len(_CENTRAL), mode="reflect", reflect_type="odd")
    derivative = np.zeros(len(signal))
    for distance, weight in enumerate(_CENTRAL, start=1):
        middle = len(_CENTRAL)
        ahead = smooth[middle + distance : middle + distance + len(signal)]
        behind = smooth[middle - distance : middle - distance + len(signal)]
        derivative += weight * sample_rate * (ahead - behind)
    return derivative


def _run_in(sample_rate: float, corner: float) -> int:
    """Samples of odd reflection until the filter has settled: its slowest pole decays as exp(-2.4 corner t)."""
    return int(10 * sample_rate / corner)


def _recording(mapping: Mapping, path: Path, sample_rate: float) -> Recording:
    columns = mapping.columns
    wanted = {name: value for name in Columns.model_fields if isinstance(value := getattr(columns, name), Column)}
    sources = tuple(dict.fromkeys(column.source for column in wanted.values()))
    if path.suffix == ".mat":
        raw = _read_mat(path, sources)
    else:
        raw = read_table(path, str(path), sources, form=CsvForm(**mapping.csv.model_dump()))
    taken = {name: column.scale * raw[column.source] + column.offset for name, column in wanted.items()}
    position = taken["position"]
    if "time" in taken:
        taken["time"] = taken["time"] - taken["time"][:1]  # a bundle's clock starts with the sweep
    else:
        taken["time"] = np.arange(len(position)) / sample_rate
    if isinstance(columns.velocity, FromPosition):
        corner = columns.velocity.from_position
        if corner >= sample_rate / 2:
            raise BadInput(str(path), f"low-pass of {corner} Hz is not below half the sample rate {sample_rate} Hz")
        if not np.isfinite(position).all():
            raise BadInput(str(path), "a position is missing; the filter needs all")
        if len(position) <= _run_in(sample_rate, corner):
            raise BadInput(str(path), f"{len(position)} samples are too few for a low-pass of {corner} Hz")
        taken["velocity"] = differentiate(position, sample_rate, corner)
    return Recording(**taken)


def _read_mat(path: Path, names: tuple[str, ...]) -> dict[str, Array]:
    try:
        content = loadmat(str(path), variable_names=list(names))
    except FileNotFoundError:
        raise BadInput(str(path), "file does not exist") from None
    except (OSError, ValueError, TypeError, NotImplementedError) as error:  # not MATLAB's, torn, or of version 7.3
        raise BadInput(str(path), f"cannot be read: {' '.join(str(error).split())}") from None
    columns: dict[str, Array] = {}
    for name in names:
        if name not in content:
            raise BadInput(str(path), f"has no variable {name!r}")
        value = np.asarray(content[name])
        if value.dtype.kind not in "iuf" or value.size != max(value.shape, default=0):
            raise BadInput(str(path), f"variable {name!r} is no column of numbers: {value.dtype} {value.shape}")
        columns[name] = value.astype(np.float64).ravel()
    return columns


def _single_axis_robot(axis: SingleAxis, place: str) -> Robot:
    turning = axis.inertia if axis.kind == "revolute" else 1.0
    mass = axis.inertia if axis.kind == "prismatic" else 1.0
    urdf = f"""<?xml version="1.0"?>
<robot name="single-axis">
  <link name="base"/>
  <link name="load">
    <inertial>
      <mass value="{mass!r}"/>
      <inertia ixx="{turning!r}" iyy="{turning!r}" izz="{turning!r}" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="{axis.joint}" type="{axis.kind}">
    <parent link="base"/>
    <child link="load"/>
    <axis xyz="1 0 0"/>
    <limit lower="{axis.lower!r}" upper="{axis.upper!r}" velocity="{axis.velocity!r}" effort="{axis.rated_effort!r}"/>
  </joint>
</robot>
"""
    drive = Axis(
        joint=axis.joint,
        gear_ratio=axis.gear_ratio,
        motor_inertia=axis.motor_inertia,
        rated_effort=axis.rated_effort,
        viscous_friction=axis.viscous_friction,
    )
    description = RobotDescription(name=axis.name, urdf="robot.urdf", axes=(drive,), prior=axis.prior)
    return build_robot(description, urdf, f"{place} robot")
