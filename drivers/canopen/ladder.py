"""The stop ladder of a streaming axis as a pure table of rungs: ramp to zero, quick stop, disable voltage."""

from dataclasses import dataclass
from enum import IntEnum

from drivers.cia402 import states
from drivers.cia402.states import State, Wish


class Rung(IntEnum):
    """How far the ladder was climbed; it is never climbed down."""

    RUN = 0
    RAMP = 1
    QUICK_STOP = 2
    DISABLE = 3
    DONE = 4


@dataclass(slots=True)
class Ladder:
    """`ramp_step` raw velocity units a cycle; a rung that has not helped by its deadline (s) gives way to the next."""

    ramp_step: int
    ramp_time: float
    quick_stop_time: float
    disable_time: float
    rung: Rung = Rung.RUN
    _target: int = 0
    _deadline: float = 0.0

    def climb(self, rung: Rung, now: float, target: int) -> None:
        """Go to `rung` unless the ladder is already there or higher; `target` is the set-point of this moment."""
        if rung <= self.rung:
            return
        self.rung = rung
        self._target = target
        self._deadline = now + (0.0, self.ramp_time, self.quick_stop_time, self.disable_time, 0.0)[rung]

    def command(self, now: float, standing: bool, state: State) -> tuple[int, int]:
        """Controlword and target velocity of this cycle, after climbing where it is due.

        A run that is not on its way any more (the state is not what it was) goes to the quick stop.
        """
        if self.rung is Rung.RUN:
            self.climb(Rung.QUICK_STOP, now, 0)
        off = state not in states.ENERGISED | {State.UNKNOWN}
        if self.rung is Rung.RAMP:
            self._target -= max(-self.ramp_step, min(self.ramp_step, self._target))
            if self._target == 0 and standing:
                self.climb(Rung.DISABLE, now, 0)
            elif now > self._deadline or state is not State.OPERATION_ENABLED:
                self.climb(Rung.QUICK_STOP, now, 0)
            else:
                return states.ENABLE_OPERATION, self._target
        if self.rung is Rung.QUICK_STOP:
            if standing or off or now > self._deadline:
                self.climb(Rung.DISABLE, now, 0)
            else:
                return states.step(state, Wish.QUICK_STOP), 0
        if self.rung is Rung.DISABLE and (off or now > self._deadline):
            self.climb(Rung.DONE, now, 0)
        return states.step(state, Wish.DISABLED), 0
