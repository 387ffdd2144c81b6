"""Description of a CNC for the export of paths (`config/controls/*.yaml`): axes, cycle, memory, trace."""

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from service.formats.traces.mapping import CncAxis, Columns, Csv
from service.model.configuration import read_yaml
from service.model.errors import BadInput
from service.model.robot import Robot


class Trace(BaseModel):
    """How the CNC exports its trace."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    sample_rate: float = Field(gt=0)  # Hz
    csv: Csv = Csv()
    columns: Columns


class Control(BaseModel):
    """One CNC. `axes` by joint; all joints of the robot are required."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    name: str = Field(min_length=1)
    axes: dict[str, CncAxis]
    interpolation_cycle: float = Field(default=0.004, ge=0.0005, le=0.02)  # s
    largest_program: int = Field(default=1_000_000, ge=10_000)  # bytes
    trace: Trace


def read_control(path: Path, robot: Robot) -> Control:
    """The control of a robot; BadInput unless it names each joint once, each with a different axis."""
    control = read_yaml(path, Control)
    if set(control.axes) != set(robot.joints):
        raise BadInput(f"{path} axes", f"must be the joints of {robot.name}: {', '.join(robot.joints)}")
    names = [axis.name.upper() for axis in control.axes.values()]
    if len(set(names)) < len(names):
        raise BadInput(f"{path} axes", f"an axis is listed twice: {', '.join(names)}")
    if control.trace.columns.set_position is None:
        raise BadInput(f"{path} trace.columns", "set_position is missing: it tells where a trace's motion starts")
    return control
