"""The one interface behind which every drive stands: SI units, joint side, names of joints.

A `DrivePort` is one machine: all the axes that one connection reaches. An adapter is registered by entry point
(group ``sweepid.drives``) as ``factory(profile: Mapping[str, object], base: Path) -> DrivePort``, files named in the
profile being relative to `base`; `drivers.registry` loads it.

Rules that every adapter keeps (`drivers.contract` tests them):

- Nothing energises an axis but `enable`. A fault is cleared by `acknowledge` alone, and that never energises.
- Leaving `run_sweep` or `run_noise` early, for whatever reason (error, ``aclose``, cancellation), stops the axis.
- `stop` may be called at any time, from any task, and twice.
- After a gap of the host's time, beside another host, or with an axis that gained or lost its energy by nobody here,
  nothing is energised or moved until `allow`.
- Whatever a drive cannot enforce itself is enforced here before the command is sent (`Capabilities`).
"""

from collections.abc import AsyncGenerator, Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class SweepMode(Enum):
    """Who generates the motion of a sweep."""

    DRIVE_SIDE = "drive_side"
    """The drive's measuring function: parameters in, samples of the drive's own clock out."""
    HOST_STREAMED = "host_streamed"
    """The host sends a velocity set-point every cycle (CiA 402 cyclic synchronous velocity)."""


class AxisState(Enum):
    """What an operator needs to know of an axis."""

    UNKNOWN = "unknown"  # no word from the drive
    DISABLED = "disabled"  # no torque, brake closed
    ENABLED = "enabled"  # in closed loop, at standstill unless commanded
    STOPPING = "stopping"  # quick stop or fault reaction under way
    FAULT = "fault"  # waits for a person's acknowledgement


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What the machine behind a port really can do. Told honestly: what is False is done by the host or refused."""

    sweep_modes: frozenset[SweepMode]
    load_encoder: bool  # `load_position` comes with the samples of drive-side sweeps
    velocity_limit_in_drive: bool
    effort_limit_in_drive: bool
    position_limits_in_drive: bool
    host_watchdog_in_drive: bool  # the drive stops by itself when the host falls silent
    set_point_timing: str  # "thread", "bcm" (the kernel's), "none"
    simultaneous_axes: int  # that one `run_sweep` may move at once
    torque_injection: bool = False  # `run_noise`: the drive's own torque noise, with its speed control softened
    hears_other_hosts: bool = False  # False: a second host shows only by what it does to the axes
    set_points: str = (
        "none"  # what takes streamed set-points: "cyclic_velocity (60FFh)", "interpolated_position (60C1h)"
    )


@dataclass(frozen=True, slots=True)
class ChannelTiming:
    """By how much the drive's channels lag behind the encoder's position, s; measured as in how-to/calibrate-channels.

    A port delivers samples as the drive gives them; who makes a recording of them puts the channels right.
    """

    effort_delay: float = 0.0
    effort_smoothing: float = 0.0  # time constant of a first-order low-pass (torque-current smoothing)
    velocity_delay: float = 0.0
    velocity_smoothing: float = 0.0


@dataclass(frozen=True, slots=True)
class SetPointTiming:
    """How punctual the set-points of one host-streamed sweep were; s.

    A thread is never early. The kernel can be: it is steered so that the mean keeps to the grid, and makes up for a
    late stretch by an early one.
    """

    source: str  # "thread" or "bcm"
    cycles: int
    missed: int  # deadlines that passed before the set-point could be sent
    median_lateness: float  # negative: early
    worst_lateness: float


@dataclass(frozen=True, slots=True)
class AxisIdentity:
    """What the device says of itself; shown to the operator and stored with every recording."""

    joint: str
    address: str  # e.g. "node 1"
    vendor: int
    product: int
    revision: int
    serial: int
    dictionary_sha256: str  # of the EDS or register profile in use


@dataclass(frozen=True, slots=True)
class AxisStatus:
    """One reading of an axis. Position rad (m), velocity rad/s (m/s), effort N m (N)."""

    joint: str
    state: AxisState
    position: float
    velocity: float
    effort: float
    fault: "Fault | None"


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault as the drive reports it."""

    joint: str
    code: int  # CiA 402 error code (603Fh) or the maker's
    text: str
    emergency_stop: bool = False


@dataclass(frozen=True, slots=True)
class Sine:
    """``amplitude * sin(2 pi frequency (t - t0) + phase)``; Hz, rad/s (m/s), rad; t0 = start of the window."""

    frequency: float
    amplitude: float
    phase: float


@dataclass(frozen=True, slots=True)
class SweepCommand:
    """One sweep of one axis from standstill to standstill.

    Velocity set-point: ``e(t) (offset_velocity + sum of sines)`` with the envelope e rising as a raised cosine over
    `ramp`, one during `settle` and the measured window of ``periods * period``, falling over another `ramp`.
    The measured window starts at ``t0 = ramp + settle``. The limits are those of the envelope check on the
    host; an adapter also puts them into the drive where the drive has them.
    """

    joint: str
    mode: SweepMode
    offset_velocity: float  # rad/s (m/s), signed
    sines: tuple[Sine, ...]
    period: float  # s
    periods: int
    ramp: float  # s
    settle: float  # s
    sample_rate: float  # Hz, wanted; the blocks' time column tells what was got
    velocity_limit: float  # rad/s (m/s), absolute
    effort_limit: float  # N m (N), absolute
    position_window: tuple[float, float]  # rad (m), absolute joint positions never to be left

    @property
    def measure_from(self) -> float:
        """Start of the measured window, s."""
        return self.ramp + self.settle

    @property
    def duration(self) -> float:
        """From standstill to standstill, s."""
        return 2 * self.ramp + self.settle + self.period * self.periods


