"""True inertias of a virtual machine, used to score the identification. Never read by the service."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.rigid_body import RigidBody
from simulator.scenario import Scenario, ScenarioError, load_scenario

Array = NDArray[np.float64]


def true_inertia(scenario: Scenario, joint: str, poses: ArrayLike) -> Array:
    """Total inertia about a joint, including the motor inertia on the joint side, in poses (m, n): (m,) kg m^2."""
    poses = np.asarray(poses, dtype=float)
    if poses.ndim != 2 or poses.shape[1] != len(scenario.joints):
        raise ScenarioError(f"poses of shape {poses.shape} do not fit (m, {len(scenario.joints)})")
    if not np.isfinite(poses).all():
        raise ScenarioError("poses hold a number that is not finite")
    body, number = RigidBody(scenario), scenario.joints.index(joint)
    motor = scenario.driven(joint).train.motor_inertia * scenario.nominal(joint).gear_ratio ** 2
    return np.array([body.inertia(pose)[number] for pose in poses]) + motor


def truth(scenario_path: Path, poses: Sequence[Sequence[float]]) -> dict[str, list[float]]:
    """Total inertia of every joint with a drive, in every pose: {joint: [kg m^2, ...]}."""
    scenario = load_scenario(scenario_path)
    return {joint: true_inertia(scenario, joint, poses).tolist() for joint in scenario.axes}
