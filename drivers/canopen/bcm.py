"""Set-points timed by the kernel: one job of SocketCAN's broadcast manager (linux/can/bcm.h, net/can/bcm.c).

The job is a ring of at most 256 frames. The kernel sends one frame per interval. A cycle of n set-points and SYNC
has n + 1 frames with the interval T / (n + 1), so their order is fixed. (Two jobs would drift apart: the kernel
counts an interval from the moment at which it woke up, not from the planned moment.) For the same reason the
interval is controlled: at each refill it is adjusted so that SYNC keeps to a grid of T on the monotonic clock.

SETTIMER without STARTTIMER sets frames, count and interval, and does not change the running timer or the position in
the ring. The count ends the job: if the host hangs, the kernel sends the planned cycles, then a few cycles of quick
stop, then nothing.
"""

import socket
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import IntFlag

from drivers.canopen.bus import CanopenBus
from drivers.errors import CauseCode, CommunicationLost

Cycle = Sequence[tuple[int, bytes]]


class Bcm(IntFlag):
    """Operations and flags of the broadcast manager."""

    TX_SETUP = 1
    TX_DELETE = 2
    SETTIMER = 1
    STARTTIMER = 2


def set_point_source(bus: CanopenBus, *, waits: bool = False) -> str:
    """What times the set-points of streamed sweeps on this bus: "bcm" (the kernel) or "thread".

    `waits`: the host delays SYNC until all drives have answered. Only its own thread can do that.
    """
    if waits or bus.kernel_interface is None:
        return "thread"
    try:
        _connect(bus.kernel_interface).close()
    except OSError:
        return "thread"
    return "bcm"


def _connect(interface: str) -> socket.socket:
    if not hasattr(socket, "CAN_BCM"):
        raise OSError("this computer has no CAN_BCM sockets")
    connected = socket.socket(socket.AF_CAN, socket.SOCK_DGRAM, socket.CAN_BCM)
    try:
        connected.connect((interface,))
        connected.setblocking(False)
    except OSError:
        connected.close()
        raise
    return connected


class KernelRefused(CommunicationLost, code=CauseCode.COMMUNICATION_LOST):
    """The kernel does not accept (further) set-points: interface down or removed, no memory."""


class KernelStream:
    """The cycles of a sweep, sent by the kernel. Every method raises KernelRefused if the kernel refuses them."""

    def __init__(self, interface: str, period: float, plan: Callable[[int], Cycle], rest: Cycle) -> None:
        """`plan(k)`: set-points and SYNC of cycle k; `rest` is sent if there is no refill. `period` in s."""
        size = len(rest)
        self._plan, self._rest = plan, _pack(rest)
        self._cycles = min(256 // size, round(1.0 / period))  # frames of a job at most; 1 s
        self._spare = max(2, self._cycles // 4)  # cycles of `rest` after the planned ones
        self._step = max(1, self._cycles // 8)  # cycles between refills
        self._identifier = rest[0][0]
        self._size = size
        self._steering = Steering(period / size, self._step * size)
        self._ring = [self._rest] * self._cycles
        self._filled = 0  # cycles planned so far
        self._next_top_up = self._step
        try:
            self._socket = _connect(interface)
        except OSError as error:
            raise KernelRefused(f"{interface}: the kernel's CAN_BCM timer is not available: {error}") from None
        self._interface = interface

    def begin(self) -> None:
        """Send cycle 0 now."""
        self._fill(0)
        self._set_up(Bcm.SETTIMER | Bcm.STARTTIMER)

    def note(self, late: float) -> None:
        """A cycle was sent `late` s after its deadline."""
        self._steering.note(late)

    def top_up(self, sent: int) -> None:
        """Plans further cycles if it is time. `sent` cycles were sent, and no event about further ones is waiting."""
        if sent >= self._next_top_up:
            self._next_top_up = sent + self._step
            self._fill(sent)
            self._steering.adjust()
            self._set_up(Bcm.SETTIMER)

    def close(self) -> None:
        """Nothing is sent after this."""
        with suppress(OSError):  # the interface and its job may be gone
            self._socket.send(_head(Bcm.TX_DELETE, 0, 0, 0.0, self._identifier, 0))
        self._socket.close()

    def _fill(self, sent: int) -> None:
        end = sent + self._cycles - self._spare
        for number in range(self._filled, end):
            self._ring[number % self._cycles] = _pack(self._plan(number))
        for number in range(end, end + self._spare):
            self._ring[number % self._cycles] = self._rest
        self._filled = end

    def _set_up(self, flags: int) -> None:
        # A cycle may be in progress or sent but not yet seen: the count ends half-way through the spare ones.
        count = (self._cycles - self._spare + self._spare // 2) * self._size
        interval = self._steering.interval
        head = _head(Bcm.TX_SETUP, flags, count, interval, self._identifier, self._cycles * self._size)
        try:
            self._socket.send(head + b"".join(self._ring))
        except OSError as error:
            raise KernelRefused(f"{self._interface}: the kernel refused the set-points: {error}") from None


class Steering:
    """PI control of the interval between two frames, so that the cycles keep to their deadlines. Pure."""

    def __init__(self, interval: float, frames_between: int) -> None:
        """Nominal interval, s, and number of frames between two adjustments."""
        self.interval = interval
        self._nominal, self._frames = interval, frames_between
        self._sum, self._count = 0.0, 0
        self._delay = 0.0  # delay of the kernel in each interval, s

    def note(self, late: float) -> None:
        """A cycle was `late` s after its deadline."""
        self._sum += late
        self._count += 1

    def adjust(self) -> None:
        """Compute a new interval from the lateness noted since the last adjustment."""
        late = self._sum / max(1, self._count)
        self._sum, self._count = 0.0, 0
        correction = 0.5 * late / self._frames
        self._delay += 0.2 * late / self._frames
        most = 0.1 * self._nominal  # a kernel that needs more is late, which is counted
        self._delay = max(-most, min(most, self._delay))
        self.interval = self._nominal - max(-most, min(most, self._delay + correction))


def _head(opcode: int, flags: int, count: int, interval: float, identifier: int, size: int) -> bytes:
    microseconds = max(1, round(interval * 1e6))
    # opcode, flags, count, ival1 s us, ival2 s us, can_id, nframes
    return struct.pack("@3I4l2I0q", opcode, flags, count, 0, microseconds, 0, 0, identifier, size)


def _pack(cycle: Cycle) -> bytes:
    return b"".join(struct.pack("=IB3x8s", identifier, len(data), data) for identifier, data in cycle)
