"""Selection of the held-out sweeps by a rule that is independent of the results.

The sweeps of an axis are grouped by pose in the order of the bundle; every `EVERY`th pose is held out with all its
sweeps. Sweeps are of one pose if all other joints have the same position: the axis itself may start at either end.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from service.model.recording import SweepSpec

Array = NDArray[np.float64]

EVERY = 4
SAME_POSITION = 2e-3  # rad (m) of the other joints, as of an estimate
SAME_WAY = 0.1  # rad (m) of the axis itself: a sweep travels about 4 degrees, forward or backward


def poses_of(specs: Sequence[SweepSpec], own: int) -> list[list[SweepSpec]]:
    """The sweeps of joint number `own`, grouped by pose, in the order in which the poses first occur."""
    found: list[list[SweepSpec]] = []
    for spec in specs:
        same = next((pose for pose in found if _same(pose[0], spec, own)), None)
        if same is None:
            found.append([spec])
        else:
            same.append(spec)
    return found


def held_out(poses: Sequence[Sequence[SweepSpec]]) -> frozenset[str]:
    """The ids of the sweeps of every `EVERY`th pose."""
    return frozenset(spec.id for pose in poses[EVERY - 1 :: EVERY] for spec in pose)


def _same(one: SweepSpec, other: SweepSpec, own: int) -> bool:
    apart: Array = np.abs(np.subtract(one.pose, other.pose))
    limit = np.full(len(apart), SAME_POSITION)
    limit[own] = SAME_WAY
    return bool(np.all(apart < limit))
