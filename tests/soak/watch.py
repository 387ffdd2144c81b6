"""Who may move now: a thread that looks at the axes as they are and notes every motion nobody asked for."""

import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import Any

from tests.system.rest_bench import VirtualMachine

EVERY = 0.02  # s between two looks
STANDS = 1e-6  # rad/s
LATE_ENERGY = 0.5  # s after what ends the motion: until then a look may be older than it

Axes = dict[str, dict[str, Any]]


class Leave(Enum):
    """What the axes may do."""

    MOVE = "a person has started or resumed"
    END = "what moves comes to rest; nothing gets energy"
    NONE = "no energy, no motion"


@dataclass(frozen=True)
class Unasked:
    """An axis that did what it had no leave for."""

    joint: str
    what: str
    after: str


class Watch:
    """`unasked` is what must stay empty; `rests` how long after its end each motion took, s of the machine's clock."""

    def __init__(self, machine: VirtualMachine) -> None:
        self.unasked: list[Unasked] = []
        self.rests: list[float] = []
        self._machine = machine
        self._lock = threading.Lock()
        self._leave, self._why = Leave.NONE, "before the first start"
        self._since = 0.0  # host's clock
        self._plant_since: float | None = None
        self._energised: set[str] = set()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._look_on, name="watch")

    def __enter__(self) -> "Watch":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()

    def may_move(self) -> None:
        """Before a person's start or resume is sent."""
        with self._lock:
            self._leave, self._why = Leave.MOVE, "resumed"

    def must_rest(self, why: str) -> None:
        """After what ends all motion until a person acts. That it ended before is kept."""
        with self._lock:
            if self._leave is Leave.MOVE:
                self._leave, self._why = Leave.END, why
                self._since, self._plant_since = time.monotonic(), None

    @property
    def rests_now(self) -> bool:
        with self._lock:
            return self._leave is Leave.NONE

    def _look_on(self) -> None:
        while not self._ending.wait(EVERY):
            with self._lock:
                leave, since = self._leave, self._since
            with suppress(OSError, ValueError, KeyError):  # the machine is without power
                status = self._machine.order("status")
                self._judge(leave, since, status["axes"], float(status["plant_time"]))

    def _judge(self, leave: Leave, since: float, axes: Axes, plant_time: float) -> None:
        """What was seen after the leave was read: one that has ended since then is judged at the next look."""
        energised = {joint for joint, axis in axes.items() if axis["energised"]}
        moving = {joint for joint, axis in axes.items() if abs(axis["velocity"]) > STANDS}
        with self._lock:
            gained, self._energised = energised - self._energised, energised
            if (leave, since) != (self._leave, self._since):
                return
            if leave is Leave.NONE:
                self._note(energised, "has energy")
                self._note(moving - energised, "moves")
            elif leave is Leave.END:
                if self._plant_since is None or plant_time < self._plant_since:  # a machine that was switched on anew
                    self._plant_since = plant_time
                if time.monotonic() > since + LATE_ENERGY:
                    self._note(gained, "got energy")
                if not energised and not moving:
                    self._leave = Leave.NONE
                    self.rests.append(plant_time - self._plant_since)

    def _note(self, joints: set[str], what: str) -> None:
        for joint in sorted(joints):
            found = Unasked(joint, what, self._why)
            if found not in self.unasked:
                self.unasked.append(found)
