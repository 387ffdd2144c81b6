"""The part of a drive profile that is common to all fieldbuses: what must be known before the bus is opened."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from drivers.errors import BadProfile
from drivers.ports import Array, ChannelTiming

Value = TypeVar("Value", float, Array)


class Frozen(BaseModel):
    """Part of a profile: unknown keys and NaN are refused, and it cannot be changed."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class StopOptions(Frozen):
    """CiA 402 option codes 605Ah to 605Eh and 6007h. They are in the profile because manufacturers differ."""

    quick_stop: int = 2  # 605Ah: quick stop ramp, then switch on disabled
    shutdown: int = 0  # 605Bh: disable the drive function
    disable_operation: int = 1  # 605Ch: slow down, then disable
    halt: int = 1  # 605Dh: slow down, stay enabled
    fault_reaction: int = 2  # 605Eh: quick stop ramp
    connection_loss: int = 3  # 6007h: quick stop


class TravelLimits(Frozen):
    """How far an axis may travel after the loss of its host (docs/explanation/safety.md): the free space there."""

    rad: float = Field(default=1.6, gt=0)  # a quarter of a turn
    m: float = Field(default=0.5, gt=0)


class IdentityProfile(Frozen):
    """Identity that the device must report. `serial` tells two drives of one type apart, for example if swapped."""

    vendor: int
    product: int
    revision: int
    serial: int | None = None


class ChannelProfile(Frozen):
    """Delays of the drive's channels relative to the encoder position, s (`drivers.ports.ChannelTiming`)."""

    effort_delay: float = Field(default=0.0, ge=-0.02, le=0.02)
    effort_smoothing: float = Field(default=0.0, ge=0.0, le=0.02)
    velocity_delay: float = Field(default=0.0, ge=-0.02, le=0.02)
    velocity_smoothing: float = Field(default=0.0, ge=0.0, le=0.02)

    @property
    def timing(self) -> ChannelTiming:
        return ChannelTiming(**self.model_dump())


@dataclass(frozen=True, slots=True)
class Gear:
    """Motor side in rev, rev/min, N m <-> joint side in SI.

    With u the signed gear ratio, theta the motor angle [rad] and q0 the joint position at encoder zero:
    q = theta / u + q0,  qd = theta' / u,  effort = u * motor torque.
    """

    gear_ratio: float
    position_offset: float  # rad (m)
    rated_torque: float  # N m of the motor

    def motor_position(self, revolutions: Value) -> Value:
        """Motor rev -> rad (m)."""
        return revolutions * (math.tau / self.gear_ratio) + self.position_offset

    def motor_velocity(self, rev_per_min: Value) -> Value:
        """Motor rev/min -> rad/s (m/s)."""
        return rev_per_min * (math.tau / 60 / self.gear_ratio)

    def motor_effort(self, torque: Value) -> Value:
        """Motor N m -> N m (N)."""
        return torque * self.gear_ratio

    def revolutions(self, position: float) -> float:
        """rad (m) -> motor rev."""
        return (position - self.position_offset) * (self.gear_ratio / math.tau)

    def rev_per_min(self, velocity: float) -> float:
        """rad/s (m/s) -> motor rev/min, signed."""
        return velocity * self.gear_ratio * 60 / math.tau

    def permille(self, effort: float) -> float:
        """Magnitude of an effort, N m (N) -> per mille of the rated torque."""
        return effort / (self.rated_torque * abs(self.gear_ratio)) * 1e3


