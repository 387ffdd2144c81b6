"""Sweeps and noise runs of a scenario in closed loop, in one vectorised pass: recordings of a real machine."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from simulator.drive_train import DriveTrains
from simulator.effects import Bristles, FrictionLaw, KnownRipples, Ripples, Turn, cogging, warmth
from simulator.plant import Channel, CoupledTrains, Plant, Samples, measure
from simulator.rigid_body import MovingAxis, RigidBody, moving_axis
from simulator.scenario import CYCLE, STEP, Measurement, Scenario, ScenarioError, SpeedControl
from simulator.waveform import Array, Waveform, torque_noise

if TYPE_CHECKING:  # otherwise a virtual machine would load SciPy without using it
    from scipy.interpolate import CubicSpline, PPoly


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
    cycles = _check(scenario, sweeps)
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
    return [
        _columns(samples, row, cycles, sweep, driven[row].load_encoder) for row, sweep in zip(rows, sweeps, strict=True)
    ]


def _check(scenario: Scenario, sweeps: Sequence[SweepRun]) -> int:
    """Cycles of a sweep. Raises ScenarioError unless the sweeps are one trajectory."""
    if not sweeps:
        raise ScenarioError("a trajectory needs at least one axis")
    first = sweeps[0]
    for sweep in sweeps:
        scenario.driven(sweep.axis)
        common = [(each.pose, each.waveform.duration, each.sample_rate) for each in (sweep, first)]
        if common[0] != common[1]:
            raise ScenarioError(f"{sweep.axis}: pose, duration or sample rate differ from {first.axis}'s")
    if len({sweep.axis for sweep in sweeps}) < len(sweeps):
        raise ScenarioError("an axis is listed twice in a trajectory")
    if len(first.pose) != len(scenario.joints):
        raise ScenarioError(f"pose has {len(first.pose)} positions, the robot {len(scenario.joints)} joints")
    return _cycles(first)


@dataclass(frozen=True)
class Motion:
    """Recorded motion of a motor on the joint side: arrays (n,), s, rad, rad/s; n >= 4.

    A load with a spring begins at the motor's speed, without acceleration: preferably from standstill.
    """

    time: Array
    position: Array
    velocity: Array

    def at(self, grid: Array, late: float) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration at times since the start, with the speed as if recorded `late`, s.
        Constant after the end.
        """
        position, velocity, acceleration = self._splines
        end = float(self.time[-1] - self.time[0])
        here, ahead = np.minimum(grid, end), np.minimum(grid + late, end)
        return position(here), velocity(ahead), acceleration(ahead)

    @cached_property
    def _splines(self) -> "tuple[CubicSpline, CubicSpline, PPoly]":
        from scipy.interpolate import CubicSpline

        since = self.time - self.time[0]
        velocity = CubicSpline(since, self.velocity)
        return CubicSpline(since, self.position), velocity, velocity.derivative()


def replay(
    axes: Sequence[MovingAxis],
    motions: Sequence[Motion],
    measurement: Measurement | Sequence[Measurement] | None = None,
) -> list[Array]:
    """Recorded torque (n,) N m at the samples of each motion, one axis each (all rigid or all elastic), in one pass.

    Of `measurement` (one for all, or one per row) delay and smoothing of the effort and delay of the speed are
    applied; there is no noise. The initial temperature of a gear is in its `MovingAxis`. At standstill dry friction
    may have any value within its limits; here it counts as zero.
    """
    exact = measurement or Measurement()
    measurements = [exact] * len(axes) if isinstance(exact, Measurement) else list(exact)
    if not len(axes) == len(motions) == len(measurements):
        raise ValueError(f"{len(axes)} axes for {len(motions)} motions and {len(measurements)} measurements")
    if not axes:
        return []
    step = _step(axes)
    position, velocity, acceleration = _on_grid(motions, [one.velocity_delay for one in measurements], step)
    effort = _motor_torque(axes, position, velocity, acceleration)
    effort += (_elastic if axes[0].train.spring else _rigid)(axes, position, velocity, acceleration, step)
    grid = np.linspace(0.0, step * (len(effort) - 1), len(effort))
    return [
        np.interp(motion.time - motion.time[0], grid, _recorded(axis, effort[:, row], measurements[row], step))
        for row, (axis, motion) in enumerate(zip(axes, motions, strict=True))
    ]


def _step(axes: Sequence[MovingAxis]) -> float:
    """Step in s: that of the plant for fast dynamics, a longer one if the loads only oscillate slowly or nothing has
    memory.
    """
    trains = [axis.train for axis in axes]
    if any(train.lugre or train.appendage for train in trains):
        return STEP
    swings = [np.sqrt(axis.train.spring.stiffness / axis.load_inertia) for axis in axes if axis.train.spring]
    phase = 1.25  # rad of a load oscillation per step with prescribed motor; the leapfrog is unstable from 2
    return next((CYCLE / n for n in (1, 2) if CYCLE / n * max(swings, default=0.0) < phase), STEP)


def _on_grid(motions: Sequence[Motion], late: Sequence[float], step: float) -> Array:
    """Position, velocity and acceleration (3, steps, rows), with the speed shifted earlier by `late`, s. A shorter
    motion stays at its end.
    """
    different = {(id(motion), delay): motion for motion, delay in zip(motions, late, strict=True)}
    steps = max(round(float(m.time[-1] - m.time[0]) / step) for m in motions) + 1
    grid = np.linspace(0.0, step * (steps - 1), steps)
    result = np.empty((3, steps, len(motions)))
    for (key, delay), motion in different.items():
        rows = [row for row, other in enumerate(motions) if (id(other), late[row]) == (key, delay)]
        for signal, value in zip(result, motion.at(grid, delay), strict=True):
            signal[:, rows] = value[:, None]
    return result


