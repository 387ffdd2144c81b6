"""Bad sweeps are named and count less; what they would have done to the others does not happen."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.identification.estimates.document import as_document
from service.identification.estimates.estimate import RobotEstimate, identify
from service.identification.spectra.frequency_response import Spectrum, spectrum
from service.model import Sweep
from simulator import true_inertia
from tests.numeric.campaign import AXES, SimulatedCampaign, measure


@pytest.fixture(scope="module")
def campaign() -> SimulatedCampaign:
    return measure("max100-full", seed=17, poses=16)


def _identify(campaign: SimulatedCampaign, sweeps: list[Sweep]) -> RobotEstimate:
    spectra: list[Spectrum] = [spectrum(campaign.robot, sweep) for sweep in sweeps]
    return identify(campaign.robot, spectra)


def _worst(estimate: RobotEstimate, campaign: SimulatedCampaign) -> float:
    """Largest error of the identified inertias over poses, in standard deviations of the campaign without a fault."""
    poses = np.array([sweep.spec.pose for sweep in campaign.sweeps if sweep.spec.axis == "joint_1"])
    error = [estimate.identified(joint, poses) / true_inertia(campaign.scenario, joint, poses) - 1 for joint in AXES]
    return float(np.abs(error).max())


def test_sound_sweeps_are_not_suspected(campaign: SimulatedCampaign) -> None:
    estimate = _identify(campaign, list(campaign.sweeps))
    assert estimate.suspects == ()


def test_a_wrong_pose_is_named(campaign: SimulatedCampaign) -> None:
    """The operator's pose list slipped: joint_3 stood 23 deg from where the sweep of joint_1 says."""
    sound = _worst(_identify(campaign, list(campaign.sweeps)), campaign)
    sweeps = list(campaign.sweeps)
    spec = sweeps[5].spec
    pose = (*spec.pose[:2], spec.pose[2] + 0.4, *spec.pose[3:])
    sweeps[5] = replace(sweeps[5], spec=spec.model_copy(update={"pose": pose}))
    estimate = _identify(campaign, sweeps)
    told: Any = as_document(estimate, estimate.workspace).as_json()
    (suspect,) = told["suspect"]
    assert (suspect["axis"], suspect["sweep"]) == ("joint_1", spec.id)
    assert "standard deviations from that of the other sweeps in its pose" in suspect["why"]
    assert suspect["weight"] < 0.05
    assert _worst(estimate, campaign) < sound + 0.003


def test_a_torque_spike_is_named(campaign: SimulatedCampaign) -> None:
    """A short circuit brake, 8 ms at a third of the rated effort, in the middle of a window of joint_2."""
    sound = _worst(_identify(campaign, list(campaign.sweeps)), campaign)
    sweeps = list(campaign.sweeps)
    sweep = sweeps[20]
    effort = sweep.recording.effort.copy()
    effort[2600:2608] += 0.33 * campaign.robot.axis("joint_2").rated_effort
    sweeps[20] = replace(sweep, recording=replace(sweep.recording, effort=effort))
    estimate = _identify(campaign, sweeps)
    # the spike may also have moved the inertia of that sweep
    assert {(one.axis, one.sweep) for one in estimate.suspects} == {("joint_2", sweep.spec.id)}
    assert "its residual is" in estimate.suspects[0].why
    assert estimate.suspects[0].weight < 0.2
    assert _worst(estimate, campaign) < sound + 0.003


def test_held_out_poses_are_predicted_as_promised(campaign: SimulatedCampaign) -> None:
    estimate = _identify(campaign, list(campaign.sweeps))
    document: Any = as_document(estimate, estimate.workspace).as_json()
    z = np.concatenate([held_out.error / held_out.std for held_out in estimate.held_out.values()])
    # 48 sweeps, independent but for the parameters they share
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.4
    for joint in AXES:
        axis = document["axes"][joint]
        assert axis["held_out"]["sweeps"] == 16
        assert axis["held_out"]["rmse_percent"] < 3
        assert 1.0 < axis["cramer_rao"]["std_over_bound"] < 1.6
        assert axis["confidence_percent"] == axis["workspace_std_percent"]["worst"] < 3
        assert axis["reduced_chi_squared"] == pytest.approx(1, abs=0.9)
