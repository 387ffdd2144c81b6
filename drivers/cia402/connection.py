"""Interface of a fieldbus for a whole machine: an open connection with its axes, and its streamed sweeps."""

import threading
from collections.abc import AsyncGenerator, Iterable, Mapping, Sequence
from typing import Protocol

from drivers.cia402.axis import Axis
from drivers.cia402.checks import Envelope
from drivers.cia402.host_watch import HostWatch
from drivers.cia402.thread import DriveThread
from drivers.ports import AxisIdentity, Capabilities, SampleBlock, SetPointTiming, StopSender, SweepCommand, SweepMode


class Run(Protocol):
    """A running sweep."""

    def blocks(self) -> AsyncGenerator[SampleBlock, None]:
        """The samples as they arrive, until the sweep ends at standstill; raises the error that ended it early."""
        ...

    @property
    def streams(self) -> bool:
        """Whether the run sends set-points and SYNC, which makes the drives accept their RPDOs."""
        ...

    def halt(self) -> None:
        """Continue with the quick stop, whatever is in progress. From any thread."""
        ...

    async def interrupted(self) -> None:
        """After the stop event was set: wait until the stop sequence may talk to the drives."""
        ...

    async def over(self) -> None:
        """Wait until the run has ended, in whatever way. Its error is raised to the consumer, not here."""
        ...

    def timing(self) -> SetPointTiming | None:
        """Punctuality of the host's set-points; None if the drive generates them."""
        ...


class Connection(Protocol):
    """An open bus with every axis identified, configured and disabled."""

    @property
    def thread(self) -> DriveThread: ...

    @property
    def axes(self) -> Mapping[str, Axis]: ...

    @property
    def identities(self) -> tuple[AxisIdentity, ...]: ...

    @property
    def capabilities(self) -> Capabilities: ...

    @property
    def sync_period(self) -> float:
        """Cycle time of host-streamed sweeps, s."""
        ...

    async def stream(self, sweeps: Sequence[tuple[SweepCommand, Envelope]], stop: threading.Event) -> Run:
        """Start the set-points on enabled axes whose limits are already written to the drives."""
        ...

    def halt(self, *, streaming: bool) -> None:
        """Send every axis a stop that needs no answer. From any thread; does not wait and never raises.

        `streaming`: a run is sending at this moment and was already halted.
        """
        ...

    async def close(self) -> None:
        """Release the bus; the axes are disabled."""
        ...


class Fieldbus(Protocol):
    """The bus of a profile, not yet open."""

    @property
    def watch(self) -> HostWatch:
        """One for all connections: a finding outlives the connection."""
        ...

    async def open(self) -> Connection:
        """Open, identify and configure; if that fails, everything is closed again."""
        ...

    def stop_sender(self) -> StopSender:
        """See `DrivePort.stop_sender`."""
        ...


def capabilities(
    axes: Iterable[Axis],
    set_point_timing: str = "none",
    *,
    hears_other_hosts: bool = False,
    bus_bitrate: int | None = None,
    bus_load: Sequence[float] = (),
) -> Capabilities:
    """Capabilities common to all axes. `set_point_timing`: who times streamed set-points, if they can be streamed.

    `bus_load`: share of the bit rate that a streamed sweep of one, two, ... axes uses.
    """
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
        bus_bitrate=bus_bitrate,
        bus_load=tuple(bus_load) if streams and bus_bitrate is not None else (),
    )
