"""What a person knows of a drive before the bus is opened, whatever the fieldbus."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal, TypeVar, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from drivers.errors import BadProfile
from drivers.ports import ChannelTiming


class Frozen(BaseModel):
    """A part of a profile: nothing misspelt, nothing changed later, no NaN."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class StopOptions(Frozen):
    """CiA 402 option codes 605Ah-605Eh and 6007h; makers differ, so they stand in the profile."""

    quick_stop: int = 2  # 605Ah: quick stop ramp, then switch on disabled
    shutdown: int = 0  # 605Bh: disable the drive function
    disable_operation: int = 1  # 605Ch: slow down, then disable
    halt: int = 1  # 605Dh: slow down, stay enabled
    fault_reaction: int = 2  # 605Eh: quick stop ramp
    connection_loss: int = 3  # 6007h: quick stop


class IdentityProfile(Frozen):
    """What the device must say of itself; `serial` tells two drives of one type apart, e.g. after swapped addresses."""

    vendor: int
    product: int
    revision: int
    serial: int | None = None


class ChannelProfile(Frozen):
    """Lags of the drive's channels behind the encoder's position, s (`drivers.ports.ChannelTiming`)."""

    effort_delay: float = Field(default=0.0, ge=-0.02, le=0.02)
    effort_smoothing: float = Field(default=0.0, ge=0.0, le=0.02)
    velocity_delay: float = Field(default=0.0, ge=-0.02, le=0.02)
    velocity_smoothing: float = Field(default=0.0, ge=0.0, le=0.02)

    @property
    def timing(self) -> ChannelTiming:
        return ChannelTiming(**self.model_dump())


class AxisProfile(Frozen):
    """One axis. Joint side in rad or m as `unit` says; `rated_torque` is the motor's, N m."""

    joint: str = Field(min_length=1)
    identity: IdentityProfile
    unit: Literal["rad", "m"] = "rad"
    gear_ratio: float  # motor revolutions per joint revolution; prismatic: motor rad per m; signed
    rated_torque: float = Field(gt=0)  # checked against what the drive says
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

    @model_validator(mode="after")
    def _consistent(self) -> "AxisProfile":
        if self.gear_ratio == 0:
            raise ValueError("gear_ratio must not be 0")
        if self.load_encoder and self.unit == "m":
            raise ValueError("load_encoder: the trace gives it in revolutions, which a linear axis does not make")
        low, high = self.position_limits
        if low >= high:
            raise ValueError(f"position_limits: {low} is not below {high}")
        return self

    @property
    def effort_unit(self) -> str:
        return "N m" if self.unit == "rad" else "N"


Parsed = TypeVar("Parsed", bound=BaseModel)


FILL_IN = "FILL IN"
"""How a value begins that a draft has left to a person."""


def parse(kind: type[Parsed], content: Mapping[str, object]) -> Parsed:
    """`content` as a checked `kind`; BadProfile names the first wrong place, the reason and what was given."""
    refuse_unfilled(content)
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "profile"
        given = "" if isinstance(first["input"], Mapping) else f" (given: {first['input']!r})"
        raise BadProfile(f"{place}: {first['msg']}{given}") from None


def refuse_unfilled(content: Mapping[str, object]) -> None:
    """BadProfile names the first value that a draft has left open, what it is, and how many there are."""
    (place, what), *more = [*_unfilled(content, "")] or [("", "")]
    if place:
        others = f"; {len(more)} more lines begin with {FILL_IN}" if more else ""
        raise BadProfile(f"{place}: is to be filled in: {what.removeprefix(FILL_IN).strip()}{others}")


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
    """ValueError unless every axis has a joint and an address of its own; `what` names the addresses."""
    joints = [axis.joint for axis in axes]
    if len(set(joints)) < len(joints) or len(set(addresses)) < len(addresses):
        raise ValueError(f"joints {joints} and {what} {list(addresses)} must each be different")


def existing_file(key: str, path: Path) -> Path:
    """`path`, which a profile names under `key`; BadProfile if no such file is there."""
    if not path.is_file():
        raise BadProfile(f"{key}: no file {path}")
    return path
