"""The common interface of all drives: SI units, joint side, names of joints.

A `DrivePort` is one machine: all axes that one connection reaches. An adapter is registered by entry point
(group ``sweepid.drives``) as ``factory(profile: Mapping[str, object], base: Path) -> DrivePort``. File names in the
profile are relative to `base`. `drivers.registry` loads the adapter.

Rules for every adapter (tested by `drivers.contract`):

- Only `enable` energises an axis. Only `acknowledge` clears a fault, and it never energises an axis.
- Leaving `run_sweep` or `run_noise` early, for any reason (error, ``aclose``, cancellation), stops the axis.
- `stop` may be called at any time, from any task, and more than once.
- After a suspension of the host, with a second host on the bus, or after an axis was energised or de-energised by
  something else, nothing is energised or moved until `allow` is called.
- Limits that a drive cannot enforce itself are enforced here before the command is sent (`Capabilities`).
"""

from collections.abc import AsyncGenerator, Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from drivers.errors import Cause

Array = NDArray[np.float64]


class SweepMode(Enum):
    """Which side generates the motion of a sweep."""

    DRIVE_SIDE = "drive_side"
    """The drive's measuring function: it takes parameters and returns samples on the drive's own clock."""
    HOST_STREAMED = "host_streamed"
    """The host sends a velocity set-point every cycle (CiA 402 cyclic synchronous velocity)."""


class AxisState(Enum):
    """State of an axis as an operator needs it."""

    UNKNOWN = "unknown"  # the drive does not answer
    DISABLED = "disabled"  # no torque, brake closed
    ENABLED = "enabled"  # in closed loop, at standstill unless commanded
    STOPPING = "stopping"  # quick stop or fault reaction under way
    FAULT = "fault"  # until a person acknowledges it


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What the machine behind a port supports. False means that the host does it instead, or that it is refused."""

    sweep_modes: frozenset[SweepMode]
    load_encoder: bool  # `load_position` comes with the samples of drive-side sweeps
    velocity_limit_in_drive: bool
    effort_limit_in_drive: bool
    position_limits_in_drive: bool
    host_watchdog_in_drive: bool  # the drive stops by itself when the host is silent
    set_point_timing: str  # "thread" (host), "bcm" (kernel), "none"
    simultaneous_axes: int  # maximum number of axes of one `run_sweep`
    torque_injection: bool = False  # `run_noise`: the drive's own torque noise, with its speed control softened
    hears_other_hosts: bool = False  # False: a second host is detected only by its effect on the axes
    set_points: str = (
        "none"  # object that receives streamed set-points: "cyclic_velocity (60FFh)", "interpolated_position (60C1h)"
    )
    bus_bitrate: int | None = None  # bit/s; None: unknown, or not applicable to the fieldbus
    bus_load: tuple[float, ...] = ()  # largest share used by a streamed sweep of 1, 2, ... axes


@dataclass(frozen=True, slots=True)
class ChannelTiming:
    """Delays of the drive's channels relative to the encoder position, s; measured as in how-to/calibrate-channels.

    A port delivers the samples as the drive reports them. The code that makes a recording of them corrects the
    channels.
    """

    effort_delay: float = 0.0
    effort_smoothing: float = 0.0  # time constant of a first-order low-pass (torque-current smoothing)
    velocity_delay: float = 0.0
    velocity_smoothing: float = 0.0


@dataclass(frozen=True, slots=True)
class SetPointTiming:
    """Punctuality of the set-points of one host-streamed sweep; s.

    A thread is never early. The kernel can be early: it is controlled so that the mean stays on the grid, and it
    compensates late cycles by early ones.
    """

    source: str  # "thread" or "bcm"
    cycles: int
    missed: int  # deadlines that passed before the set-point could be sent
    median_lateness: float  # negative: early
    worst_lateness: float


@dataclass(frozen=True, slots=True)
class BusTraffic:
    """Frames on an open bus so far. `bits`: of all, without stuff bits. `bitrate` in bit/s, None if unknown."""

    received: int
    sent: int
    bits: int
    bitrate: int | None


@runtime_checkable
class ReportsTraffic(Protocol):
    """A port or connection that counts frames. Optional for a port."""

    @property
    def bus_traffic(self) -> BusTraffic | None:
        """The counts, or None while not connected."""
        ...


@dataclass(frozen=True, slots=True)
class AxisIdentity:
    """Identity that the device reports; shown to the operator and stored with every recording."""

    joint: str
    address: str  # e.g. "node 1"
    vendor: int
    product: int
    revision: int
    serial: int
    dictionary_sha256: str  # of the EDS or register profile in use


@dataclass(frozen=True, slots=True)
class AxisStatus:
    """One reading of an axis. Position rad (m), velocity rad/s (m/s), effort N m (N).

    `stands` and `energised` are what the drive reports; an adapter that does not tell them reports no standstill.
    """

    joint: str
    state: AxisState
    position: float
    velocity: float
    effort: float
    fault: "Fault | None"
    stands: bool = False  # its velocity is at most the standstill velocity of the profile
    energised: bool = True  # False only if the drive reports a state without energy


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault as reported by the drive."""

    joint: str
    code: int  # CiA 402 error code (603Fh) or manufacturer's code
    text: str
    emergency_stop: bool = False


