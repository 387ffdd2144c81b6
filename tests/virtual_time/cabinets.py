"""The cabinets of the simulator on the scheduler: nothing is polled, the plant runs to the next event in one call."""

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from simulator.cabinet import VirtualDriveCabinet
from tests.virtual_time import primitives

_LEAST_STEP = 20e-6  # s between two times at which the cabinet looks at its timers
CHUNK = 100  # cycles of the plant in one call while nothing can look at it
CAREFUL = 10
_STALE = 8  # cycles by which the plant may lag behind a look at it; in real time it lags by 4 to 16


class EventDriven(VirtualDriveCabinet[Any]):
    """Mixed into a cabinet: its plant runs to the next event in one call, which is a frame, a timer or an order.

    On real time the plant runs in chunks of a few cycles, because somebody may look at it at any time. Here every look
    is an event, before which the plant is advanced to this moment, but for less than `_STALE` cycles.
    """

    careful = CAREFUL
    """Cycles of the plant in one call while an axis moves: more if only energy matters, not where it stops."""
    _plant_time: float | None = None
    frozen = False
    """Its clock stands, that of plant and drives: nothing is heard or said."""

    def __init__(self, *parts: Any) -> None:
        self.energy: list[tuple[float, str, bool]] = []
        """When an axis got energy or lost it: the truth that a test judges by."""
        self.changed: Callable[[str, bool], None] = lambda _joint, _on: None
        """Called at each such moment; it must not wait."""
        super().__init__(*parts)

    def switch(self) -> None:
        changed = {
            info.joint: axis.energised
            for info, axis in self._axes
            if axis.energised != self._machine.energised(info.joint)
        }
        if not changed:
            return
        super().switch()
        for joint, on in sorted(changed.items()):
            self.energy.append((primitives.world.now, joint, on))
            self.changed(joint, on)

    def run(self, now: float) -> None:
        if self.frozen:
            self._plant_time = now
            return
        pace, _ = self._pace()
        if pace == 0.0 or self._plant_time is None:
            self._plant_time = now
        else:
            cycle = self._machine.cycle / pace
            while (cycles := min(int((now - self._plant_time) / cycle + 1e-6), self._chunk())) >= _STALE:
                self._plant_time += cycles * cycle
                self.advance(cycles)
                if self._pace()[0] != pace:
                    self._plant_time = now
                    break
        for node in self.nodes.values():
            node.run(now)
        self.switch()

    def due(self, now: float) -> float:
        if self.frozen:
            return float("inf")
        pace, _ = self._pace()
        chunk = float("inf")
        if pace > 0.0:
            chunk = (now if self._plant_time is None else self._plant_time) + self._chunk() * self._machine.cycle / pace
        return max(min(chunk, *(node.due(now) for node in self.nodes.values())) - now, 0.0)

    @property
    def resting(self) -> bool:
        """An axis has energy, and none moves."""
        axes = [axis for _, axis in self._axes if axis.energised]
        return bool(axes) and not any(axis.settling or axis.moving for axis in axes)

    def _chunk(self) -> int:
        """A move, a ramp and the rest after them end by what the plant does: only then in small steps."""
        axes = [axis for _, axis in self._axes if axis.energised]
        careful = any(axis.settling or (axis.moving and not axis.measuring.driving) for axis in axes)
        return self.careful if careful else CHUNK


OnWire = TypeVar("OnWire", bound=EventDriven)


class Powered(Generic[OnWire]):
    """A fieldbus and the cabinet on it, whose power is on until `close`."""

    wire = 100e-6  # s from a host to the bus
    late = 2e-3  # s by which something may come later than that; drawn on a logarithmic scale

    def __init__(self, cabinet: OnWire) -> None:
        self.world = primitives.world
        self.cabinet = cabinet
        self.switched_off = False
        self._closed = False
        self._planned: float | None = None
        cabinet.boot()
        self._plan()

    def switch_off(self, *, off: bool) -> None:
        """Nothing passes in either direction until it is switched on."""
        self.switched_off = off

    def look(self) -> None:
        """The plant as it is at this moment; call `acted` if anything was changed."""
        self.cabinet.run(self.world.now)

    def acted(self) -> None:
        self.cabinet.run(self.world.now)
        self._plan()

    def delay(self) -> float:
        chance = self.world.random
        if not self.world.seed or chance.random() < 0.5:
            return self.wire
        return self.wire + self.late * 10 ** (-3 * chance.random())

    def freeze(self) -> None:
        """Stop the clock of plant and drives, at this moment."""
        self.look()
        self.cabinet.frozen = True

    def close(self) -> None:
        """Power off."""
        self._closed = self.cabinet.frozen = True

    def _plan(self) -> None:
        """Look at the cabinet again when its timers are due."""
        now = self.world.now
        due = self.cabinet.due(now)
        if self._closed or due == float("inf"):
            self._planned = None
            return
        when = now + max(due, _LEAST_STEP)
        if self._planned is None or self._planned <= now or when < self._planned - _LEAST_STEP / 2:
            self._planned = when
            self.world.at(when, lambda: self._tick(when))

    def _tick(self, when: float) -> None:
        if when == self._planned and not self._closed:
            self._planned = None
            self.cabinet.run(self.world.now)
            self._plan()