class AxisProfile(Frozen):
    """One axis. Joint side in rad or m as `unit` says; `rated_torque` is the motor's, N m."""

    joint: str = Field(min_length=1)
    identity: IdentityProfile
    unit: Literal["rad", "m"] = "rad"
    gear_ratio: float  # motor revolutions per joint revolution; prismatic: motor rad per m; signed
    rated_torque: float = Field(gt=0)  # compared with the value of the drive
    load_encoder: bool = False  # a direct encoder on the joint, in the measuring function's trace
    load_encoder_direction: Literal[1, -1] = 1  # -1: counts against the joint
    channels: ChannelProfile = ChannelProfile()
    position_offset: float = 0.0  # joint position where the motor encoder reads zero
    position_limits: tuple[float, float]
    velocity_limit: float = Field(gt=0)  # 1/s
    effort_limit: float = Field(gt=0)  # N m (N)
    acceleration: float = Field(gt=0)  # 1/s^2, positioning moves and the stop sequence's first stage
    quick_stop_deceleration: float = Field(gt=0)  # 1/s^2
    standstill_velocity: float = Field(gt=0)  # 1/s, above the noise of the speed reading

    @property
    def gear(self) -> Gear:
        """Between the motor and this axis."""
        return Gear(self.gear_ratio, self.position_offset, self.rated_torque)

    @model_validator(mode="after")
    def _consistent(self) -> "AxisProfile":
        if self.gear_ratio == 0:
            raise ValueError("gear_ratio must not be 0")
        if self.load_encoder and self.unit == "m":
            raise ValueError("load_encoder: not supported for a linear axis (unit m), set it to false")
        low, high = self.position_limits
        if low >= high:
            raise ValueError(f"position_limits: {low} is not below {high}")
        return self

    def travel_without_host(self, silence: float) -> float:
        """Travel until standstill after the loss of the host, rad (m): `silence` s at the speed limit, plus braking."""
        speed = self.velocity_limit
        return speed * silence + speed**2 / (2 * self.quick_stop_deceleration)

    @property
    def effort_unit(self) -> str:
        return "N m" if self.unit == "rad" else "N"


Parsed = TypeVar("Parsed", bound=BaseModel)


FILL_IN = "FILL IN"
"""Start of a value that a draft leaves to a person."""


def parse(kind: type[Parsed], content: Mapping[str, object]) -> Parsed:
    """`content` as a checked `kind`. BadProfile names the first wrong key, the reason and the given value."""
    refuse_unfilled(content)
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = "".join(f"{part}." for part in first["loc"]).removesuffix(".")
        reason = first["msg"].removeprefix("Value error, ")
        shown = repr(first["input"])
        given = "" if isinstance(first["input"], Mapping) else f" (given: {shown[:200]})"
        raise BadProfile(f"{place}: {reason}{given}" if place else f"{reason}{given}") from None


def refuse_unfilled(content: Mapping[str, object]) -> None:
    """BadProfile names the first value that a draft has left open, what it is, and how many there are."""
    (place, what), *more = [*_unfilled(content, "")] or [("", "")]
    if place:
        others = f"; {len(more)} more lines begin with {FILL_IN}" if more else ""
        raise BadProfile(f"{place}: must be filled in: {what.removeprefix(FILL_IN).strip()}{others}")


def _unfilled(value: object, place: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, str) and value.startswith(FILL_IN):
        yield place, value
    elif isinstance(value, Mapping):
        for key, each in cast("Mapping[object, object]", value).items():
            yield from _unfilled(each, f"{place}.{key}".lstrip("."))
    elif isinstance(value, list):
        for number, each in enumerate(cast("list[object]", value)):
            yield from _unfilled(each, f"{place}.{number}")


def require_different(axes: Sequence[AxisProfile], what: str, addresses: Sequence[int]) -> None:
    """Raises ValueError unless every axis has its own joint and address; `what` names the addresses."""
    joints = [axis.joint for axis in axes]
    if len(set(joints)) < len(joints) or len(set(addresses)) < len(addresses):
        raise ValueError(f"joints {joints} and {what} {list(addresses)} must each be different")


def require_near(axes: Sequence[AxisProfile], limits: TravelLimits, silence: float, key: str) -> None:
    """Raises ValueError if an axis would travel too far after `silence` s (`key` in the file) without its host."""
    for number, axis in enumerate(axes):
        unit, travel = axis.unit, axis.travel_without_host(silence)
        limit = limits.rad if unit == "rad" else limits.m
        if travel > limit:
            raise ValueError(
                f"axes.{number}: {axis.joint} would travel {travel:.4g} {unit} after the loss of its host "
                f"(velocity_limit {axis.velocity_limit:g} {unit}/s for {key} {silence:g} s, then "
                f"quick_stop_deceleration {axis.quick_stop_deceleration:g} {unit}/s^2), limit {limit:g} {unit}: "
                f"lower speed or time, or set travel_limits.{unit} to what is free around it"
            )


def existing_file(key: str, path: Path) -> Path:
    """`path`, which a profile names under `key`. Raises BadProfile if there is no such file."""
    if not path.is_file():
        raise BadProfile(f"{key}: no file {path}")
    return path
