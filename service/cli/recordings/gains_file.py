"""The file in which `sweepid estimate torque-gain` hands calibrated torque constants to `sweepid identify`."""

from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field

from service.configuration import read_yaml
from service.identification.axis.nominal_priors import TorqueGain


class Gain(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    value: float = Field(gt=0)
    std: float = Field(ge=0)


class AxisGain(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    gain: Gain
    poses: int | None = None
    added_inertia: float | None = None


class TorqueGains(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")
    axes: dict[str, AxisGain] = Field(min_length=1)


def read_gains(path: Path) -> dict[str, TorqueGain]:
    """What `sweepid estimate torque-gain --json` wrote, by joint."""
    found = read_yaml(path, TorqueGains)  # JSON is YAML, too
    return {joint: TorqueGain(axis.gain.value, axis.gain.std) for joint, axis in found.axes.items()}
