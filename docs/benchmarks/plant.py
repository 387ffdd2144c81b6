"""The virtual plant: simulated seconds per second of processor time, against MuJoCo stepped sweep by sweep."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, cast

import mujoco
import numpy as np
from numpy.typing import NDArray

from docs.benchmarks.measured import Measured, beside
from simulator import Scenario, SweepRun, run_sweeps
from simulator.scenario import STEP
from tests.numeric.campaign import max100, planned_at, scenario_named

Array = NDArray[np.float64]

_mujoco = cast(Any, mujoco)  # a binary module without type stubs

LEAST = 1000.0  # simulated seconds per second of processor time
BANDWIDTH = 2 * np.pi * 12.0  # 1/s, of the peer's speed control


def random_poses(count: int) -> Array:
    """Poses (m, 6) of axes 2 and 3."""
    rng, poses = np.random.default_rng(0), np.zeros((count, 6))
    poses[:, 1], poses[:, 2] = rng.uniform(-1.2, 1.2, count), rng.uniform(-2.0, 1.2, count)
    return poses


def stepped(scenario: Scenario, sweeps: Sequence[SweepRun]) -> float:
    """`mj_step` of the rigid six-axis arm for each sweep in turn, with P speed control of all joints; seconds of it."""
    model = _mujoco.MjModel.from_xml_string(max100().urdf_text)
    model.opt.timestep = STEP
    data, simulated = _mujoco.MjData(model), 0.0
    for sweep in sweeps:
        _mujoco.mj_resetData(model, data)
        data.qpos[:] = sweep.pose
        _mujoco.mj_forward(model, data)
        full = np.zeros((model.nv, model.nv))
        _mujoco.mj_fullM(model, data, full)
        gain, index = BANDWIDTH * np.diag(full), scenario.joints.index(sweep.axis)
        steps = round(sweep.waveform.duration / STEP)
        wanted, target = sweep.waveform.velocity(np.linspace(0.0, (steps - 1) * STEP, steps)), np.zeros(model.nv)
        for velocity in wanted:
            target[index] = velocity
            data.qfrc_applied[:] = data.qfrc_bias + gain * (target - data.qvel)
            _mujoco.mj_step(model, data)
        simulated += steps * STEP
    return simulated


def compared(poses: int, single: int, repeats: int, name: str, *, best: bool = False) -> Measured:
    scenario = scenario_named("max100-full")
    _, sweeps = planned_at(scenario, random_poses(poses))
    found = beside(lambda: len(run_sweeps(scenario, sweeps, 0)), lambda: stepped(scenario, sweeps[:single]), repeats)
    simulated = sum(sweep.waveform.duration for sweep in sweeps)
    told = found.as_measured(name, "MuJoCo stepped one sweep after the other", unit="s/s", amount=simulated, best=best)
    assert told.peer is not None
    note = "ours with elasticity, friction, cascade control and noise; MuJoCo's arm is rigid and free of friction"
    return replace(told, peer=told.peer * found.theirs / simulated, note=note)


def run() -> Iterator[Measured]:
    told = compared(300, 2, 3, "virtual plant, 900 sweeps at once: simulated seconds per second of processor time")
    yield replace(told, target=f">= {LEAST:g} s/s", met=told.ours >= LEAST)


def quick() -> Iterator[Measured]:
    yield compared(20, 1, 4, "virtual plant, 60 sweeps at once", best=True)
