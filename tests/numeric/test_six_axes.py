"""Six axes of the simulated machine, small: sweeps and one trajectory predict another one and find the true robot.

The full size is told in docs/how-to/six-axes.md.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sweepid
from service.identification.design.exciting_trajectory import TrajectoryShape
from service.identification.estimates.combination import JointEstimate, combine, inertias_of
from service.identification.estimates.estimate import identify
from service.model import Robot, Sweep
from service.store.files.bundle import read_bundle, write_bundle
from simulator import Scenario, load_scenario, true_inertia
from tests.numeric.campaign import CONFIG, max100
from tests.numeric.six_axes import (
    design,
    deviation,
    free_poses,
    measure_sweeps,
    measure_trajectories,
    prediction,
    records,
)

SHAPE = TrajectoryShape(period=3.0, harmonics=5, periods=2, ramp=0.5, settle=0.5)


@dataclass(frozen=True)
class Measured:
    robot: Robot
    scenario: Scenario
    sweeps: list[Sweep]
    trajectories: list[list[Sweep]]
    both: JointEstimate


@pytest.fixture(scope="module")
def measured() -> Measured:
    robot, scenario = max100(), load_scenario(CONFIG / "scenarios" / "max100-six.yaml")
    sweeps, spectra = measure_sweeps(robot, scenario, free_poses(robot, np.random.default_rng(1), 10), seed=1)
    runs = [design(robot, SHAPE, seed, restarts=6, steps=20) for seed in (1, 2)]
    trajectories = measure_trajectories(robot, scenario, runs, seed=1)
    both = combine(robot, inertias_of(identify(robot, spectra)), records(robot, trajectories[:1]))
    return Measured(robot, scenario, sweeps, trajectories, both)


def test_another_trajectory_is_predicted(measured: Measured) -> None:
    (other,) = records(measured.robot, measured.trajectories[1:])
    for joint, (whole, low) in prediction(measured.both, other, measured.trajectories[1]).items():
        assert whole < 2.0, joint
        assert low < 1.2, joint


def test_most_parameters_are_identified_and_their_spread_is_honest(measured: Measured) -> None:
    parameters = measured.both.parameters
    assert len(parameters) == 58
    assert sum(parameter.identified for parameter in parameters) > 40
    assert all(parameter.reason for parameter in parameters if not parameter.identified)
    assert np.sqrt(np.mean(deviation(measured.both, measured.scenario) ** 2)) < 1.6
    for parameter in parameters:
        alone = min(std or np.inf for std in (parameter.std_sweeps, parameter.std_trajectories))
        assert (parameter.std or np.inf) <= alone * (1 + 1e-6)


def test_the_combination_knows_every_axis_inertia(measured: Measured) -> None:
    grid = free_poses(measured.robot, np.random.default_rng(3), 100)
    for joint, percent in zip(measured.robot.joints, (1.0, 0.5, 1.0, 3.0, 3.0, 5.0), strict=True):
        true = true_inertia(measured.scenario, joint, grid)
        error = 100 * (measured.both.inertia(joint, grid) / true - 1)
        assert np.sqrt(np.mean(error**2)) < percent, joint


def test_a_bundle_with_trajectories_is_identified_by_both(measured: Measured, tmp_path: Path) -> None:
    few = [sweep for sweep in measured.sweeps if sweep.spec.axis in ("joint_2", "joint_6")]
    write_bundle(tmp_path / "b", measured.robot, [*few, *measured.trajectories[0]])
    bundle = read_bundle(tmp_path / "b")
    document: Any = sweepid.identify(bundle).as_json()
    assert set(document["axes"]) == {"joint_2", "joint_6"}
    assert [len(sweeps) for sweeps in document["combination"]["trajectories"]] == [6]
    found = {parameter["name"]: parameter for parameter in document["combination"]["base_parameters"]}
    assert found["Fc(joint_2)"]["value"] == pytest.approx(155, rel=0.02)
    assert found["Fc(joint_2)"]["source"] == "trajectories"
    assert sweepid.identify(bundle, "joint_2").as_json()["combination"] is None
