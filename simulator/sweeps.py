"""Sweeps of a scenario in closed loop, all in one vectorised pass: the recordings a real machine would give."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.moving_axis import moving_axis
from simulator.noise import measure
from simulator.plant import Plant, Samples
from simulator.rigid_body import RigidBody
from simulator.scenario import CYCLE, Scenario, ScenarioError
from simulator.waveform import Waveform

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SweepRun:
    """One sweep of one axis from standstill at `pose` (all joints, rad): the fields of `Waveform` and the rate."""

    axis: str
    pose: tuple[float, ...]
    offset_velocity: float  # rad/s, signed
    sines: tuple[tuple[float, float, float], ...]  # (frequency Hz, amplitude rad/s, phase rad)
    period: float  # s
    periods: int
    ramp: float  # s
    settle: float  # s
    sample_rate: float = 1000.0  # Hz; 1000 divided by a whole number

    @property
    def waveform(self) -> Waveform:
        return Waveform(self.offset_velocity, self.sines, self.period, self.periods, self.ramp, self.settle)

    @property
    def decimation(self) -> int:
        """Cycles averaged into one sample."""
        return round(1 / (CYCLE * self.sample_rate))


def run_sweeps(scenario: Scenario, sweeps: Sequence[SweepRun], seed: int) -> list[dict[str, Array]]:
    """Columns of every sweep as in a bundle: time, effort, velocity, position, velocity_setpoint and load_*.

    A sample is the mean over its cycle for all channels alike; `time` is sample number / rate, so the cycle's middle
    lies half a sample later. Sweep i draws noise from child i of the seed. ScenarioError where a sweep does not fit.
    """
    if not sweeps:
        return []
    body = RigidBody(scenario)
    plant = Plant(
        [moving_axis(scenario, body, sweep.axis, sweep.pose) for sweep in sweeps],
        [scenario.driven(sweep.axis).control for sweep in sweeps],
        scenario.measurement,
    )
    cycles = [_cycles(sweep) for sweep in sweeps]
    end_of_cycle = np.linspace(CYCLE, CYCLE * max(cycles), max(cycles))
    setpoints = np.stack([sweep.waveform.velocity(end_of_cycle) for sweep in sweeps], axis=1)
    plant.trains.position[:] = [sweep.pose[scenario.joints.index(sweep.axis)] for sweep in sweeps]
    for row in range(len(sweeps)):
        plant.release(row)
    random = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(len(sweeps))]
    rated = np.array([scenario.nominal(sweep.axis).rated_effort for sweep in sweeps])
    samples = measure(plant.advance(setpoints), scenario.measurement, rated, random)
    return [
        _columns(samples, row, cycles[row], sweep, scenario.driven(sweep.axis).load_encoder)
        for row, sweep in enumerate(sweeps)
    ]


def _cycles(sweep: SweepRun) -> int:
    """Whole samples that fit, in cycles."""
    block = sweep.decimation
    if block < 1 or abs(block * CYCLE * sweep.sample_rate - 1) > 1e-9:
        raise ScenarioError(
            f"{sweep.axis}: sample rate {sweep.sample_rate} Hz is not {1 / CYCLE:g} Hz over a whole number"
        )
    cycles = round(sweep.waveform.duration / CYCLE) // block * block
    if cycles == 0:
        raise ScenarioError(f"{sweep.axis}: sweep of {sweep.waveform.duration} s has no sample")
    return cycles


def _columns(samples: Samples, row: int, cycles: int, sweep: SweepRun, load_encoder: bool) -> dict[str, Array]:
    names = ["effort", "velocity", "position", "velocity_setpoint"]
    if load_encoder:
        names += ["load_position", "load_velocity"]
    columns = {"time": np.arange(cycles // sweep.decimation) / sweep.sample_rate}
    for name in names:
        channel: Array = getattr(samples, name)
        columns[name] = channel[:cycles, row].reshape(-1, sweep.decimation).mean(axis=1)
    return columns
