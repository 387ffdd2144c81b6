r"""The inertia about an axis that an estimate's document states, anywhere in the workspace.

With the estimate's base parameters beta, their covariance C and rows W of the poses (`service.identification.model`)

    J = W beta,   cov J = W C W^T
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from moves import STILL
from numpy.typing import NDArray

from service.errors import BadInput
from service.identification.model.base_parameters import base_parameters
from service.identification.model.regressor import lock
from service.robot import Robot

Array = NDArray[np.float64]
Json = Mapping[str, Any]

NO_SHARE = 1e-9  # of a row's largest entry: below, a parameter has no part in the inertia


def inertias(robot: Robot, estimate: Json, joint: str, poses: Array, place: str) -> tuple[Array, Array]:
    """Inertia (m,) of an axis at poses (m, n) and its covariance (m, m), as an estimate's document has them.

    BadInput, which begins with `place`, where the estimate has no such axis or leaves its inertia open at a pose.
    """
    if joint not in estimate["axes"]:
        raise BadInput(place, f"has not measured {joint}, but {', '.join(estimate['axes'])}")
    fixed = {robot.index(name): position for name, position in estimate["base"]["locked"].items()}
    free = [k for k in range(len(robot.joints)) if k not in fixed]
    for k, position in fixed.items():
        if np.abs(poses[:, k] - position).max() > STILL:
            raise BadInput(place, f"was measured with {robot.joints[k]} at {position:.4g} alone")
    chain = lock(robot.chain, fixed)
    measured = sorted(robot.index(name) for name in estimate["axes"])
    base = base_parameters(chain, tuple(free.index(k) for k in measured))
    told = estimate["base_parameters"]
    if tuple(one["name"] for one in told) != base.names:
        raise BadInput(place, f"has other base parameters than robot {robot.name}")
    rows = base.rows(chain, free.index(robot.index(joint)), poses[:, free])
    share = np.abs(rows).max(axis=0) > NO_SHARE * np.abs(rows).max()
    opened = [one["name"] for one, used in zip(told, share, strict=True) if used and one["std"] is None]
    if opened:
        raise BadInput(place, f"leaves the inertia of {joint} open there: {opened[0]}")
    covariance = np.array(estimate["base"]["covariance"], dtype=float)
    return rows @ np.array([one["value"] for one in told]), rows @ covariance @ rows.T
