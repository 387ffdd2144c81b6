"""Estimates without a campaign: the document that a perfect identification of a random or given truth would make."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.model import INERTIAL_NAMES, Axis, Robot, RobotDescription, build_robot
from service.model.configuration import read_robot
from tests.random_chain import random_urdf

CONFIG = Path(__file__).parents[4] / "config"


@pytest.fixture
def max100() -> Robot:
    return read_robot(CONFIG / "robots/max100-class.yaml")


@pytest.fixture
def random_robot() -> Callable[[int], Robot]:
    """By seed: 3 to 7 axes, revolute and prismatic, with links fixed in between."""

    def build(seed: int) -> Robot:
        rng = np.random.default_rng(seed)
        count = int(rng.integers(3, 8))
        axes = tuple(
            Axis(joint=f"joint_{k}", gear_ratio=100.0, motor_inertia=rng.uniform(1e-4, 1e-3), rated_effort=1e3)
            for k in range(1, count + 1)
        )
        return build_robot(RobotDescription(name=f"random {seed}", urdf="r.urdf", axes=axes), random_urdf(rng, count))

    return build


def estimate_of(robot: Robot, links: np.ndarray, motors: np.ndarray) -> dict[str, Any]:
    """What `sweepid identify --json` would hold of links (n, 10) and motors (n,); the first axis was measured."""
    joints = robot.chain.joints
    sweep = {"sweep": "1", "value": 9.0, "std": 0.1, "reference": 9.0, "identified": 9.0, "paper_value": None}
    rmse = dict.fromkeys(("reference_measured", "identified_measured", "reference_identified"), 1.0)
    sweeps = [sweep | {"viscous_friction": friction} for friction in (150.0, 151.0)]
    return {
        "axes": {robot.joints[0]: {"inertia": sweeps, "rmse_percent": rmse}},
        "condition_number": 3.0,
        "base_parameters": [{"name": "m(a)", "symbolic": "m(a)", "value": 1.0, "std": None}],
        "symbols": {"l1": {"value": 0.5, "unit": "m", "meaning": "from a to b"}},
        "standard_parameters": {
            "links": {
                joint.link: dict(zip(INERTIAL_NAMES, link.tolist(), strict=True))
                for joint, link in zip(joints, links, strict=True)
            },
            "motor_inertias": {f"Jm({joint.name})": float(m) for joint, m in zip(joints, motors, strict=True)},
        },
        "physical": {"deviation_in_std": 0.0},
    }
