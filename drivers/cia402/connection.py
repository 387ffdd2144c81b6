"""What a fieldbus brings for a whole machine: an open connection with its axes, and the streamed sweeps it can do."""

import threading
from collections.abc import AsyncGenerator, Iterable, Mapping, Sequence
from typing import Protocol

from drivers.cia402.axis import Axis
from drivers.cia402.checks import Envelope
from drivers.cia402.host_watch import HostWatch
from drivers.cia402.thread import DriveThread
from drivers.ports import AxisIdentity, Capabilities, SampleBlock, SetPointTiming, StopSender, SweepCommand, SweepMode


class Run(Protocol):
    """A sweep under way."""

    def blocks(self) -> AsyncGenerator[SampleBlock, None]:
        """The samples as they come, to the sweep's end at standstill; raises what ended it early."""
        ...

    @property
    def streams(self) -> bool:
        """Whether it sends set-points, and with them what makes the drives take their words over."""
        ...

    def halt(self) -> None:
        """Go on by the quick stop, whatever is under way. From any thread."""
        ...

    async def interrupted(self) -> None:
        """After the stop event was set: until the stop sequence may talk to the drives."""
        ...

    async def over(self) -> None:
        """Until nothing of it runs any more, however it ended: that is the consumer's matter."""
        ...

    def timing(self) -> SetPointTiming | None:
        """How punctual the host's set-points are; None if the drive makes them."""
        ...


class Connection(Protocol):
    """An open bus with every axis introduced, configured and disabled."""

    @property
    def thread(self) -> DriveThread: ...

    @property
    def axes(self) -> Mapping[str, Axis]: ...

    @property
    def identities(self) -> tuple[AxisIdentity, ...]: ...

    @property
    def capabilities(self) -> Capabilities: ...

    @property
    def watch(self) -> HostWatch: ...

    @property
    def sync_period(self) -> float:
        """Cycle of host-streamed sweeps, s."""
        ...

    async def stream(self, sweeps: Sequence[tuple[SweepCommand, Envelope]], stop: threading.Event) -> Run:
        """Start set-points on enabled axes whose limits are settled."""
        ...

    def halt(self, *, streaming: bool) -> None:
        """To every axis what makes it stop and needs no answer. From any thread; waits for nothing, never raises.

        `streaming`: a run sends at this moment, and was told.
        """
        ...

    async def close(self) -> None:
        """Release the bus; the axes are down."""
        ...


class Fieldbus(Protocol):
    """A profile's bus, not open yet."""

    async def open(self) -> Connection:
        """Open, identify, configure; nothing stays open if that fails."""
        ...

    def stop_sender(self) -> StopSender:
        """See `DrivePort.stop_sender`."""
        ...


def capabilities(
    axes: Iterable[Axis], set_point_timing: str = "none", *, hears_other_hosts: bool = False
) -> Capabilities:
    """What every axis can do; `set_point_timing` is who times streamed set-points, if they can be streamed."""
    everyone = tuple(axes)
    each = tuple(axis.abilities for axis in everyone)
    measures = all(abilities.measures for abilities in each)
    streams = all(abilities.streams for abilities in each)
    modes = {SweepMode.DRIVE_SIDE: measures, SweepMode.HOST_STREAMED: streams}
    return Capabilities(
        sweep_modes=frozenset(mode for mode, possible in modes.items() if possible),
        load_encoder=measures and all(axis.profile.load_encoder for axis in everyone),
        velocity_limit_in_drive=all(abilities.velocity_limit for abilities in each),
        effort_limit_in_drive=all(abilities.effort_limit for abilities in each),
        position_limits_in_drive=all(abilities.position_limits for abilities in each),
        host_watchdog_in_drive=all(abilities.host_watchdog for abilities in each),
        set_point_timing=set_point_timing if streams else "none",
        simultaneous_axes=len(everyone) if streams else 1,
        torque_injection=all(abilities.injects for abilities in each),
        hears_other_hosts=hears_other_hosts,
        set_points=each[0].set_point if streams else "none",
    )
