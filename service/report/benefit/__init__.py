"""Benefit of an estimate: the drive torque of held-out sweeps, predicted by CAD and by the estimate.

Pure functions from recordings and robot file to `Benefit`, and its section of a report.
"""

from service.report.benefit.benefit import (
    AxisBenefit,
    Benefit,
    FollowingError,
    ModelBenefit,
    Tracking,
    benefit,
)
from service.report.benefit.prediction import feed_forward
from service.report.benefit.section import benefit_section, sentence

__all__ = [
    "AxisBenefit",
    "Benefit",
    "FollowingError",
    "ModelBenefit",
    "Tracking",
    "benefit",
    "benefit_section",
    "feed_forward",
    "sentence",
]
