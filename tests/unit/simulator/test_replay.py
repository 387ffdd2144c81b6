"""Replay gives back the torque of the closed loop from the motor's motion alone."""

from collections.abc import Callable

import numpy as np
import pytest

from simulator import Motion, Scenario, SweepRun, replay, run_sweeps
from simulator.moving_axis import moving_axis
from simulator.rigid_body import RigidBody


@pytest.mark.parametrize(("name", "rms"), [("rigid", 1e-3), ("full", 0.06), ("misfit", 0.06)])
def test_replay_reproduces_the_torque(
    noise_free: Callable[[str], Scenario], sweep: Callable[..., SweepRun], name: str, rms: float
) -> None:
    scenario = noise_free(name)
    body = RigidBody(scenario)
    runs = [sweep(f"joint_{k}", sample_rate=rate, periods=k) for k in (1, 2, 3) for rate in (1000.0, 250.0)]
    recorded = run_sweeps(scenario, runs, seed=1)
    axes = [moving_axis(scenario, body, run.axis, run.pose) for run in runs]
    motions = [Motion(columns["time"], columns["position"], columns["velocity"]) for columns in recorded]
    for run, columns, effort in zip(runs, recorded, replay(axes, motions), strict=True):
        start = run.waveform.measure_from
        inside = (columns["time"] >= start) & (columns["time"] < start + run.period * run.periods)
        assert columns["effort"][inside].std() > 5.0
        assert np.sqrt(np.mean((effort - columns["effort"])[inside] ** 2)) < rms


def test_nothing_in_nothing_out() -> None:
    assert replay([], []) == []
