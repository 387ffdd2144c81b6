"""No statusword, in whatever order, makes the power logic give torque to a drive that is not ready for it."""

import threading
from collections.abc import Sequence

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from drivers.cia402 import states
from drivers.cia402.axis import Cia402Axis
from drivers.cia402.host_watch import HostWatch
from drivers.cia402.states import Controlword, PowerState
from drivers.errors import DriveError
from tests.unit.drivers.small_servo import Servo

pytestmark = pytest.mark.slow

READY = {PowerState.SWITCHED_ON, PowerState.OPERATION_ENABLED}
STATUSWORD = st.sampled_from([0x00, 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08, 0x60]) | st.integers(0, 0xFFFF)


class Whim(Servo):
    """Shows one statusword after the other, whatever it is told; the last one stays."""

    def __init__(self, statuswords: Sequence[int]) -> None:
        super().__init__("joint_1")
        self._statuswords = list(statuswords)
        self.shown = statuswords[0]
        self.asked: list[tuple[PowerState, int]] = []  # state shown last, controlword

    def statusword(self) -> int:
        self.shown = self._statuswords.pop(0) if len(self._statuswords) > 1 else self._statuswords[0]
        return self.shown

    def control(self, controlword: int) -> None:
        self.asked.append((states.decode(self.shown), controlword))


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(STATUSWORD, min_size=1, max_size=30),
    st.sampled_from(["enable", "acknowledge", "disable", "quick_stop", "halt"]),
)
def test_torque_is_asked_for_only_along_the_one_path(
    monkeypatch: pytest.MonkeyPatch, statuswords: list[int], wish: str
) -> None:
    monkeypatch.setattr(Cia402Axis, "transition_timeout", 0.0)
    monkeypatch.setattr(Cia402Axis, "reset_timeout", 0.0)
    whim = Whim(statuswords)
    axis = Cia402Axis(whim, HostWatch(60.0))
    refused = False
    try:
        axis.enable(threading.Event()) if wish == "enable" else getattr(axis, wish)()
    except DriveError:
        refused = True
    enabling = [state for state, word in whim.asked if word & 0x0F == Controlword.ENABLE_OPERATION]
    assert set(enabling) <= READY
    if wish not in ("enable", "halt"):
        assert not enabling
    resets = [state for state, word in whim.asked if word & Controlword.FAULT_RESET]
    assert set(resets) <= {PowerState.FAULT}
    assert not resets or wish == "acknowledge"
    if wish == "enable" and refused and whim.asked:
        assert whim.asked[-1][1] == Controlword.DISABLE_VOLTAGE