def _motor_torque(axes: Sequence[MovingAxis], position: Array, velocity: Array, acceleration: Array) -> Array:
    """Torque for the motor itself, without the friction in `effects.friction`, (steps, rows)."""
    torque = acceleration * np.array([axis.motor_inertia for axis in axes])
    ripple = cogging(axes)
    if ripple is not None:
        for at in _pieces(position):
            torque[at] += ripple.at(position[at])
    if any(axis.train.lugre for axis in axes):
        bristles = Bristles([axis.train.lugre for axis in axes], STEP)
        for at in _pieces(velocity):
            torque[at] += bristles.along(velocity[at])
    return torque


def _rigid(axes: Sequence[MovingAxis], position: Array, velocity: Array, acceleration: Array, step: float) -> Array:
    """Friction, and torque from the motor to a rigidly connected load, (steps, rows)."""
    trains = _led(axes, position[0], velocity[0], step)
    law = FrictionLaw([axis.train for axis in axes], [axis.warmth for axis in axes], step)
    damping = np.array([axis.train.hose.damping if axis.train.hose else 0.0 for axis in axes])
    torque = np.array([axis.load_inertia for axis in axes]) * acceleration
    quarter = round(0.25 / step)  # s per block, so that few iterations make friction and temperature agree
    for at in _pieces(position, quarter if law.warms else None):
        trains.position = position[None, at]
        torque[at] += trains.gravity()
        if trains.appendages is not None:
            torque[at] += np.stack(
                [trains.appendages.step(*now) for now in zip(position[at], velocity[at], strict=True)]
            )
        torque[at] += _friction(law, velocity[at], torque[at], position[at]) + damping * velocity[at]
    return torque


def _friction(law: FrictionLaw, velocity: Array, transmitted: Array, position: Array) -> Array:
    """Friction of motor and load together (steps, rows), N m, including its own heating; updates the temperature of
    `law`.
    """
    motion = (velocity[:, None], transmitted[:, None], position[:, None])
    start, torque = law.warmth, law.whole(*motion).sum(axis=1)
    while law.warms:
        gained = law.heating * torque * velocity
        path = _cooling(gained, 1 - law.cooling, start)
        law.warmth = np.concatenate([start[None], path[:-1]])[:, None]
        before, torque = torque, law.whole(*motion).sum(axis=1)
        if np.abs(torque - before).max() < 1e-7 * np.abs(torque).max():
            law.warmth = path[-1]
            break
    return torque


def _cooling(gained: Array, keep: Array, start: Array) -> Array:
    """``T[n] = keep T[n - 1] + gained[n]`` (steps, rows)."""
    from scipy.signal import lfilter

    path = np.empty_like(gained)
    for one in np.unique(keep):
        alike = keep == one
        path[:, alike] = lfilter([1.0], [1.0, -one], gained[:, alike], axis=0, zi=one * start[None, alike])[0]
    return path


def _elastic(axes: Sequence[MovingAxis], position: Array, velocity: Array, acceleration: Array, step: float) -> Array:
    """Friction of the motor, and its torque on the spring, (steps, rows)."""
    trains = _led(axes, position[0], velocity[0], step)
    known = _known(trains.gear_error, position)
    if known is not None:
        trains.gear_error = known
    idle = np.zeros(len(axes))
    torque = np.empty_like(acceleration)
    for n in range(len(position)):
        if known is not None:
            known.step = n
        trains.position[0] = position[n]
        trains.velocity[0] = velocity[n]
        spring, lever = trains.spring_torque(), trains.lever()
        torque[n] = trains.friction_torque(spring)[0]
        trains.step(idle)
        torque[n] += lever * (spring + trains.damping_torque())
    return torque


def _known(ripples: Ripples | KnownRipples | None, position: Array) -> KnownRipples | None:
    """Ripples along the positions (steps, rows) of the motor."""
    if not isinstance(ripples, Ripples):
        return None
    parts = [(ripples.at(position[at]), ripples.slope(position[at])) for at in _pieces(position)]
    sums, slopes = (np.concatenate(part) for part in zip(*parts, strict=True))
    return KnownRipples(sums, slopes)


def _led(axes: Sequence[MovingAxis], position: Array, velocity: Array, step: float) -> DriveTrains:
    """The drive trains in balance at `position` and `velocity` (rows,), with prescribed motor motion."""
    bare = {"motor_inertia": 1e18, "cogging": (), "lugre": None}
    trains = DriveTrains([replace(axis, train=axis.train.model_copy(update=bare)) for axis in axes], step)
    trains.free[:] = 1.0
    trains.position[:] = position
    for row in range(len(axes)):
        trains.settle(row)
    trains.velocity[:] = velocity
    return trains


def _recorded(axis: MovingAxis, effort: Array, measurement: Measurement, step: float) -> Array:
    """Torque (steps,) as recorded by the drive."""
    channel = Channel(1, step, measurement.effort_delay, measurement.effort_smoothing)
    channel.restart(0, float(effort[0]))
    return channel.pass_on(effort[:, None])[:, 0] * axis.train.effort_gain + axis.train.effort_offset


def _pieces(signal: Array, longest: int | None = None) -> Iterator[slice]:
    """Slices of steps in order, limited by the number of values over all rows, or by `longest`."""
    steps, rows = signal.shape
    count = longest or max(1, 200_000 // rows)  # values, so that arrays stay near the size of the cache
    return (slice(first, first + count) for first in range(0, steps, count))
