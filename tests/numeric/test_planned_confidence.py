"""The confidence that a plan predicts against the one that the estimate of its sweeps states."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from service.campaigns.plan import PlanDocument, PlanRequest, build_plan
from service.cell import read_cell
from service.estimation import estimate_document
from service.identification import spectrum
from service.recording import Recording, Sweep
from simulator import SweepRun, load_scenario, run_sweeps
from tests.numeric.campaign import AXES, CONFIG, max100


@pytest.fixture(scope="module")
def plan() -> PlanDocument:
    request = PlanRequest(robot_id=1, axes=AXES, varied=AXES[1:], poses=24)
    return build_plan(max100(), request, read_cell(CONFIG / "cells/workshop.yaml"))


def stated(plan: PlanDocument, direct_encoder: bool) -> float:
    """Largest standard deviation of J over the workspace that the estimate states, percent."""
    runs = [
        SweepRun(
            axis=sweep.spec.axis,
            pose=sweep.spec.pose,
            offset_velocity=sweep.spec.offset_velocity,
            sines=tuple((sine.frequency, sine.amplitude, sine.phase) for sine in sweep.spec.sines),
            period=sweep.spec.period or 0.0,
            periods=sweep.spec.periods or 0,
            ramp=sweep.ramp,
            settle=sweep.settle,
            sample_rate=sweep.spec.sample_rate,
        )
        for sweep in plan.sweeps
    ]
    recordings = [
        Recording(**columns) for columns in run_sweeps(load_scenario(CONFIG / "scenarios/max100-full.yaml"), runs, 3)
    ]
    if not direct_encoder:
        recordings = [replace(one, load_position=None, load_velocity=None) for one in recordings]
    robot = max100()
    sweeps = [Sweep(planned.spec, recording) for planned, recording in zip(plan.sweeps, recordings, strict=True)]
    document = estimate_document(robot, [spectrum(robot, sweep) for sweep in sweeps])
    return max(document["axes"][joint]["confidence_percent"] for joint in AXES)


@pytest.mark.parametrize("direct_encoder", [False, True])
def test_the_prediction_is_on_the_careful_side_and_near(plan: PlanDocument, direct_encoder: bool) -> None:
    predicted, found = plan.confidence[-1], stated(plan, direct_encoder)
    assert predicted is not None
    print(f"predicted {predicted:.3f} %, stated {found:.3f} %")
    assert 1.0 < predicted / found < 2.0


def test_confidence_falls_about_as_the_root_of_the_number_of_poses(plan: PlanDocument) -> None:
    told = [(n, percent) for n, percent in enumerate(plan.confidence, 1) if percent is not None]
    assert len(told) >= 15
    assert all(after <= before for (_, before), (_, after) in pairwise(told))
    slope = np.polyfit(*np.log(told).T, 1)[0]
    assert -1.5 < slope < -0.3
