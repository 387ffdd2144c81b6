"""Load encoder compared with motor encoder: a gear ratio, unit or sign that differs from the robot file.

Twist by gravity and transmission error are milliradians; relative to the travel of all poses they are below the limit.
"""

import numpy as np

from service.data_check.finding import Finding, named
from service.data_check.record import AxisRecords
from service.data_check.units import motion_unit


def load_encoder(axis: AxisRecords) -> list[Finding]:
    """Slope of load position over motor position, from all records with enough travel."""
    limit = 0.02  # relative
    records = axis.those(lambda record: record.travels and record.load_position is not None)
    motor = np.concatenate([record.position for record in records]) if records else np.zeros(0)
    load = np.concatenate([part for record in records if (part := record.load_position) is not None] or [np.zeros(0)])
    # 0.05 rad (m): with less travel, twist and transmission error dominate
    if not records or np.ptp(motor) < 0.05:
        return []
    away = motor - motor.mean()
    gain = float(away @ (load - load.mean())) / float(away @ away)
    if abs(gain - 1) <= limit:
        return []
    ids = tuple(record.id for record in records)
    unit = motion_unit(axis, gain, velocity=False)
    guess = f", as if one were in {unit}" if unit else ""
    return [
        Finding(
            "gear_ratio", "wrong", axis.joint, ids, gain, limit,
            f"{axis.joint}, {named(ids)}: the direct encoder moves {gain:.5g} times as far as the motor's{guess}, "
            f"limit 1 +- {limit:g}.",
            f"Check gear_ratio ({axis.axis.gear_ratio:g}), sign and unit of both encoders.",
        )
    ]  # fmt: skip
