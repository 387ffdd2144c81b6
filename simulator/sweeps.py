"""Sweeps and noise runs of a scenario in closed loop, in one vectorised pass: recordings of a real machine."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from simulator.coupled import CoupledTrains
from simulator.effects import Turn, warmth
from simulator.plant import Plant, Samples, measure
from simulator.rigid_body import MovingAxis, RigidBody, moving_axis
from simulator.scenario import CYCLE, STEP, Scenario, ScenarioError, SpeedControl
from simulator.waveform import Array, Waveform, torque_noise


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
    started_at: float = 0.0  # s since the start of the campaign; sets the temperature of the gear

    @property
    def waveform(self) -> Waveform:
        return Waveform(self.offset_velocity, self.sines, self.period, self.periods, self.ramp, self.settle)


@dataclass(frozen=True, slots=True)
class NoiseRun:
    """Torque noise on a slow motion from standstill at `pose` (all joints, rad), with softened speed control.

    Torque ``e(t) sum_k a sin(2 pi f_k t + phi_k)`` with the envelope e of `Waveform`: f_k are all multiples of
    1/period in the band, with equal amplitudes and phases by `seed`.
    """

    axis: str
    pose: tuple[float, ...]
    offset_velocity: float  # rad/s, signed
    effort: float  # N m, RMS of the injected torque
    lowest: float  # Hz
    highest: float  # Hz
    period: float  # s
    periods: int
    seed: int
    softening: float  # gain times this, reset time divided by it
    ramp: float  # s
    settle: float  # s
    sample_rate: float = 1000.0  # Hz; 1000 divided by a whole number
    started_at: float = 0.0  # s since the start of the campaign; sets the temperature of the gear

    @property
    def waveform(self) -> Waveform:
        return Waveform(self.offset_velocity, (), self.period, self.periods, self.ramp, self.settle)


Run = SweepRun | NoiseRun


def run_sweeps(scenario: Scenario, sweeps: Sequence[Run], seed: int) -> list[dict[str, Array]]:
    """Columns of every sweep as in a bundle: time, effort, velocity, position, velocity_setpoint and load_*.

    A noise run also has `excitation_effort`: the injected torque, N m, without noise and delay.

    A sample is the mean over its cycle for all channels; `time` is sample number / rate, so the middle of the cycle
    is half a sample later. Sweep i uses noise of child i of the seed. Raises ScenarioError if a sweep does not fit.
    The temperature of a gear follows from the earlier sweeps, by `started_at`.
    """
    if not sweeps:
        return []
    body = RigidBody(scenario)
    axes = [moving_axis(scenario, body, sweep.axis, sweep.pose) for sweep in sweeps]
    cycles = [_cycles(sweep) for sweep in sweeps]
    end_of_cycle = np.linspace(CYCLE, CYCLE * max(cycles), max(cycles))
    setpoints = np.stack([sweep.waveform.velocity(end_of_cycle) for sweep in sweeps], axis=1)
    controls = [_control(scenario, sweep) for sweep in sweeps]
    plant = Plant(_warm(axes, sweeps, setpoints, cycles), controls, scenario.measurement)
    injected = np.stack([_injected(sweep, end_of_cycle) for sweep in sweeps], axis=1)
    plant.trains.position[:] = [sweep.pose[scenario.joints.index(sweep.axis)] for sweep in sweeps]
    for row in range(len(sweeps)):
        plant.release(row)
    random = [np.random.default_rng(child) for child in np.random.SeedSequence(seed).spawn(len(sweeps))]
    rated = np.array([scenario.nominal(sweep.axis).rated_effort for sweep in sweeps])
    samples = measure(plant.advance(setpoints, injected), scenario.measurement, rated, random)
    return [
        _columns(samples, row, cycles[row], sweep, scenario.driven(sweep.axis).load_encoder)
        for row, sweep in enumerate(sweeps)
    ]


def _warm(
    axes: Sequence[MovingAxis], sweeps: Sequence[Run], setpoints: Array, cycles: Sequence[int]
) -> list[MovingAxis]:
    """The axes with the temperature at the start of their sweeps."""
    warm = list(axes)
    for joint in {sweep.axis for sweep, axis in zip(sweeps, axes, strict=True) if axis.train.warming}:
        rows = [row for row, sweep in enumerate(sweeps) if sweep.axis == joint]
        turns = [Turn(sweeps[row].started_at, CYCLE, setpoints[: cycles[row], row]) for row in rows]
        for row, rise in zip(rows, warmth(axes[rows[0]].train, turns), strict=True):
            warm[row] = replace(axes[row], warmth=float(rise))
    return warm


def _control(scenario: Scenario, sweep: Run) -> SpeedControl:
    commissioned = scenario.driven(sweep.axis).control
    if isinstance(sweep, SweepRun):
        return commissioned
    if not 0 < sweep.softening <= 1:
        raise ScenarioError(f"{sweep.axis}: softening {sweep.softening} is not above 0 and at most 1")
    return commissioned.softened(sweep.softening)


def _injected(sweep: Run, time: Array) -> Array:
    """Injected torque (n,) N m at the ends of the cycles `time` (n,)."""
    if isinstance(sweep, SweepRun):
        return np.zeros_like(time)
    try:
        period = torque_noise(sweep.effort, sweep.lowest, sweep.highest, sweep.period, sweep.seed, CYCLE)
    except ValueError as error:
        raise ScenarioError(f"{sweep.axis}: {error}") from None
    return sweep.waveform.envelope(time) * np.resize(period, len(time))


def _decimation(sweep: Run) -> int:
    """Cycles averaged into one sample."""
    return round(1 / (CYCLE * sweep.sample_rate))


def _cycles(sweep: Run) -> int:
    """Largest number of whole samples, in cycles."""
    block = _decimation(sweep)
    if block < 1 or abs(block * CYCLE * sweep.sample_rate - 1) > 1e-9:
        raise ScenarioError(
            f"{sweep.axis}: sample rate {sweep.sample_rate} Hz is not {1 / CYCLE:g} Hz over a whole number"
        )
    cycles = round(sweep.waveform.duration / CYCLE) // block * block
    if cycles == 0:
        raise ScenarioError(f"{sweep.axis}: sweep of {sweep.waveform.duration} s has no sample")
    return cycles


def _columns(samples: Samples, row: int, cycles: int, sweep: Run, load_encoder: bool) -> dict[str, Array]:
    names = ["effort", "velocity", "position", "velocity_setpoint"]
    if load_encoder:
        names += ["load_position", "load_velocity"]
    if isinstance(sweep, NoiseRun):
        names.append("excitation_effort")
    block = _decimation(sweep)
    columns = {"time": np.arange(cycles // block) / sweep.sample_rate}
    for name in names:
        channel: Array = getattr(samples, name)
        columns[name] = channel[:cycles, row].reshape(-1, block).mean(axis=1)
    return columns


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
