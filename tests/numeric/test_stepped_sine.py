"""The initial analysis of a drive without torque injection: as planned, simulated, and held against the truth."""

import numpy as np
import pytest

from service.identification.estimates.initial_analysis import analyse
from service.identification.spectra.frequency_response import spectrum
from service.model.configuration import read_cell
from service.planning.analysis import build_analysis_plan
from service.planning.documents import AnalysisPlan, AnalysisRequest
from simulator import true_inertia
from tests.numeric.campaign import CONFIG, max100, run_plan, scenario_named


def plan(joint: str) -> AnalysisPlan:
    request = AnalysisRequest(
        kind="analysis", robot_id=1, axes=(joint,), varied=("joint_2", "joint_3"), repeats=1, excitation="stepped_sine"
    )
    return build_analysis_plan(max100(), request, read_cell(CONFIG / "cells/workshop.yaml"))


@pytest.mark.parametrize("joint", ["joint_1", "joint_2"])
def test_resonance_and_stiffness(joint: str) -> None:
    robot, scenario = max100(), scenario_named("max100-full")
    sweeps = run_plan(scenario, plan(joint).sweeps, seed=3, direct_encoder=True)
    spectra = [spectrum(robot, sweep) for sweep in sweeps]
    analysis = analyse(robot, [], spectra)[joint]
    train = scenario.driven(joint).train
    assert train.spring is not None
    truth = np.array([train.motor_inertia * robot.axis(joint).gear_ratio ** 2, 1 / train.spring.stiffness])
    off = (analysis.mean[[0, 3]] - truth) / np.sqrt(np.diag(analysis.covariance)[[0, 3]])
    print(f"{joint} stepped sine: motor inertia and compliance off by {off.round(2)} standard deviations")
    assert len(analysis.poses) == 6
    assert np.abs(off).max() < 3.5
    assert np.abs(analysis.mean[[0, 3]] / truth - 1).max() < 0.1
    for pose in analysis.poses:
        inertia = true_inertia(scenario, joint, [pose.pose])[0]
        resonance = 1 / (2 * np.pi * np.sqrt(truth[1] * (inertia - truth[0])))
        print(
            f"{joint} J {inertia:.0f}: locked rotor {pose.fit.locked_rotor.value:.2f} +- "
            f"{pose.fit.locked_rotor.std:.2f} Hz, truth {resonance:.2f}, "
            f"asymptotes {pose.asymptotes.locked_rotor.value:.2f}"
        )
        assert abs(pose.fit.locked_rotor.value / resonance - 1) < 0.02
        assert abs(pose.asymptotes.locked_rotor.value - resonance) < 1.0
