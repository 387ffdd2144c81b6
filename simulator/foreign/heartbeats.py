"""Heartbeats of a node: its own (1017h), and those of other nodes that it monitors (1016h; CiA 301, 7.2.8.2.2)."""

from math import inf

from simulator.drive.dictionary import Abort, AbortCode
from simulator.foreign.dictionary import ForeignDictionary


class Heartbeats:
    """Producer and consumers of one node. Other nodes are monitored from their first heartbeat on."""

    def __init__(self, dictionary: ForeignDictionary) -> None:
        self._dictionary = dictionary
        self._subs = [sub for _, sub in dictionary.keys(0x1016) if sub]
        for sub in self._subs:
            dictionary.on_download((0x1016, sub), lambda value, sub=sub: self._watch(value, sub))
        self.reset()

    def reset(self) -> None:
        """As at power-on."""
        self._next: float | None = None
        self._heard: dict[int, float] = {}

    def hear(self, number: int, now: float) -> None:
        """A heartbeat or boot-up message of node `number`."""
        if any(node == number for node, _ in self._watched()):
            self._heard[number] = now

    def beat(self, now: float) -> bool:
        """Whether the heartbeat of the node is due; it then counts as sent."""
        period = self._dictionary.get(0x1017) * 1e-3
        if period == 0:
            self._next = None
            return False
        if self._next is not None and now < self._next:
            return False
        self._next = max((self._next or now) + period, now)
        return True

    def missed(self, now: float) -> bool:
        """Whether a heartbeat is missing now; reported once, until it is received again."""
        late = [n for n, time in self._watched() if n in self._heard and now - self._heard[n] > time]
        for number in late:
            del self._heard[number]
        return bool(late)

    def due(self, now: float) -> float:
        """Time of the next call, s; infinity if never."""
        times = [self._heard[number] + time for number, time in self._watched() if number in self._heard]
        if self._dictionary.get(0x1017):
            times.append(now if self._next is None else self._next)
        return min(times, default=inf)

    def _watched(self) -> list[tuple[int, float]]:
        """(node, time in s) of every consumer in use."""
        values = [self._dictionary[0x1016, sub] for sub in self._subs]
        return [(v >> 16 & 0x7F, (v & 0xFFFF) * 1e-3) for v in values if v >> 16 & 0x7F and v & 0xFFFF]

    def _watch(self, value: int, sub: int) -> None:
        number = value >> 16 & 0xFF
        others = [self._dictionary[0x1016, other] for other in self._subs if other != sub]
        if number and value & 0xFFFF and any(o & 0xFFFF and o >> 16 & 0x7F == number for o in others):
            raise Abort(AbortCode.INCOMPATIBLE)
        self._heard.pop(number, None)
