"""Set-points timed by the kernel: one job of SocketCAN's broadcast manager (linux/can/bcm.h, net/can/bcm.c).

The job is a ring of at most 256 frames that the kernel sends one an interval, so a cycle of n set-points and SYNC is
n + 1 frames an interval T / (n + 1) apart: their order is certain. (Two jobs would walk apart: the kernel counts an
interval from the moment at which it was woken, not from when it should have been.) For the same reason the interval is
steered: at each topping-up it is set anew, so that SYNC keeps to a grid of T on the monotonic clock.

SETTIMER without STARTTIMER sets frames, count and interval and leaves the running timer and the place in the ring as
they are. The count ends the job by itself: when the host hangs, the kernel sends what is planned, then a few cycles of
quick stop, then nothing.
"""

import socket
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress

from drivers.canopen.bus import Bus
from drivers.errors import CommunicationLost

TX_SETUP, TX_DELETE = 1, 2
SETTIMER, STARTTIMER = 1, 2
RING = 256  # frames of one job at most
LONGEST_RING = 1.0  # s
MOST_STEERING = 0.1  # of the interval; a kernel that needs more is late, and that is counted

Cycle = Sequence[tuple[int, bytes]]

_HEAD = struct.Struct("@3I4l2I0q")  # opcode, flags, count, ival1 s us, ival2 s us, can_id, nframes
_FRAME = struct.Struct("=IB3x8s")


def set_point_source(bus: Bus) -> str:
    """Who times the set-points of streamed sweeps on this bus: "bcm" (the kernel) or "thread"."""
    if bus.kernel_interface is None:
        return "thread"
    try:
        _connect(bus.kernel_interface).close()
    except OSError:
        return "thread"
    return "bcm"


def _connect(interface: str) -> socket.socket:
    if not hasattr(socket, "CAN_BCM"):
        raise OSError("no CAN_BCM here")
    connected = socket.socket(socket.AF_CAN, socket.SOCK_DGRAM, socket.CAN_BCM)
    try:
        connected.connect((interface,))
        connected.setblocking(False)
    except OSError:
        connected.close()
        raise
    return connected


class KernelRefused(CommunicationLost):
    """The kernel does not take set-points (any more): interface down or gone, no memory."""


class KernelStream:
    """The cycles of a sweep, sent by the kernel. Every method raises KernelRefused where it does not take them."""

    def __init__(self, interface: str, period: float, plan: Callable[[int], Cycle], rest: Cycle) -> None:
        """`plan(k)` is cycle k of the sweep, set-points and SYNC; `rest` follows when nobody tops up. `period` s."""
        size = len(rest)
        self._plan, self._rest = plan, _pack(rest)
        self._cycles = min(RING // size, round(LONGEST_RING / period))
        self._spare = max(2, self._cycles // 4)  # cycles of `rest` behind the planned ones
        self._step = max(1, self._cycles // 8)  # cycles after which to top up
        self._identifier = rest[0][0]
        self._size = size
        self._steering = Steering(period / size, self._step * size)
        self._ring = [self._rest] * self._cycles
        self._filled = 0  # cycles planned so far
        self._next_top_up = self._step
        try:
            self._socket = _connect(interface)
        except OSError as error:
            raise KernelRefused(f"{interface}: the kernel's timer is not to be had: {error}") from None
        self._interface = interface

    def begin(self) -> None:
        """Cycle 0 goes out now."""
        self._fill(0)
        self._set_up(SETTIMER | STARTTIMER)

    def note(self, late: float) -> None:
        """A cycle was sent, this much behind its deadline, s."""
        self._steering.note(late)

    def top_up(self, sent: int) -> None:
        """Plans further cycles if it is time; `sent` are known to be out, and nothing waits to be heard of more."""
        if sent >= self._next_top_up:
            self._next_top_up = sent + self._step
            self._fill(sent)
            self._steering.adjust()
            self._set_up(SETTIMER)

    def close(self) -> None:
        """Nothing is sent after this."""
        with suppress(OSError):  # the interface, and the job with it, may be gone
            self._socket.send(_head(TX_DELETE, 0, 0, 0.0, self._identifier, 0))
        self._socket.close()

    def _fill(self, sent: int) -> None:
        end = sent + self._cycles - self._spare
        for number in range(self._filled, end):
            self._ring[number % self._cycles] = _pack(self._plan(number))
        for number in range(end, end + self._spare):
            self._ring[number % self._cycles] = self._rest
        self._filled = end

    def _set_up(self, flags: int) -> None:
        # A cycle may be under way or have gone out unseen: the count ends half-way through the spare ones.
        count = (self._cycles - self._spare + self._spare // 2) * self._size
        interval = self._steering.interval
        head = _head(TX_SETUP, flags, count, interval, self._identifier, self._cycles * self._size)
        try:
            self._socket.send(head + b"".join(self._ring))
        except OSError as error:
            raise KernelRefused(f"{self._interface}: the kernel refused the set-points: {error}") from None


class Steering:
    """The interval between two frames by which the cycles keep to their deadlines: proportional and integral. Pure."""

    def __init__(self, interval: float, frames_between: int) -> None:
        """Nominal interval, s, and frames from one adjustment to the next."""
        self.interval = interval
        self._nominal, self._frames = interval, frames_between
        self._sum, self._count = 0.0, 0
        self._delay = 0.0  # by which the kernel is late in each interval, s

    def note(self, late: float) -> None:
        """A cycle was so late, s."""
        self._sum += late
        self._count += 1

    def adjust(self) -> None:
        """A new interval from the latenesses noted since the last adjustment."""
        late = self._sum / max(1, self._count)
        self._sum, self._count = 0.0, 0
        correction = 0.5 * late / self._frames
        self._delay += 0.2 * late / self._frames
        most = MOST_STEERING * self._nominal
        self._delay = max(-most, min(most, self._delay))
        self.interval = self._nominal - max(-most, min(most, self._delay + correction))


def _head(opcode: int, flags: int, count: int, interval: float, identifier: int, size: int) -> bytes:
    microseconds = max(1, round(interval * 1e6))
    return _HEAD.pack(opcode, flags, count, 0, microseconds, 0, 0, identifier, size)


def _pack(cycle: Cycle) -> bytes:
    return b"".join(_FRAME.pack(identifier, len(data), data) for identifier, data in cycle)
