"""A sweep: commanded motion and recorded samples (BUNDLE format `sweepid-bundle/1`, section "sweeps")."""

import re
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from service.model.arrays import Array
from service.model.physical_bounds import Most, Position, Velocity

_PRINTABLE = r"^[^\x00-\x1f\x7f-\x9f]*$"
Name = Annotated[str, StringConstraints(min_length=1, max_length=200, pattern=_PRINTABLE)]
Label = Annotated[str, StringConstraints(max_length=200, pattern=_PRINTABLE)]

REQUIRED_COLUMNS = ("time", "effort", "velocity", "position")
OPTIONAL_COLUMNS = ("velocity_setpoint", "excitation_effort", "load_velocity", "load_position", "temperature")


class SweepPurpose(Enum):
    """The purpose of a sweep; the value is the prefix of a block with this purpose."""

    INERTIA = "inertia"
    STEPPED_SINE = "stepped_sine"  # a few lines of a stepped sine, for a drive without torque injection
    WARM_UP = "warm_up"  # brings the gears to their working temperature
    OTHER = "other"  # noise, standstill, or sines about standstill, where dry friction changes at each reversal


def together(number: int, axes: int) -> str:
    """The block of all sweeps of a trajectory; it contains their number, so that none is taken for a single motion."""
    return f"trajectory {number} of {axes} axes"


class Sine(BaseModel):
    """``amplitude * sin(2 pi frequency (t - measure_from) + phase)``; Hz, rad/s (m/s), rad."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    frequency: float = Field(gt=0, le=Most.frequency)
    amplitude: float = Field(ge=0, le=Most.velocity)
    phase: Position = 0.0


class SweepSpec(BaseModel):
    """One sweep as planned and as written to a bundle; all times in s, all quantities SI on the joint side."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
    id: Name
    axis: Name
    pose: tuple[Position, ...]
    offset_velocity: Velocity
    excitation: Literal["multisine", "noise", "trajectory", "standstill"] = "multisine"
    sines: tuple[Sine, ...] = ()
    period: float | None = Field(default=None, gt=0, le=Most.time)
    periods: int | None = Field(default=None, ge=1, le=10**9)  # a file may contain any integer; a float must hold it
    measure_from: float = Field(default=0.0, ge=0, le=Most.time)
    sample_rate: float = Field(gt=0, le=Most.frequency)
    started_at: float = Field(default=0.0, ge=-Most.time, le=Most.time)
    repeat: int = Field(default=0, ge=0, le=10**9)
    block: Label = ""

    @property
    def periodic(self) -> bool:
        """True if a window of complete periods with known lines was measured."""
        return bool(self.sines) and self.period is not None and self.periods is not None

    @property
    def purpose(self) -> SweepPurpose:
        """The purpose in a bundle: from excitation and `block`, because the format has no other field for it."""
        if self.block == SweepPurpose.WARM_UP.value:
            return SweepPurpose.WARM_UP
        if self.excitation == "trajectory":
            return SweepPurpose.INERTIA
        if self.excitation == "multisine" and self.block.startswith(SweepPurpose.STEPPED_SINE.value):
            return SweepPurpose.STEPPED_SINE
        turns = self.excitation == "multisine" and self.offset_velocity != 0
        return SweepPurpose.INERTIA if turns else SweepPurpose.OTHER

    @property
    def axes_at_once(self) -> int:
        """Number of axes of the trajectory that contains this sweep, from its block; 1 for other sweeps."""
        together = re.compile(r"trajectory \d+ of (\d+) axes")
        found = together.fullmatch(self.block)
        return int(found[1]) if found else 1

    @property
    def shows_inertia(self) -> bool:
        """True for sines and trajectories; noise, stepped sines, warm-up and standstill are not used for J."""
        return self.purpose is SweepPurpose.INERTIA

    @property
    def moves(self) -> bool:
        """True if the axis follows a motion; false for torque noise and for standstill, where dry friction can hold any
        torque within its limits.
        """
        return self.excitation in ("multisine", "trajectory")

    @property
    def stepped(self) -> bool:
        """True for some lines of a stepped sine, the initial analysis of a drive without torque injection."""
        return self.purpose is SweepPurpose.STEPPED_SINE


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
    """The commanded motion together with the recorded samples."""

    spec: SweepSpec
    recording: Recording