@dataclass(frozen=True, slots=True)
class SineCommand:
    """``amplitude * sin(2 pi frequency (t - t0) + phase)``; Hz, rad/s (m/s), rad; t0 = start of the window."""

    frequency: float
    amplitude: float
    phase: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ExcitationCommand:
    """One run of one axis from standstill to standstill.

    The envelope e rises as a raised cosine over `ramp`, is one during `settle` and the measured window of
    ``periods * period``, and falls over another `ramp`. The measured window starts at ``t0 = ramp + settle``. The
    limits are those of the envelope check on the host; an adapter also writes them to the drive if the drive has
    objects for them.
    """

    joint: str
    offset_velocity: float  # rad/s (m/s), signed
    period: float  # s
    periods: int
    ramp: float  # s
    settle: float  # s
    sample_rate: float  # Hz, requested; the time column of the blocks has the actual rate
    velocity_limit: float  # rad/s (m/s), absolute
    effort_limit: float  # N m (N), absolute; of control and injection together
    position_window: tuple[float, float]  # rad (m), absolute joint positions never to be left

    @property
    def measure_from(self) -> float:
        """Start of the measured window, s."""
        return self.ramp + self.settle

    @property
    def duration(self) -> float:
        """From standstill to standstill, s."""
        return 2 * self.ramp + self.settle + self.period * self.periods


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepCommand(ExcitationCommand):
    """One sweep: velocity set-point ``e(t) (offset_velocity + sum of sines)``."""

    mode: SweepMode
    sines: tuple[SineCommand, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class NoiseCommand(ExcitationCommand):
    """Pseudo-random torque during a slow motion; generated and recorded by the drive.

    Velocity set-point ``e(t) offset_velocity`` and injected torque ``e(t) sum_k a sin(2 pi f_k t + phi_k)``. f_k are
    all multiples of 1/`period` in the band, a is equal for all lines, phi_k is random by `seed`. During the run the
    gain of the drive's speed control is multiplied, and its reset time divided, by `softening`. The commissioned values
    are restored however the run ends.
    """

    effort: float  # N m (N), RMS of the injected torque
    lowest: float  # Hz
    highest: float  # Hz
    seed: int  # 32 bits
    softening: float  # above 0, at most 1


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Consecutive samples of one sweep or noise run on the drive's clock; arrays of equal length, joint side.

    `index` counts the drive's samples from the start of the sweep; a jump means lost samples. Blocks arrive in order
    and do not overlap. `time` is index / sample rate on the drive's clock, s.
    """

    joint: str
    index: NDArray[np.int64]
    time: Array
    effort: Array
    velocity: Array
    position: Array
    velocity_setpoint: Array
    load_position: Array | None = None
    excitation_effort: Array | None = None  # N m (N), the injected part of `effort`; None where nothing is injected


class StopSender(Protocol):
    """An independent connection to the same bus that can only stop. Needs no port, no answer and no event loop.

    Blocking. For one thread at a time, except `send`, `confirm` and `insist`, which may be called from any thread.
    """

    def open(self) -> None:
        """Open the connection; may be called again. Raises ConnectionFailed if that is not possible."""

    def listen(self, within: float) -> None:
        """Receive for `within` s. Raises CommunicationLost if the connection is lost."""

    def send(self) -> Mapping[str, str]:
        """Send the stop for every axis. Returns by joint why it may not have arrived ("": it arrived).

        Raises CommunicationLost or ConnectionFailed if nothing could be sent. The service may continue to use its
        drives.
        """
        ...

    def confirm(self, within: float) -> Mapping[str, str]:
        """After `send`: wait until every axis reports standstill without energy, at most `within` s. By joint, why that
        is not confirmed ("": it reports it). Sends nothing that moves or energises. From any thread.
        """
        ...

    def insist(self) -> None:
        """As `send`, and make the drives ignore a host that continues to send; used if no service takes over."""

    def close(self) -> None:
        """Close the connection. May be called twice."""


class DrivePort(Protocol):
    """One machine. Every method raises a `drivers.errors.DriveError`, has its own time-out and is safe to cancel."""

    @property
    def joints(self) -> tuple[str, ...]:
        """Joints of this port, in the order of the profile."""
        ...

    @property
    def capabilities(self) -> Capabilities:
        """Available after `connect`."""
        ...

    @property
    def channel_timing(self) -> Mapping[str, ChannelTiming]:
        """Delays by joint, from the profile; zero if they were not measured."""
        ...

    @property
    def set_point_timing(self) -> SetPointTiming | None:
        """Punctuality of the last host-streamed sweep; None if the drive generated the last sweep."""
        ...

    async def connect(self) -> tuple[AxisIdentity, ...]:
        """Open the bus, check the identity of every node, configure it and read back. Leaves every axis disabled."""
        ...

    async def close(self) -> None:
        """Disable every axis and release the bus. May be called twice, and after any error."""

    async def status(self) -> Mapping[str, AxisStatus]:
        """The state of every axis by joint name."""
        ...

    async def enable(self, *joints: str) -> None:
        """Energise these axes at standstill. If one axis cannot be enabled, all of them are left disabled.

        Refused while a fault is pending or any other axis is enabled. Raises SweepInterrupted if stopped meanwhile.
        """

    async def disable(self, joint: str) -> None:
        """Bring the axis to standstill and de-energise it."""

    async def move_to(self, joint: str, position: float, velocity: float) -> None:
        """Move one enabled axis to `position`, rad (m), at most at `velocity`, rad/s (m/s); returns at standstill."""

    def run_sweep(self, *commands: SweepCommand) -> AsyncGenerator[SampleBlock, None]:
        """Run one sweep on an enabled axis and yield samples as they arrive; ends at standstill.

        Several commands (one per axis, all host-streamed with the same times) move their axes together on one clock.
        If one of them ends early, all end.
        """
        ...

    def run_noise(self, command: NoiseCommand) -> AsyncGenerator[SampleBlock, None]:
        """Inject torque noise on one enabled axis: as a drive-side `run_sweep`, with `excitation_effort`.

        Raises NotReady if `Capabilities.torque_injection` is False.
        """
        ...

    def watch(self, tell: Callable[[Cause], None] | None) -> None:
        """`tell` receives at once, from any thread, the reason why nothing is energised or moved until `allow`.

        From now on the host is watched, connected or not, and a finding outlives the connection; None: until `close`.
        """

    def allow(self) -> None:
        """A person has checked the machine. This call causes no motion."""

    def halt(self) -> None:
        """Send every axis a stop that needs no answer, at once. From any thread; does not wait and never raises.

        `stop` then confirms whether the axes stopped.
        """

    async def stop(self) -> tuple[str, ...]:
        """Stop every axis now: `halt`, then the stop sequence, axis by axis, to standstill without energy.

        Returns the joints that confirmed it: all of them, or none if the port is not connected. Does not raise for
        an axis that already stands. StopNotConfirmed names the axes that did not answer.
        """
        ...

    def stop_sender(self) -> "StopSender":
        """For a separate process. Raises NotReady if there cannot be one, for example on a bus with a single owner."""
        ...

    async def faults(self) -> tuple[Fault, ...]:
        """Pending faults of all axes."""
        ...

    async def acknowledge(self, joint: str) -> None:
        """Clear the fault of one axis after a person has checked it. The axis stays disabled."""
