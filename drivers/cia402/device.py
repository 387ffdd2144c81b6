"""Interface of a fieldbus for one axis. Every method is a short blocking exchange on the machine's thread.

Quantities are SI on the joint side; bus units are used only inside the device. Any method raises
CommunicationLost if the drive does not answer and WrongConfiguration if it refuses.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

import numpy as np

from drivers.cia402.profile import AxisProfile, Gear, IdentityProfile
from drivers.errors import CommunicationLost, WrongConfiguration, WrongIdentity
from drivers.ports import Array, AxisIdentity, NoiseCommand, SampleBlock, SweepCommand


@dataclass(frozen=True, slots=True)
class Abilities:
    """Functions of one drive, determined while it is configured."""

    measures: bool  # a measuring function
    injects: bool  # torque noise
    streams: bool  # set-points every cycle
    velocity_limit: bool
    effort_limit: bool
    position_limits: bool
    host_watchdog: bool
    set_point: str = "none"  # object that receives the set-points of a streamed sweep


@dataclass(frozen=True, slots=True)
class Feedback:
    """Actual values at one instant: rad (m), rad/s (m/s), N m (N)."""

    position: float
    velocity: float
    effort: float


class MeasuringState(IntEnum):
    """State of the measuring function (docs/reference/virtual-drive.md, 2100h:02)."""

    IDLE = 0
    RUNNING = 1
    DONE = 2
    ABORTED = 3
    REJECTED = 4


class MeasuringCommand(IntEnum):
    """Commands to the measuring function (2100h:01)."""

    NONE = 0
    START = 1
    ABORT = 2


class OperationMode(IntEnum):
    """Modes of operation, 6060h."""

    PROFILE_POSITION = 1
    PROFILE_VELOCITY = 3
    INTERPOLATED_POSITION = 7
    CYCLIC_POSITION = 8
    CYCLIC_VELOCITY = 9


class Injector(Protocol):
    """Torque noise of the measuring function, and the softened speed control during it."""

    def prepare_noise(self, command: NoiseCommand) -> None:
        """Write the parameters of the run, with read-back. `Device.start_measuring` starts it."""

    def soften(self, softening: float) -> None:
        """Multiply the commissioned gain by `softening` and divide the reset time by it, with read-back."""

    def restore_control(self) -> None:
        """Set the commissioned gain and reset time, with read-back."""


class Device(Protocol):
    """One drive behind its fieldbus. It makes no decisions and stores only what was read at connect."""

    @property
    def profile(self) -> AxisProfile: ...

    @property
    def place(self) -> str:
        """Name for messages, e.g. "joint_1 (node 1)"."""
        ...

    # -- at connect

    def identify(self) -> AxisIdentity:
        """Raises WrongIdentity if the device is not the one of the profile."""
        ...

    def configure(self) -> Abilities:
        """Write session settings and limits of the profile, with read-back, on a disabled drive."""
        ...

    # -- power

    def allow_motion(self) -> None:
        """Let the drive accept process data and motion commands (CANopen: NMT start)."""

    def forbid_motion(self) -> None:
        """Undo `allow_motion`."""

    def statusword(self) -> int: ...

    def control(self, controlword: int) -> None: ...

    def set_mode(self, mode: OperationMode) -> None:
        """Returns when the drive reports the mode."""

    def check_alive(self) -> None:
        """Raises CommunicationLost if the drive was silent for longer than the profile allows."""

    def look_for_restart(self) -> None:
        """Check for a restart that the fieldbus does not report, for `announced_error`. CommunicationLost."""

    def announced_error(self) -> int | None:
        """Code of an error that the drive announced (EMCY, restart) and has not cleared; None if there is none."""
        ...

    def forget_error(self) -> None:
        """A person has acknowledged the error; a drive that restarted is configured again."""

    def error_code(self) -> int:
        """603Fh; 0 if there is no error."""
        ...

    def error_text(self, code: int) -> str:
        """Description of an error, with the details that the drive gives."""
        ...

    @property
    def emergency_stop_codes(self) -> tuple[int, ...]: ...

    def reopen(self) -> None:
        """Restore communication with a drive that an unanswered stop had cut off (CANopen: NMT stop)."""

    def stop_unheard(self) -> None:
        """Strongest stop that needs no answer, for a drive that does not answer but may still receive."""

    # -- motion

    def motion(self) -> Feedback: ...

    def read_back(self) -> None:
        """Raises WrongConfiguration if a session setting has changed, e.g. by another host."""

    def settle_limits(self, velocity: float, effort: float, window: tuple[float, float]) -> None:
        """Write the limits of a motion, rad/s (m/s), N m (N) and rad (m), to the drive, if it has objects for them."""

    def hold_target(self) -> None:
        """Set the target of the next move to the actual position."""

    def set_target(self, position: float, velocity: float) -> None:
        """Set target and speed of the next move, with read-back."""

    # -- measuring function

    @property
    def injector(self) -> Injector | None:
        """None if the drive cannot inject torque noise; known after `configure`."""
        ...

    def prepare_measuring(self, command: SweepCommand) -> None:
        """Write the parameters of the sweep, with read-back."""

    def start_measuring(self) -> None: ...

    def abort_measuring(self) -> None: ...

    def measuring_state(self) -> MeasuringState: ...

    def rejection(self) -> str:
        """Reason why the last start was rejected."""
        ...

    def samples_recorded(self) -> int: ...

    def page(self, first: int, count: int) -> SampleBlock:
        """Samples `first` to `first + count`. Raises CommunicationLost if the drive returns others."""
        ...

    @property
    def page_size(self) -> int:
        """Largest number of samples of a page that does not delay a stop too long."""
        ...


# -- what every fieldbus does alike ------------------------------------------------------------------------------------


def require_identity(place: str, found: Sequence[int], expected: IdentityProfile) -> None:
    """Raises WrongIdentity unless vendor, product, revision and serial are those of the profile."""
    wanted = (expected.vendor, expected.product, expected.revision, expected.serial)
    for name, have, want in zip(("vendor", "product", "revision", "serial"), found, wanted, strict=True):
        if want is not None and have != want:
            raise WrongIdentity(place, f"{name} is {have:08X}h, the profile says {want:08X}h")


def require_rated_torque(place: str, torque: float, wanted: float) -> None:
    """Raises WrongIdentity unless the rated torque of the motor, N m, is that of the profile."""
    if not math.isclose(torque, wanted, rel_tol=2e-3):
        raise WrongIdentity(place, f"rated torque of the motor is {torque:.4g} N m, the profile says {wanted:.4g} N m")


def await_mode(place: str, mode: OperationMode, shown: Callable[[], int], within: float = 2.0) -> None:
    """Returns when the drive reports the mode; WrongConfiguration if it does not within `within` s."""
    deadline = time.monotonic() + within
    while (found := shown()) != mode:
        if time.monotonic() > deadline:
            raise WrongConfiguration(place, f"mode {mode} was not accepted, the drive reports mode {found}")
        time.sleep(0.002)


def rejection_text(reason: int) -> str:
    """Why the measuring function rejected a start."""
    known = {
        1: "axis not enabled, or not at standstill",
        2: "speed",
        3: "position window",
        4: "parameters",
        5: "torque",
    }
    return known.get(reason, f"reason {reason}")


def trace_cycle(command: SweepCommand | NoiseCommand) -> int:
    """Trace cycle in ms, as close to the requested sample rate as the drive supports."""
    return max(1, round(1e3 / command.sample_rate))


def trace_block(
    axis: AxisProfile, gear: Gear, place: str, first: int, columns: Mapping[str, Array], cycle_ms: int
) -> SampleBlock:
    """The samples of a trace page from its columns on the motor side, each (n,): cycle, torque, set_speed, speed,
    position, and if there are any load_position (NaN: no encoder) and injected.

    Raises CommunicationLost if they are not those from `first` on, or no numbers; WrongConfiguration if they lack the
    direct encoder of the profile.
    """
    index = columns["cycle"].astype(np.int64)
    if not np.array_equal(index, np.arange(first, first + len(index))):
        raise CommunicationLost(place, f"trace page from {first} holds other samples")
    if not all(np.isfinite(values).all() for name, values in columns.items() if name != "load_position"):
        raise CommunicationLost(place, f"trace page from {first} holds no numbers")
    load = columns.get("load_position")
    if axis.load_encoder and (load is None or np.isnan(load).any()):
        raise WrongConfiguration(place, "the profile says load_encoder, the trace holds none")
    return SampleBlock(
        joint=axis.joint,
        index=index,
        time=index.astype(float) * (cycle_ms * 1e-3),
        effort=gear.motor_effort(columns["torque"]),
        velocity=gear.motor_velocity(columns["speed"]),
        position=gear.motor_position(columns["position"]),
        velocity_setpoint=gear.motor_velocity(columns["set_speed"]),
        load_position=load * (axis.load_encoder_direction * 2 * np.pi)
        if axis.load_encoder and load is not None
        else None,
        excitation_effort=gear.motor_effort(columns["injected"]) if "injected" in columns else None,
    )
