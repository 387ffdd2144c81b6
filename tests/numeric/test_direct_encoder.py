"""A direct encoder on the joint makes the inertia independent of what the spring really does."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.identification.estimates.document import as_document
from service.identification.estimates.estimate import RobotEstimate, identify
from tests.numeric.campaign import AXES, SimulatedCampaign, measure


def _off(estimate: RobotEstimate, campaign: SimulatedCampaign, joint: str) -> tuple[np.ndarray, np.ndarray]:
    """Error of J, percent and in standard deviations."""
    axis = next(axis for axis in estimate.axes if axis.joint == joint)
    error = axis.values - campaign.truth(joint)
    return 100 * error / campaign.truth(joint), error / np.sqrt(np.diag(axis.covariance))


@pytest.mark.parametrize("scenario", ["max100-full", "max100-misfit"])
def test_no_spring_is_needed(scenario: str) -> None:
    """Hardening springs, LuGre friction and a late torque of max100-misfit included: unbiased, std honest.

    Of the same sweeps on motor encoders alone axis 2 is off by twice as much there, and the estimate notices from
    J = W beta.
    """
    campaign = measure(scenario, seed=11, direct_encoder=True)
    estimate = identify(campaign.robot, campaign.spectra)
    document: Any = as_document(estimate, estimate.workspace).as_json()
    assert document["suspect"] == []
    for joint in AXES:
        error, z = _off(estimate, campaign, joint)
        print(f"{scenario} {joint}: bias {error.mean():+.3f} %, rms {error.std():.3f} %, z {z.std():.2f}")
        assert np.sqrt(np.mean(z**2)) < 1.5
        assert abs(error.mean()) < 0.4
        axis = document["axes"][joint]
        assert axis["load_motion"] == "direct_encoder"
        spring = campaign.scenario.driven(joint).train.spring
        assert spring is not None
        found = axis["drive_train"]["compliance"]
        # the spring comes out all the same, from the two encoders; the hardening one is stiffer than at rest
        tolerance = 4 * found["std"] + (0.1 / spring.stiffness if scenario == "max100-misfit" else 0.0)
        assert abs(found["value"] - 1 / spring.stiffness) < tolerance
    if scenario == "max100-misfit":
        alone = [replace(one, load_velocity=None) for one in campaign.spectra]
        misled, z = _off(identify(campaign.robot, alone), campaign, "joint_2")
        assert np.sqrt(np.mean(misled**2)) > 2 * np.sqrt(np.mean(_off(estimate, campaign, "joint_2")[0] ** 2))
        assert np.sqrt(np.mean(z**2)) < 1.5
