"""An axis and a sweep as tests take them; each test changes what it is about."""

from typing import Any

from drivers.canopen.profile import CanopenAxis
from drivers.cia402.profile import IdentityProfile
from drivers.ports import SineCommand, SweepCommand, SweepMode


def axis(**changes: Any) -> CanopenAxis:
    fields: dict[str, Any] = {
        "joint": "joint_1",
        "node": 1,
        "identity": IdentityProfile(vendor=1, product=2, revision=3),
        "gear_ratio": 100.0,
        "rated_torque": 10.0,
        "position_limits": (-1.0, 1.0),
        "velocity_limit": 1.0,
        "effort_limit": 1000.0,
        "acceleration": 20.0,
        "quick_stop_deceleration": 50.0,
        "standstill_velocity": 1e-3,
    }
    return CanopenAxis(**(fields | changes))


def sweep(*sines: SineCommand, **changes: Any) -> SweepCommand:
    fields: dict[str, Any] = {
        "joint": "joint_1",
        "mode": SweepMode.DRIVE_SIDE,
        "offset_velocity": 0.0,
        "sines": sines or (SineCommand(2.0, 0.1, 0.0),),
        "period": 1.0,
        "periods": 2,
        "ramp": 0.2,
        "settle": 0.2,
        "sample_rate": 250.0,
        "velocity_limit": 0.5,
        "effort_limit": 1000.0,
        "position_window": (-0.5, 0.5),
    }
    return SweepCommand(**(fields | changes))
