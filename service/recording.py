"""A sweep: what was commanded and what was recorded (BUNDLE format `sweepid-bundle/1`, section "sweeps")."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, StringConstraints

Array = NDArray[np.float64]

_PRINTABLE = r"^[^\x00-\x1f\x7f-\x9f]*$"
Name = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=_PRINTABLE)]
Label = Annotated[str, StringConstraints(max_length=200, pattern=_PRINTABLE)]

REQUIRED_COLUMNS = ("time", "effort", "velocity", "position")
STEPPED = "stepped_sine"  # how the block of an initial analysis by sines is called
WARM_UP = "warm_up"  # the block of sweeps that bring the gears to their working temperature
OPTIONAL_COLUMNS = ("velocity_setpoint", "excitation_effort", "load_velocity", "load_position", "temperature")


class Sine(BaseModel):
    """``amplitude * sin(2 pi frequency (t - measure_from) + phase)``; Hz, rad/s (m/s), rad."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    frequency: float = Field(gt=0)
    amplitude: float = Field(ge=0)
    phase: float = 0.0


class SweepSpec(BaseModel):
    """One sweep as planned and as written to a bundle; all times in s, all quantities SI on the joint side."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    id: Name
    axis: Name
    pose: tuple[float, ...]
    offset_velocity: float
    excitation: Literal["multisine", "noise", "trajectory", "standstill"] = "multisine"
    sines: tuple[Sine, ...] = ()
    period: float | None = Field(default=None, gt=0)
    periods: int | None = Field(default=None, ge=1, le=10**9)  # a file may say anything, and a float must hold it
    measure_from: float = Field(default=0.0, ge=0)
    sample_rate: float = Field(gt=0)
    started_at: float = 0.0
    repeat: int = Field(default=0, ge=0)
    block: Label = ""

    @property
    def periodic(self) -> bool:
        """True when a window of whole periods with known lines was measured."""
        return bool(self.sines) and self.period is not None and self.periods is not None

    @property
    def shows_inertia(self) -> bool:
        """True for sines and trajectories; noise, stepped sines, warm-up and standstill serve other ends than J.

        So do sines about standstill: at each reversal dry friction is no constant.
        """
        moves = self.excitation == "trajectory" or (self.excitation == "multisine" and self.offset_velocity != 0)
        return moves and not self.stepped and self.block != WARM_UP

    @property
    def moves(self) -> bool:
        """True where the axis follows a motion: not with torque noise, nor at standstill, where dry friction holds any
        torque within its limits.
        """
        return self.excitation in ("multisine", "trajectory")

    @property
    def stepped(self) -> bool:
        """True for a few lines of a stepped sine, the initial analysis of a drive without torque injection."""
        return self.excitation == "multisine" and self.block.startswith(STEPPED)


@dataclass(frozen=True, slots=True)
class Recording:
    """Samples of one sweep, arrays (n,) on one drive clock, SI on the joint side; columns as in BUNDLE.md."""

    time: Array
    effort: Array
    velocity: Array
    position: Array
    velocity_setpoint: Array | None = None
    excitation_effort: Array | None = None
    load_velocity: Array | None = None
    load_position: Array | None = None
    temperature: Array | None = None


@dataclass(frozen=True, slots=True)
class Sweep:
    """What was commanded together with what was recorded."""

    spec: SweepSpec
    recording: Recording
