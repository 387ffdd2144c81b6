"""What a fieldbus must bring for each axis. Every method is a short blocking exchange on the machine's thread.

Quantities are SI on the joint side: the units of the wire stay inside the device. Any method raises
CommunicationLost when the drive does not answer and WrongConfiguration when it refuses.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from drivers.cia402.profile import AxisProfile
from drivers.ports import AxisIdentity, NoiseCommand, SampleBlock, SweepCommand


@dataclass(frozen=True, slots=True)
class Abilities:
    """What one drive has; learnt while it is configured."""

    measures: bool  # a measuring function
    injects: bool  # torque noise
    streams: bool  # set-points every cycle
    velocity_limit: bool
    effort_limit: bool
    position_limits: bool
    host_watchdog: bool
    set_point: str = "none"  # what takes the set-points of a streamed sweep


@dataclass(frozen=True, slots=True)
class Motion:
    """Actual values of one moment: rad (m), rad/s (m/s), N m (N)."""

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
    """Torque noise of the measuring function, and the softer speed control under it."""

    def prepare_noise(self, command: NoiseCommand) -> None:
        """The run's parameters, with read-back; `Device.start_measuring` starts it."""
        ...

    def soften(self, softening: float) -> None:
        """Commissioned gain times `softening`, commissioned reset time divided by it, with read-back."""
        ...

    def restore_control(self) -> None:
        """The commissioned gain and reset time, with read-back."""
        ...


class Device(Protocol):
    """One drive behind its fieldbus: no decisions, no state of its own but what was learnt at connect."""

    @property
    def profile(self) -> AxisProfile: ...

    @property
    def place(self) -> str:
        """For messages, e.g. "joint_1 (node 1)"."""
        ...

    # -- at connect

    def identify(self) -> AxisIdentity:
        """WrongIdentity where the device is not the one of the profile."""
        ...

    def configure(self) -> Abilities:
        """Session settings and limits of the profile, with read-back, on a disabled drive."""
        ...

    # -- power

    def allow_motion(self) -> None:
        """Let the drive take process data and commands of motion (CANopen: NMT start)."""
        ...

    def forbid_motion(self) -> None:
        """Take that back."""
        ...

    def statusword(self) -> int: ...

    def control(self, controlword: int) -> None: ...

    def set_mode(self, mode: Mode) -> None:
        """Returns when the drive shows the mode."""
        ...

    def check_alive(self) -> None:
        """CommunicationLost if the drive was not heard for longer than the profile allows."""
        ...

    def look_for_restart(self) -> None:
        """Asks for it where nothing tells it by itself: `announced_error` then says so. CommunicationLost."""
        ...

    def announced_error(self) -> int | None:
        """Code of a trouble that the drive told by itself (EMCY, restart) and has not withdrawn; None if none."""
        ...

    def forget_error(self) -> None:
        """A person has seen it; a drive that restarted gets its settings again."""
        ...

    def error_code(self) -> int:
        """603Fh, 0 if there is none."""
        ...

    def error_text(self, code: int) -> str:
        """What the drive has to say about an error."""
        ...

    @property
    def emergency_stop_codes(self) -> tuple[int, ...]: ...

    def reopen(self) -> None:
        """Let a drive answer again that a stop without an answer has made deaf (CANopen: NMT stop)."""
        ...

    def stop_unheard(self) -> None:
        """For a drive that does not answer but may listen: the strongest stop that needs no answer."""
        ...

    # -- motion

    def motion(self) -> Motion: ...

    def read_back(self) -> None:
        """WrongConfiguration if a session setting is not held any more: somebody else may have changed it."""
        ...

    def settle_limits(self, velocity: float, effort: float, window: tuple[float, float]) -> None:
        """A motion's limits into the drive, as far as it has them."""
        ...

    def hold_target(self) -> None:
        """Target of the next move := where the axis is."""
        ...

    def set_target(self, position: float, velocity: float) -> None:
        """Target and speed of the next move, with read-back."""
        ...

    # -- measuring function

    @property
    def injector(self) -> Injector | None:
        """None where the drive injects no torque; known after `configure`."""
        ...

    def prepare_measuring(self, command: SweepCommand) -> None:
        """The sweep's parameters, with read-back."""
        ...

    def start_measuring(self) -> None: ...

    def abort_measuring(self) -> None: ...

    def measuring_state(self) -> MeasuringState: ...

    def rejection(self) -> str:
        """Why the last start was rejected."""
        ...

    def samples_recorded(self) -> int: ...

    def page(self, first: int, count: int) -> SampleBlock:
        """Samples `first` to `first + count`; CommunicationLost if the drive gives others."""
        ...

    @property
    def page_size(self) -> int:
        """Samples of the largest page that leaves room for a stop in between."""
        ...
