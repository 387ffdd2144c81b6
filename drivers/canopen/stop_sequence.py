"""The stop sequence of a streaming axis as a pure table of stages: ramp to zero, quick stop, disable voltage."""

from dataclasses import dataclass
from enum import IntEnum

from drivers.cia402 import states
from drivers.cia402.states import State, Wish


class StopStage(IntEnum):
    """Stage of the stop; it never decreases."""

    RUN = 0
    RAMP = 1
    QUICK_STOP = 2
    DISABLE = 3
    DONE = 4


@dataclass(slots=True)
class StopSequence:
    """`ramp_step`: raw velocity units per cycle. A stage without success by its deadline (s) is followed by the next
    one.
    """

    ramp_step: int
    ramp_time: float
    quick_stop_time: float
    disable_time: float
    stage: StopStage = StopStage.RUN
    _target: int = 0
    _deadline: float = 0.0

    def advance(self, stage: StopStage, now: float, target: int) -> None:
        """Go to `stage` unless it is already reached; `target` is the present set-point."""
        if stage <= self.stage:
            return
        self.stage = stage
        self._target = target
        self._deadline = now + (0.0, self.ramp_time, self.quick_stop_time, self.disable_time, 0.0)[stage]

    def command(self, now: float, standing: bool, state: State) -> tuple[int, int]:
        """Controlword and target velocity of this cycle, after changing the stage if it is due.

        If the drive has left the expected state, the quick stop begins.
        """
        if self.stage is StopStage.RUN:
            self.advance(StopStage.QUICK_STOP, now, 0)
        off = state not in states.ENERGISED | {State.UNKNOWN}
        if self.stage is StopStage.RAMP:
            self._target -= max(-self.ramp_step, min(self.ramp_step, self._target))
            if self._target == 0 and standing:
                self.advance(StopStage.DISABLE, now, 0)
            elif now > self._deadline or state is not State.OPERATION_ENABLED:
                self.advance(StopStage.QUICK_STOP, now, 0)
            else:
                return states.ENABLE_OPERATION, self._target
        if self.stage is StopStage.QUICK_STOP:
            if standing or off or now > self._deadline:
                self.advance(StopStage.DISABLE, now, 0)
            else:
                return states.step(state, Wish.QUICK_STOP), 0
        if self.stage is StopStage.DISABLE and (off or now > self._deadline):
            self.advance(StopStage.DONE, now, 0)
        return states.step(state, Wish.DISABLED), 0
