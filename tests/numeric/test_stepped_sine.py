"""The initial analysis of a drive without torque injection: as planned, simulated, and held against the truth."""

import numpy as np
import pytest

from service.geometry.cell import read_cell
from service.identification import spectrum
from service.identification.estimates.initial_analysis import analyse
from service.planning.analysis.documents import AnalysisPlan, AnalysisRequest
from service.planning.analysis.plan import build_analysis_plan
from service.recording import Recording, Sweep
from simulator import SweepRun, load_scenario, run_sweeps, true_inertia
from tests.numeric.campaign import CONFIG, max100


def plan(joint: str) -> AnalysisPlan:
    request = AnalysisRequest(
        kind="analysis", robot_id=1, axes=(joint,), varied=("joint_2", "joint_3"), repeats=1, excitation="stepped_sine"
    )
    return build_analysis_plan(max100(), request, read_cell(CONFIG / "cells/workshop.yaml"))


@pytest.mark.parametrize("joint", ["joint_1", "joint_2"])
def test_resonance_and_stiffness(joint: str) -> None:
    robot, scenario = max100(), load_scenario(CONFIG / "scenarios/max100-full.yaml")
    planned = plan(joint).sweeps
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
        for sweep in planned
    ]
    recordings = [Recording(**columns) for columns in run_sweeps(scenario, runs, seed=3)]
    spectra = [
        spectrum(robot, Sweep(sweep.spec, recording)) for sweep, recording in zip(planned, recordings, strict=True)
    ]
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
