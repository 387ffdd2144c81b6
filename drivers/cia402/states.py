"""The CiA 402 power state machine as one pure table (IEC 61800-7-201, statusword 6041h, controlword 6040h)."""

from enum import Enum, IntFlag

from drivers.errors import NotReady
from drivers.ports import AxisState


class PowerState(Enum):
    """States of the drive, as reported by its statusword."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    UNKNOWN = "unknown"


class Wish(Enum):
    """Target of a drive's power state."""

    ENABLED = "enabled"
    QUICK_STOP = "quick stop"
    DISABLED = "disabled"
    FAULT_RESET = "fault reset"


class Controlword(IntFlag):
    """Commands of 6040h, and the bits that are added to `ENABLE_OPERATION`."""

    DISABLE_VOLTAGE = 0x00
    QUICK_STOP = 0x02
    SHUTDOWN = 0x06
    SWITCH_ON = 0x07
    ENABLE_OPERATION = 0x0F
    FAULT_RESET = 0x80
    NEW_SET_POINT = 0x10
    """In profile position mode."""
    HALT = 0x100


class Statusword(IntFlag):
    """Bits of 6041h beside the state."""

    REMOTE = 0x200
    """The drive obeys its controlword."""
    TARGET_REACHED = 0x400
    SET_POINT_ACKNOWLEDGED = 0x1000


# (mask, value, state); the patterns exclude one another.
PATTERNS = (
    (0x4F, 0x00, PowerState.NOT_READY),
    (0x4F, 0x40, PowerState.SWITCH_ON_DISABLED),
    (0x6F, 0x21, PowerState.READY),
    (0x6F, 0x23, PowerState.SWITCHED_ON),
    (0x6F, 0x27, PowerState.OPERATION_ENABLED),
    (0x6F, 0x07, PowerState.QUICK_STOP_ACTIVE),
    (0x4F, 0x0F, PowerState.FAULT_REACTION),
    (0x4F, 0x08, PowerState.FAULT),
)

# The next controlword from a state towards a target. A pair that is not in the table is refused. Only ENABLED and only
# along its one path closes the loop; QUICK_STOP and DISABLED are allowed from everywhere, for they only take energy.
STEPS: dict[tuple[PowerState, Wish], Controlword] = {
    (PowerState.SWITCH_ON_DISABLED, Wish.ENABLED): Controlword.SHUTDOWN,
    (PowerState.READY, Wish.ENABLED): Controlword.SWITCH_ON,
    (PowerState.SWITCHED_ON, Wish.ENABLED): Controlword.ENABLE_OPERATION,
    (PowerState.OPERATION_ENABLED, Wish.ENABLED): Controlword.ENABLE_OPERATION,
    (PowerState.FAULT, Wish.FAULT_RESET): Controlword.FAULT_RESET,
    **{(state, Wish.QUICK_STOP): Controlword.QUICK_STOP for state in PowerState},
    **{(state, Wish.DISABLED): Controlword.DISABLE_VOLTAGE for state in PowerState},
}

ENERGISED = frozenset(
    {PowerState.SWITCHED_ON, PowerState.OPERATION_ENABLED, PowerState.QUICK_STOP_ACTIVE, PowerState.FAULT_REACTION}
)
WITHOUT_ENERGY = frozenset(PowerState) - ENERGISED - {PowerState.UNKNOWN}

_OPERATOR_VIEW = {
    PowerState.NOT_READY: AxisState.DISABLED,
    PowerState.SWITCH_ON_DISABLED: AxisState.DISABLED,
    PowerState.READY: AxisState.DISABLED,
    PowerState.SWITCHED_ON: AxisState.DISABLED,
    PowerState.OPERATION_ENABLED: AxisState.ENABLED,
    PowerState.QUICK_STOP_ACTIVE: AxisState.STOPPING,
    PowerState.FAULT_REACTION: AxisState.STOPPING,
    PowerState.FAULT: AxisState.FAULT,
    PowerState.UNKNOWN: AxisState.UNKNOWN,
}


def decode(statusword: int) -> PowerState:
    """The state in a statusword; UNKNOWN if no pattern matches."""
    for mask, value, state in PATTERNS:
        if statusword & mask == value:
            return state
    return PowerState.UNKNOWN


def step(state: PowerState, wish: Wish) -> Controlword:
    """The controlword that leads from `state` towards `wish`. Raises NotReady if none may be sent."""
    controlword = STEPS.get((state, wish))
    if controlword is None:
        raise NotReady(f"drive is in state '{state.value}', which does not allow '{wish.value}'")
    return controlword


def operator_view(state: PowerState) -> AxisState:
    """The state as an operator needs it."""
    return _OPERATOR_VIEW[state]
