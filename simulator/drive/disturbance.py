"""Disturbances that the control port applies to an axis and its node; plain state, at `Axis.disturbance`."""

from dataclasses import dataclass
from math import inf


@dataclass(frozen=True, slots=True)
class OrderedFault:
    """A fault that occurs at trace sample `at_sample` or SYNC counter `at_counter`."""

    code: int
    at_sample: float = inf
    at_counter: float = inf


@dataclass(frozen=True, slots=True)
class Glitch:
    """One sample of the motor encoder is wrong by `revolutions`: trace sample `at_sample`, or the next one."""

    revolutions: float
    at_sample: int | None = None


@dataclass(slots=True)
class Disturbance:
    """Initially without disturbance. A boot of the node does not change it."""

    mute: bool = False
    counter_frozen: bool = False
    limit_switch: bool = False
    torque_cap: float = inf  # relative to the rated torque, maximum of the power section
    fault: OrderedFault | None = None
    glitch: Glitch | None = None
    drop_tpdos: int = 0  # frames still to be lost
    duplicate_tpdos: int = 0  # SYNCs whose TPDOs are still to be sent twice
    delay_tpdos: int = 0  # SYNCs whose TPDOs are still to be sent late ...
    delay_cycles: int = 0  # ... by this number of SYNCs

    def take_fault(self, recorded: int = 0, counter: int = 0) -> int | None:
        """The code of the ordered fault if it is due at this number of recorded samples or counted SYNCs."""
        fault = self.fault
        if fault is None or (recorded <= fault.at_sample and counter < fault.at_counter):
            return None
        self.fault = None
        return fault.code

    def take_glitch(self, recorded: int) -> Glitch | None:
        """The ordered glitch if it is due at this number of recorded samples, and the sample that it affects."""
        glitch = self.glitch
        if glitch is None or (glitch.at_sample is not None and recorded <= glitch.at_sample):
            return None
        self.glitch = None
        return glitch if glitch.at_sample is not None else Glitch(glitch.revolutions, recorded - 1)
