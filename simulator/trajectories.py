"""Trajectories of a scenario: several axes of one robot swept together, in closed loop, with coupled links."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.coupled import CoupledTrains
from simulator.noise import measure
from simulator.plant import Plant
from simulator.scenario import CYCLE, STEP, Scenario, ScenarioError
from simulator.sweeps import SweepRun

Array = NDArray[np.float64]


def run_trajectories(
    scenario: Scenario, trajectories: Sequence[Sequence[SweepRun]], seed: int
) -> list[list[dict[str, Array]]]:
    """Columns of every sweep of every trajectory as in `run_sweeps`.

    A trajectory consists of the sweeps of its axes: one pose, one duration and one sample rate, each axis once. All
    other axes stand with closed brakes. Raises ScenarioError if the sweeps do not belong together.
    """
    streams = np.random.SeedSequence(seed).spawn(len(trajectories))
    return [_run(scenario, sweeps, stream) for sweeps, stream in zip(trajectories, streams, strict=True)]


def _run(scenario: Scenario, sweeps: Sequence[SweepRun], stream: np.random.SeedSequence) -> list[dict[str, Array]]:
    block = _check(scenario, sweeps)
    cycles = round(sweeps[0].waveform.duration / CYCLE) // block * block
    trains = CoupledTrains(scenario, STEP)
    trains.stand(np.array(sweeps[0].pose))
    driven = [scenario.driven(joint) for joint in trains.joints]
    plant = Plant(trains.axes, [axis.control for axis in driven], scenario.measurement)
    plant.trains = trains
    end_of_cycle = np.linspace(CYCLE, CYCLE * cycles, cycles)
    setpoints = np.zeros((cycles, len(driven)))
    rows = [trains.joints.index(sweep.axis) for sweep in sweeps]
    for row, sweep in zip(rows, sweeps, strict=True):
        setpoints[:, row] = sweep.waveform.velocity(end_of_cycle)
        plant.release(row)
    rated = np.array([scenario.nominal(joint).rated_effort for joint in trains.joints])
    random = [np.random.default_rng(child) for child in stream.spawn(len(driven))]
    samples = measure(plant.advance(setpoints), scenario.measurement, rated, random)
    recordings: list[dict[str, Array]] = []
    for row in rows:
        names = ["effort", "velocity", "position", "velocity_setpoint"]
        if driven[row].load_encoder:
            names += ["load_position", "load_velocity"]
        columns = {"time": np.arange(cycles // block) / sweeps[0].sample_rate}
        for name in names:
            channel: Array = getattr(samples, name)
            columns[name] = channel[:, row].reshape(-1, block).mean(axis=1)
        recordings.append(columns)
    return recordings


def _check(scenario: Scenario, sweeps: Sequence[SweepRun]) -> int:
    """Cycles per sample. Raises ScenarioError unless the sweeps are one trajectory."""
    if not sweeps:
        raise ScenarioError("a trajectory needs at least one axis")
    first = sweeps[0]
    for sweep in sweeps:
        scenario.driven(sweep.axis)
        if (sweep.pose, sweep.waveform.duration, sweep.sample_rate) != (
            first.pose,
            first.waveform.duration,
            first.sample_rate,
        ):
            raise ScenarioError(f"{sweep.axis}: pose, duration or sample rate differ from {first.axis}'s")
    if len({sweep.axis for sweep in sweeps}) < len(sweeps):
        raise ScenarioError("an axis is listed twice in a trajectory")
    if len(first.pose) != len(scenario.joints):
        raise ScenarioError(f"pose has {len(first.pose)} positions, the robot {len(scenario.joints)} joints")
    block = round(1 / (CYCLE * first.sample_rate))
    if block < 1 or abs(block * CYCLE * first.sample_rate - 1) > 1e-9:
        raise ScenarioError(f"sample rate {first.sample_rate} Hz is not {1 / CYCLE:g} Hz over a whole number")
    return block
