"""Interface of a fieldbus for one axis. Every method is a short blocking exchange on the machine's thread.

Quantities are SI on the joint side; bus units are used only inside the device. Any method raises
CommunicationLost if the drive does not answer and WrongConfiguration if it refuses.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from drivers.cia402.profile import AxisProfile
from drivers.ports import AxisIdentity, NoiseCommand, SampleBlock, SweepCommand


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
class Motion:
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


class Mode(IntEnum):
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
        ...

    def soften(self, softening: float) -> None:
        """Set the gain to commissioned gain * `softening` and the reset time to commissioned time / `softening`, with
        read-back.
        """
        ...

    def restore_control(self) -> None:
        """Set the commissioned gain and reset time, with read-back."""
        ...


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
        ...

    def forbid_motion(self) -> None:
        """Undo `allow_motion`."""
        ...

    def statusword(self) -> int: ...

    def control(self, controlword: int) -> None: ...

    def set_mode(self, mode: Mode) -> None:
        """Returns when the drive reports the mode."""
        ...

    def check_alive(self) -> None:
        """Raises CommunicationLost if the drive was silent for longer than the profile allows."""
        ...

    def look_for_restart(self) -> None:
        """Check for a restart if the fieldbus does not report it; `announced_error` then reports it.
        CommunicationLost.
        """
        ...

    def announced_error(self) -> int | None:
        """Code of an error that the drive announced (EMCY, restart) and has not cleared; None if there is none."""
        ...

    def forget_error(self) -> None:
        """A person has acknowledged the error; a drive that restarted is configured again."""
        ...

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
        ...

    def stop_unheard(self) -> None:
        """Strongest stop that needs no answer, for a drive that does not answer but may still receive."""
        ...

    # -- motion

    def motion(self) -> Motion: ...

    def read_back(self) -> None:
        """Raises WrongConfiguration if a session setting has changed, e.g. by another host."""
        ...

    def settle_limits(self, velocity: float, effort: float, window: tuple[float, float]) -> None:
        """Write the limits of a motion, rad/s (m/s), N m (N) and rad (m), to the drive, if it has objects for them."""
        ...

    def hold_target(self) -> None:
        """Set the target of the next move to the actual position."""
        ...

    def set_target(self, position: float, velocity: float) -> None:
        """Set target and speed of the next move, with read-back."""
        ...

    # -- measuring function

    @property
    def injector(self) -> Injector | None:
        """None if the drive cannot inject torque noise; known after `configure`."""
        ...

    def prepare_measuring(self, command: SweepCommand) -> None:
        """Write the parameters of the sweep, with read-back."""
        ...

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