@dataclass(frozen=True, slots=True)
class NoiseCommand:
    """Pseudo-random torque on top of a slow turn, from standstill to standstill; the drive makes and records it.

    Velocity set-point ``e(t) offset_velocity`` and injected torque ``e(t) sum_k a sin(2 pi f_k t + phi_k)`` with the
    envelope and times of `SweepCommand`. f_k is every multiple of 1/`period` in the band, a the same for all,
    phi_k random by `seed`. While it runs, the gain of the drive's speed control is multiplied and its reset time
    divided by `softening`; the drive's own values are restored whatever ends the run.
    """

    joint: str
    offset_velocity: float  # rad/s (m/s), signed
    effort: float  # N m (N), RMS of the injected torque
    lowest: float  # Hz
    highest: float  # Hz
    period: float  # s
    periods: int
    seed: int  # 32 bits
    softening: float  # above 0, at most 1
    ramp: float  # s
    settle: float  # s
    sample_rate: float  # Hz, wanted
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


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Consecutive samples of one sweep or noise run on the drive's clock; arrays of one length, joint side.

    `index` counts the drive's samples from the start of the sweep; a jump means that samples were lost. Blocks
    arrive in order; a block never overlaps the one before. `time` is index / rate of the drive's clock, s.
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
    """A connection of its own to the same bus that can say one thing: stop. Needs no port, no answer, no event loop.

    Blocking, for one thread at a time but `send` and `insist`, which may be called from any.
    """

    def open(self) -> None:
        """ConnectionFailed where that is not possible. May be called again."""
        ...

    def listen(self, within: float) -> None:
        """Take what comes for so many s; CommunicationLost once the connection is gone."""
        ...

    def send(self) -> Mapping[str, str]:
        """The stop for every axis onto the wire; by joint, why it may not have been reached ("": it is there).

        CommunicationLost, ConnectionFailed where nothing could be sent. The service may go on to talk to its drives.
        """
        ...

    def insist(self) -> None:
        """As `send`, and what makes the drives deaf to a host that goes on sending: where nobody takes over."""
        ...

    def close(self) -> None:
        """Safe to call twice."""
        ...


class DrivePort(Protocol):
    """One machine. Every method raises a `drivers.errors.DriveError`; times out by itself; is safe to cancel."""

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints this port reaches, in the profile's order."""
        ...

    @property
    def capabilities(self) -> Capabilities:
        """Known after `connect`."""
        ...

    @property
    def channel_timing(self) -> Mapping[str, ChannelTiming]:
        """By joint, from the profile; all zero where nothing was measured."""
        ...

    @property
    def set_point_timing(self) -> SetPointTiming | None:
        """Of the last host-streamed sweep; None if the last sweep was the drive's own."""
        ...

    async def connect(self) -> tuple[AxisIdentity, ...]:
        """Open the bus, check every node's identity, configure and read back. Leaves every axis disabled."""
        ...

    async def close(self) -> None:
        """Disable every axis and release the bus. Safe to call twice, and after any error."""
        ...

    async def status(self) -> Mapping[str, AxisStatus]:
        """The state of every axis by joint name."""
        ...

    async def enable(self, *joints: str) -> None:
        """Energise these axes at standstill; none is left enabled if one cannot be.

        Refused while a fault is pending or any other axis is enabled; SweepInterrupted if it is stopped meanwhile.
        """
        ...

    async def disable(self, joint: str) -> None:
        """Bring the axis to standstill and take its energy away."""
        ...

    async def move_to(self, joint: str, position: float, velocity: float) -> None:
        """Move one enabled axis to `position` rad (m) at most at `velocity`; returns at standstill there."""
        ...

    def run_sweep(self, *commands: SweepCommand) -> AsyncGenerator[SampleBlock, None]:
        """Run one sweep on an enabled axis, yielding samples as they come; ends at standstill.

        Several commands, one an axis and all host-streamed with the same times, move their axes at once on one clock;
        whatever ends one of them ends all.
        """
        ...

    def run_noise(self, command: NoiseCommand) -> AsyncGenerator[SampleBlock, None]:
        """Inject torque noise on one enabled axis: as a drive-side `run_sweep`, with `excitation_effort`.

        NotReady where `Capabilities.torque_injection` is False.
        """
        ...

    def watch(self, tell: Callable[[str], None] | None) -> None:
        """`tell` is given, from any thread and at once, why nothing is energised or moved any more until `allow`."""
        ...

    def allow(self) -> None:
        """A person looked at the machine. Nothing moves by this."""
        ...

    def halt(self) -> None:
        """Tell every axis to stop by what needs no answer, at once. From any thread; waits for nothing, never raises.

        Whether they do, `stop` finds out.
        """
        ...

    async def stop(self) -> tuple[str, ...]:
        """Stop every axis now: `halt`, then the stop sequence, axis by axis, to standstill without energy.

        Gives the joints that confirmed it: all of them, or none where it is not connected. Never raises for an axis
        already still; StopNotConfirmed names those that did not answer.
        """
        ...

    def stop_sender(self) -> "StopSender":
        """For a process beside this one. NotReady says why there cannot be one: a bus that has one owner."""
        ...

    async def faults(self) -> tuple[Fault, ...]:
        """Pending faults of all axes."""
        ...

    async def acknowledge(self, joint: str) -> None:
        """Clear the fault of one axis after a person looked. The axis stays disabled."""
        ...
