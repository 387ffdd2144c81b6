"""The figures that identification is held to, on simulated campaigns whose truth only these tests read.

`pytest tests/numeric -s` prints them. Thresholds were set before the first run.
"""

import numpy as np
import pytest

from service.identification.estimates.estimate import RobotEstimate, identify
from simulator import true_inertia
from tests.numeric.campaign import AXES, SimulatedCampaign, measure


def _errors(estimate: RobotEstimate, campaign: SimulatedCampaign, joint: str) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors of our value and of the paper's formula, sweep by sweep."""
    axis = next(axis for axis in estimate.axes if axis.joint == joint)
    truth = campaign.truth(joint)
    ours = np.array([sweep.value for sweep in axis.sweeps]) / truth - 1
    paper = np.array([sweep.paper_value for sweep in axis.sweeps], dtype=float) / truth - 1
    return ours, paper


def test_rigid_and_noise_free() -> None:
    campaign = measure("max100-rigid", seed=7)
    estimate = identify(campaign.robot, campaign.spectra)
    workspace = np.random.default_rng(3).uniform([-3, -1.2, -2, 0, 0, 0], [3, 1.2, 1.2, 0, 0, 0], (200, 6))
    for joint in AXES:
        ours, _ = _errors(estimate, campaign, joint)
        model = estimate.identified(joint, workspace) / true_inertia(campaign.scenario, joint, workspace) - 1
        print(
            f"rigid {joint}: worst sweep {np.abs(ours).max():.1e}, worst over the workspace {np.abs(model).max():.1e}"
        )
        assert np.abs(ours).max() < 1e-4
        assert np.abs(model).max() < 1e-3


@pytest.mark.parametrize(("scenario", "factor"), [("max100-full", 1.0), ("max100-misfit", 2.0)])
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_full_scenario(scenario: str, factor: float, seed: int) -> None:
    campaign = measure(scenario, seed)
    estimate = identify(campaign.robot, campaign.spectra)
    for joint in AXES:
        ours, paper = _errors(estimate, campaign, joint)
        median, p95 = 100 * np.median(np.abs(ours)), 100 * np.quantile(np.abs(ours), 0.95)
        print(
            f"{scenario} seed {seed} {joint}: median {median:.2f} %, p95 {p95:.2f} %; "
            f"paper's formula: median {100 * np.median(np.abs(paper)):.2f} %, "
            f"p95 {100 * np.quantile(np.abs(paper), 0.95):.2f} %"
        )
        if joint != "joint_3":
            assert median <= 0.5 * factor
            assert p95 <= 1.5 * factor
        assert np.median(np.abs(ours)) < np.median(np.abs(paper))


def test_the_error_of_axis_3_is_the_stated_one() -> None:
    """Root mean square over five campaigns. That what is stated is the bound is in `test_cramer_rao`."""
    errors, stated = [], []
    for seed in range(21, 26):
        campaign = measure("max100-full", seed)
        estimate = identify(campaign.robot, campaign.spectra)
        (axis,) = (axis for axis in estimate.axes if axis.joint == "joint_3")
        errors.append(_errors(estimate, campaign, "joint_3")[0])
        stated.append(np.array([sweep.std for sweep in axis.sweeps]) / campaign.truth("joint_3"))
    error, std = (np.sqrt(np.mean(np.square(each))) for each in (errors, stated))
    print(f"axis 3: error {100 * error:.3f} %, stated {100 * std:.3f} %")
    assert error <= 1.2 * std
