"""What an estimate is worth on machines whose truth is known: the virtual one, and one of a plant that is not ours."""

import json
from pathlib import Path

import numpy as np
import pytest

from service.report.benefit.benefit import AxisBenefit, benefit, feed_forward
from service.store.files.bundle import read_bundle
from simulator.follow import Path as Wanted, follow
from tests.numeric.campaign import AXES, SimulatedCampaign, measure


@pytest.fixture(scope="module")
def campaign() -> SimulatedCampaign:
    return measure("max100-full", seed=5, poses=16)


@pytest.fixture(scope="module")
def axes(campaign: SimulatedCampaign) -> dict[str, AxisBenefit]:
    return dict(benefit(campaign.robot, campaign.sweeps).axes)


@pytest.mark.parametrize("joint", AXES)
def test_the_virtual_machine(joint: str, axes: dict[str, AxisBenefit]) -> None:
    axis = axes[joint]
    assert axis.lines_ratio > 2.5
    assert axis.identified.left_percent < 5 < axis.cad.left_percent
    assert axis.identified.inertia_percent.value < 1.5 < 5 < axis.cad.inertia_percent.value
    assert axis.smallest_ratio > 1.1


@pytest.mark.parametrize("number", ["03", "05"])
def test_a_machine_of_another_plant(number: str, shared: Path) -> None:
    bundle = read_bundle(shared / "data/foreign" / number)
    (axis,) = benefit(bundle.robot, bundle.sweeps).axes.values()
    assert axis.held_out_poses == 1
    truth = json.loads((shared / "data/foreign/truth.json").read_text())[number]
    true = dict(zip((sweep.spec.id for sweep in bundle.sweeps), truth["J_true"], strict=True))
    assert axis.lines_ratio > 1.3
    assert axis.identified.inertia_error < 0.02 * true[axis.held_out[0]]
    assert axis.identified.effort_rms < axis.cad.effort_rms


def test_the_same_path_is_kept_more_closely_with_the_estimate(campaign: SimulatedCampaign) -> None:
    fed = feed_forward(campaign.robot, campaign.sweeps)
    path = Wanted(fed.motion.position, fed.motion.velocity)
    errors = [follow(campaign.scenario, path, 10.0, effort) for effort in (fed.cad, fed.identified)]
    cad, own = (np.array([np.sqrt(np.mean(one[joint] ** 2)) for joint in AXES]) for one in errors)
    assert (own < cad).sum() >= 2
    assert np.mean(cad / own) > 1.2
    assert max(own) < 2e-4  # rad
