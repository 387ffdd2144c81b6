"""Transmission of a node's TPDOs: with SYNC, or immediately on a change (CiA 301, 7.2.2.2); with ordered
disturbances.
"""

from collections.abc import Callable, Sequence
from math import inf

from simulator.canopen.node import Frame
from simulator.drive.disturbance import Disturbance
from simulator.foreign.pdo import Pdo


class Transmission:
    """All TPDOs of one node."""

    def __init__(self, pdos: Sequence[Pdo], order: Disturbance, send: Callable[[Frame], None]) -> None:
        self.pdos = tuple(pdos)
        self._order = order
        self._send = send
        self.reset()

    def reset(self) -> None:
        """Nothing was sent yet, as when the node becomes operational."""
        self._syncs = 0
        self._sent: dict[int, tuple[bytes, float]] = {}
        self._late: list[tuple[int, Frame]] = []  # to be sent with a later SYNC

    def sync(self) -> None:
        """Send the TPDOs of this SYNC after delayed ones. Each can be ordered to be lost, duplicated or late."""
        self._syncs += 1
        order = self._order
        frames = [Frame(pdo.cob_id, pdo.pack()) for k, pdo in enumerate(self.pdos) if self._of_this_sync(k, pdo)]
        late = [frame for due, frame in self._late if due <= self._syncs]
        self._late = [(due, frame) for due, frame in self._late if due > self._syncs]
        if frames and order.delay_tpdos > 0:
            order.delay_tpdos -= 1
            self._late += [(self._syncs + order.delay_cycles, frame) for frame in frames]
            frames = []
        if frames and order.duplicate_tpdos > 0:
            order.duplicate_tpdos -= 1
            frames *= 2
        for frame in late + frames:
            if order.drop_tpdos > 0:
                order.drop_tpdos -= 1
            else:
                self._send(frame)

    def run(self, now: float) -> None:
        """Send event TPDOs: a value changed, or the event timer expired; never within the inhibit time."""
        for k, pdo in enumerate(self.pdos):
            if pdo.synchronous or not pdo.valid or not pdo.keys:
                continue
            data, (before, when) = pdo.pack(), self._sent.get(k, (None, -inf))
            timed = 0 < pdo.event_time <= now - when
            if (data != before or timed) and now - when >= pdo.inhibit_time:
                self._sent[k] = data, now
                self._send(Frame(pdo.cob_id, data))

    def due(self, now: float) -> float:
        """Latest time at which `run` must be called, s; infinity if nothing is pending."""
        times: list[float] = []
        for k, pdo in enumerate(self.pdos):
            if pdo.synchronous or not pdo.valid or not pdo.keys:
                continue
            before, when = self._sent.get(k, (None, -inf))
            if pdo.event_time:
                times.append(max(when + pdo.event_time, now))
            if pdo.pack() != before:
                times.append(max(when + pdo.inhibit_time, now))
        return min(times, default=inf)

    def _of_this_sync(self, k: int, pdo: Pdo) -> bool:
        if not pdo.valid or not pdo.synchronous or not pdo.keys:
            return False
        if pdo.transmission_type:
            return self._syncs % pdo.transmission_type == 0
        data, (before, _) = pdo.pack(), self._sent.get(k, (None, -inf))
        self._sent[k] = data, -inf
        return data != before
