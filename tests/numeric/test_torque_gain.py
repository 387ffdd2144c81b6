"""A known mass bolted on calibrates the torque constants; then every inertia is known in true units."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service import BadInput
from service.identification.estimates.document import as_document
from service.identification.estimates.estimate import identify
from service.identification.estimates.torque_gain import KnownMass, torque_gains
from service.identification.spectra.frequency_response import Spectrum, spectrum
from simulator import LinkDeviation
from simulator.scenario import AddedBody
from tests.numeric.campaign import AXES, SimulatedCampaign, measure_at, scenario_named

GAINS = {"joint_1": 1.05, "joint_2": 0.95, "joint_3": 1.04}
MASS, LENGTH, RADIUS = 60.0, 0.25, 0.14  # a round steel bar along x, from the flange on
ACROSS, ALONG = MASS * (3 * RADIUS**2 + LENGTH**2) / 12, MASS * RADIUS**2 / 2


def _told(campaign: SimulatedCampaign) -> list[Spectrum]:
    """Spectra with the effort that drives of wrong torque constants tell."""
    return [
        spectrum(
            campaign.robot,
            replace(sweep, recording=replace(sweep.recording, effort=GAINS[sweep.spec.axis] * sweep.recording.effort)),
        )
        for sweep in campaign.sweeps
    ]


def test_a_test_mass_calibrates_the_torque() -> None:
    rng = np.random.default_rng(9)
    poses = np.zeros((12, 6))
    poses[:, 1], poses[:, 2] = rng.uniform(-1.2, 1.2, 12), rng.uniform(-2.0, 1.2, 12)
    bare = scenario_named("max100-full")
    bar = AddedBody(name="test mass", mass=MASS, start=(0.1, 0, 0), end=(0.1 + LENGTH, 0, 0), radius=RADIUS)
    loaded = bare.model_copy(update={"links": {**bare.links, "link_6": LinkDeviation(added=(bar,))}})
    before, after = measure_at(bare, 3, poses), measure_at(loaded, 4, poses)
    mass = KnownMass(MASS, (0.1 + LENGTH / 2, 0.0, 0.0), (ALONG, 0.0, ACROSS, 0.0, 0.0, ACROSS))
    robot, told = before.robot, _told(before)
    found = torque_gains(robot, told, _told(after), mass)
    for joint in AXES:
        gain = found[joint].gain
        print(f"{joint}: gain {gain.gain:.4f} +- {gain.std:.4f}, true {GAINS[joint]}")
        assert abs(gain.gain - GAINS[joint]) < 3.5 * gain.std
        assert gain.std < 0.01
        assert found[joint].poses == 12

    gains = {joint: one.gain for joint, one in found.items()}
    wrong, right = identify(robot, told), identify(robot, told, gains=gains)
    document: Any = as_document(right, right.workspace).as_json()
    for axis, known in zip(wrong.axes, right.axes, strict=True):
        truth = before.truth(axis.joint)
        assert np.median(np.abs(axis.values / truth - 1)) > 0.03
        assert np.median(np.abs(known.values / truth - 1)) < 0.01
        total = np.array([sweep.std_total for sweep in known.sweeps])
        assert (total < 0.4 * np.array([sweep.std_total for sweep in axis.sweeps])).all()
        assert np.sqrt(np.mean(((known.values - truth) / total) ** 2)) < 1.6
        assert document["axes"][axis.joint]["torque_gain"] == {
            "value": gains[axis.joint].gain,
            "std": gains[axis.joint].std,
        }


def test_other_poses_do_not_calibrate() -> None:
    campaign = measure_at(scenario_named("max100-full"), 3, np.zeros((1, 6)), axes=("joint_1",))
    moved = campaign.sweeps[0]
    spec = moved.spec.model_copy(update={"pose": (0.0, 0.1, 0, 0, 0, 0)})
    before, after = (spectrum(campaign.robot, one) for one in (moved, replace(moved, spec=spec)))
    with pytest.raises(BadInput, match="no axis was swept in the same pose before and after"):
        torque_gains(campaign.robot, [before], [after], KnownMass(10.0, (0.1, 0, 0)))
    with pytest.raises(BadInput, match="mass"):
        torque_gains(campaign.robot, [before], [before], KnownMass(0.0, (0.1, 0, 0)))
