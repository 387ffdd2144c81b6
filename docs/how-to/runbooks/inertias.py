"""The inertia about an axis from the document of an estimate, anywhere in the workspace."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.formats.export.sheets.inertias import of_estimate
from service.model import Robot
from service.model.results.estimate import Estimate

Array = NDArray[np.float64]
Json = Mapping[str, Any]


def inertia_unit(robot: Robot, joint: str) -> str:
    """Unit of the inertia of an axis: kg for a linear axis, else kg m2."""
    return "kg" if robot.chain.joints[robot.joints.index(joint)].kind == "prismatic" else "kg m2"


def inertias(robot: Robot, estimate: Json, joint: str, poses: Array, place: str) -> tuple[Array, Array]:
    """Inertia (m,) of an axis at poses (m, n) and its covariance (m, m), from the document of an estimate; SI.

    BadInput, which begins with `place`, if the estimate has no such axis or no inertia for a pose.
    """
    known = of_estimate(robot, Estimate.read(estimate, place), place)
    rows = known.rows(joint, poses)
    return rows @ known.values, rows @ known.covariance @ rows.T
