"""No statusword, in whatever order, makes the power logic give torque to a drive that is not ready for it."""

import threading
from collections.abc import Sequence

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.cia402 import axis as power
from drivers.cia402 import states
from drivers.cia402.axis import Axis
from drivers.cia402.device import Mode, Motion
from drivers.cia402.host_watch import HostWatch
from drivers.cia402.profile import AxisProfile, IdentityProfile
from drivers.cia402.states import State
from drivers.errors import DriveError

pytestmark = pytest.mark.slow

PROFILE = AxisProfile(
    joint="joint_1",
    identity=IdentityProfile(vendor=1, product=2, revision=3),
    gear_ratio=100.0,
    rated_torque=10.0,
    position_limits=(-1.0, 1.0),
    velocity_limit=1.0,
    effort_limit=1000.0,
    acceleration=1.0,
    quick_stop_deceleration=4.0,
    standstill_velocity=1e-3,
)
READY = {State.SWITCHED_ON, State.OPERATION_ENABLED}
STATUSWORD = st.sampled_from([0x00, 0x40, 0x21, 0x23, 0x27, 0x07, 0x0F, 0x08, 0x60]) | st.integers(0, 0xFFFF)


class Whim:
    """A device that shows one statusword after the other, whatever it is told; the last one stays."""

    profile = PROFILE
    place = "joint_1 (whim)"
    emergency_stop_codes: tuple[int, ...] = ()

    def __init__(self, statuswords: Sequence[int]) -> None:
        self._statuswords = list(statuswords)
        self.shown = statuswords[0]
        self.told: list[tuple[State, int]] = []  # state shown last, controlword

    def statusword(self) -> int:
        self.shown = self._statuswords.pop(0) if len(self._statuswords) > 1 else self._statuswords[0]
        return self.shown

    def control(self, controlword: int) -> None:
        self.told.append((states.decode(self.shown), controlword))

    def motion(self) -> Motion:
        return Motion(0.0, 0.0, 0.0)

    def set_mode(self, mode: Mode) -> None: ...

    def hold_target(self) -> None: ...

    def allow_motion(self) -> None: ...

    def forbid_motion(self) -> None: ...

    def check_alive(self) -> None: ...

    def look_for_restart(self) -> None:
        pass

    def announced_error(self) -> int | None:
        return None

    def forget_error(self) -> None: ...

    def error_code(self) -> int:
        return 0x1234

    def error_text(self, code: int) -> str:
        return f"error {code:04X}h"


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(STATUSWORD, min_size=1, max_size=30),
    st.sampled_from(["enable", "acknowledge", "disable", "quick_stop", "halt"]),
)
def test_torque_is_asked_for_only_along_the_one_path(
    monkeypatch: pytest.MonkeyPatch, statuswords: list[int], wish: str
) -> None:
    monkeypatch.setattr(power, "TRANSITION_TIMEOUT", 0.0)
    monkeypatch.setattr(power, "RESET_TIMEOUT", 0.0)
    whim = Whim(statuswords)
    axis = Axis(whim, HostWatch(60.0))  # pyright: ignore[reportArgumentType]
    refused = False
    try:
        axis.enable(threading.Event()) if wish == "enable" else getattr(axis, wish)()
    except DriveError:
        refused = True
    enabling = [state for state, word in whim.told if word & 0x0F == states.ENABLE_OPERATION]
    assert set(enabling) <= READY
    if wish not in ("enable", "halt"):
        assert not enabling
    resets = [state for state, word in whim.told if word & states.FAULT_RESET]
    assert set(resets) <= {State.FAULT}
    assert not resets or wish == "acknowledge"
    if wish == "enable" and refused and whim.told:
        assert whim.told[-1][1] == states.DISABLE_VOLTAGE
