"""Interface of a fieldbus for a whole machine: an open connection with its axes and the single thread of its blocking
exchanges, so that they never overlap on the bus, and its streamed sweeps.
"""

import asyncio
import threading
from collections import deque
from collections.abc import AsyncGenerator, Callable, Coroutine, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from typing import ParamSpec, Protocol, TypeVar

from drivers.cia402.axis import Cia402Axis
from drivers.cia402.checks import DriveEnvelope
from drivers.cia402.host_watch import HostWatch
from drivers.errors import CauseCode, CommunicationLost, DriveError
from drivers.ports import AxisIdentity, Capabilities, SampleBlock, SetPointTiming, StopSender, SweepCommand, SweepMode

P = ParamSpec("P")


T = TypeVar("T")


class StopFirst(DriveError, code=CauseCode.SWEEP_INTERRUPTED):
    """A stop waits while a call uses the bus. The call ends by this, and begins again once the stop was sent."""


class DriveThread:
    """First come, first served, except for `post`. A call, once started, runs to its end if its caller is cancelled."""

    def __init__(self, name: str) -> None:
        self._executor = ThreadPoolExecutor(1, thread_name_prefix=name)
        self._closed = False
        self._posted: deque[Callable[[], object]] = deque()

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """The result of `function`, called on the thread. Raises CommunicationLost after `close`."""
        if self._closed:
            raise CommunicationLost("the connection was closed")
        return await asyncio.wrap_future(self._executor.submit(self._call, partial(function, *args, **kwargs)))

    def post(self, function: Callable[P, object], *args: P.args, **kwargs: P.kwargs) -> None:
        """Call `function` on the thread, before everything that has not begun; do not wait. Nothing after `close`."""
        self._posted.append(partial(function, *args, **kwargs))
        with suppress(RuntimeError):  # closed this moment
            self._executor.submit(self._call_posted)

    async def close(self) -> None:
        """Ends the thread after the calls that are queued; on a closed bus they fail at once."""
        self._closed = True
        await asyncio.to_thread(self._executor.shutdown)

    def _call(self, function: Callable[[], T]) -> T:
        """A call that a stop interrupted begins again. That moves nothing: whoever sends a stop marks the motion as
        stopped first, and every call that energises or moves checks this mark before its first command.
        """
        while True:
            self._call_posted()
            with suppress(StopFirst):
                return function()

    def _call_posted(self) -> None:
        while self._posted:
            self._posted.popleft()()


async def to_the_end(work: Coroutine[object, object, None]) -> None:
    """Runs code that releases a bus to its end, even if the caller is cancelled twice."""
    task = asyncio.create_task(work, name="release the bus")
    while not task.done():
        with suppress(asyncio.CancelledError):
            await asyncio.wait([task])
    task.result()


class RunningSweep(Protocol):
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

    async def interrupted(self) -> None:
        """After the stop event was set: wait until the stop sequence may talk to the drives."""

    async def over(self) -> None:
        """Wait until the run has ended, in whatever way. Its error is raised to the consumer, not here."""

    def timing(self) -> SetPointTiming | None:
        """Punctuality of the host's set-points; None if the drive generates them."""
        ...


class DriveConnection(Protocol):
    """An open bus with every axis identified, configured and disabled."""

    @property
    def thread(self) -> DriveThread: ...

    @property
    def axes(self) -> Mapping[str, Cia402Axis]: ...

    @property
    def identities(self) -> tuple[AxisIdentity, ...]: ...

    @property
    def capabilities(self) -> Capabilities: ...

    @property
    def sync_period(self) -> float:
        """Cycle time of host-streamed sweeps, s."""
        ...

    async def stream(self, sweeps: Sequence[tuple[SweepCommand, DriveEnvelope]], stop: threading.Event) -> RunningSweep:
        """Start the set-points on enabled axes whose limits are already written to the drives."""
        ...

    def halt(self, *, streaming: bool) -> None:
        """Send every axis a stop that needs no answer. From any thread; does not wait and never raises.

        `streaming`: a run is sending at this moment and was already halted.
        """

    async def close(self) -> None:
        """Release the bus; the axes are disabled."""


class Fieldbus(Protocol):
    """The bus of a profile, not yet open."""

    @property
    def watch(self) -> HostWatch:
        """One for all connections: a finding outlives the connection."""
        ...

    async def open(self) -> DriveConnection:
        """Open, identify and configure; if that fails, everything is closed again."""
        ...

    def stop_sender(self) -> StopSender:
        """See `DrivePort.stop_sender`."""
        ...


def capabilities(
    axes: Iterable[Cia402Axis],
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
