"""A direct encoder on the joint makes the inertia independent of what the spring really does."""

from typing import Any

import numpy as np
import pytest

from service.identification.estimates.document import as_document
from service.identification.estimates.estimate import RobotEstimate, identify
from tests.numeric.campaign import AXES, SimulatedCampaign, measure


def _standardised(estimate: RobotEstimate, campaign: SimulatedCampaign, joint: str) -> np.ndarray:
    axis = next(axis for axis in estimate.axes if axis.joint == joint)
    return (axis.values - campaign.truth(joint)) / np.sqrt(np.diag(axis.covariance))


@pytest.mark.parametrize("scenario", ["max100-full", "max100-misfit"])
def test_no_spring_is_needed(scenario: str) -> None:
    """Hardening springs, LuGre friction and a late torque of max100-misfit included: unbiased, std honest."""
    campaign = measure(scenario, seed=11, direct_encoder=True)
    estimate = identify(campaign.robot, campaign.spectra)
    for joint in AXES:
        z = _standardised(estimate, campaign, joint)
        relative = 100 * np.array([s.value for a in estimate.axes if a.joint == joint for s in a.sweeps])
        error = relative / campaign.truth(joint) - 100
        print(
            f"{scenario} {joint}: bias {error.mean():+.3f} %, rms {np.sqrt(np.mean(error**2)):.3f} %, z {z.std():.2f}"
        )
        assert np.sqrt(np.mean(z**2)) < 1.5
        assert abs(error.mean()) < 0.4
    document: Any = as_document(estimate, estimate.workspace).as_json()
    assert document["suspect"] == []
    for joint in AXES:
        axis = document["axes"][joint]
        assert axis["load_motion"] == "direct_encoder"
        spring = campaign.scenario.driven(joint).train.spring
        assert spring is not None
        found = axis["drive_train"]["compliance"]
        # the spring comes out all the same, from the two encoders; the hardening one is stiffer than at rest
        tolerance = 4 * found["std"] + (0.1 / spring.stiffness if scenario == "max100-misfit" else 0.0)
        assert abs(found["value"] - 1 / spring.stiffness) < tolerance


def test_without_it_a_hardening_spring_misleads() -> None:
    """The same machine on motor encoders: axis 2 is off by twice as much, and the estimate notices from J = W beta."""
    errors, sizes = [], []
    for direct_encoder in (False, True):
        campaign = measure("max100-misfit", seed=11, direct_encoder=direct_encoder)
        estimate = identify(campaign.robot, campaign.spectra)
        axis = next(axis for axis in estimate.axes if axis.joint == "joint_2")
        errors.append(np.sqrt(np.mean((axis.values / campaign.truth("joint_2") - 1) ** 2)))
        sizes.append(np.sqrt(np.mean(_standardised(estimate, campaign, "joint_2") ** 2)))
    assert errors[0] > 2 * errors[1]
    assert max(sizes) < 1.5
