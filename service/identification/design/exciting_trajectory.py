r"""Exciting trajectories: all axes move together on periodic Fourier series (Swevers et al. 1997), as sets of sweeps.

The joint *velocity* of axis k is a sum of sines on the harmonics of one fundamental 1/T, its offset is 0,

    v_k(t) = e(t) sum_h a_kh sin(2 pi h (t - t0)/T + phi_kh)

so the set of axes is a set of ordinary sweeps with common period, ramp and settling. The ramp e(t) moves the middle of
the oscillation away from the start; the shift is known in closed form (`excitation`) and the start is shifted
in the opposite direction, so that during the window axis k oscillates about `center`.

Choice: random shapes (amplitudes falling as 1/h) about random centres, each scaled to the nearest of its limits
(position, velocity, acceleration, effort of the nominal model, free path); then the best is changed by decreasing
random steps, and improvements are kept. Criterion: the condition number of the base parameters' rows over one period,
each axis' rows divided by its rated effort, columns of unit length.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from service import BadInput
from service.identification.design.excitation import Excitation, velocity_setpoint, way
from service.identification.model import JointMotion, condition_number, dynamics_rows
from service.model import Array, Mask, Robot, Sine

BREAKAWAY = 0.1  # of the rated effort: Coulomb friction to add to a predicted effort


@dataclass(frozen=True)
class TrajectoryLimits:
    """Limits at every instant of a run: arrays (n,) over all joints; rad, rad/s, rad/s^2, N m (m, ..., N).

    `velocity` limits the sum of an axis' amplitudes. A joint with equal position limits stands there.
    """

    lower: Array
    upper: Array
    velocity: Array
    acceleration: Array
    effort: Array

    @property
    def moving(self) -> Mask:
        """Joints that have room, (n,)."""
        return self.lower < self.upper


@dataclass(frozen=True)
class Trajectory:
    """One run of all axes together. `start` (n,): start position, `center` (n,): centre of the oscillation, rad (m).

    `excitations`: one per axis, in the order of `robot.joints`. `condition`: of the base parameters' rows.
    """

    start: Array
    center: Array
    excitations: tuple[Excitation, ...]
    condition: float

    @property
    def duration(self) -> float:
        """From standstill to standstill, s."""
        return self.excitations[0].duration

    def path(self, time: Array) -> Array:
        """Positions (m, n) at `time` (m,), s from standstill, as commanded."""
        return self.start + np.stack([way(excitation, time) for excitation in self.excitations], -1)


@dataclass(frozen=True)
class TrajectoryShape:
    """Times of a run: `harmonics` of 1/`period` in use; s."""

    period: float = 10.0
    harmonics: int = 5
    periods: int = 2
    ramp: float = 1.0
    settle: float = 1.0


def design_trajectory(
    robot: Robot,
    base_columns: Sequence[int],
    limits: TrajectoryLimits,
    shape: TrajectoryShape,
    free: Callable[[Array], bool],
    *,
    seed: int = 0,
    restarts: int = 30,
    steps: int = 150,
) -> Trajectory:
    """The best trajectory found. `base_columns` (r,) of the dynamic parameters; `free` checks a path (m, n).

    Raises BadInput if no shape fits the limits.
    """
    rng = np.random.default_rng(seed)
    best: Trajectory | None = None
    joints = len(robot.axes)
    for _ in range(restarts):
        center = rng.uniform(limits.lower, limits.upper)
        waves = rng.standard_normal((joints, shape.harmonics, 2)) / np.arange(1, shape.harmonics + 1)[:, None]
        other = _fit(robot, base_columns, limits, shape, free, center, waves)
        if best is None or (other is not None and other.condition < best.condition):
            best = other
    if best is None:
        raise BadInput("trajectory", f"none of {restarts} shapes fits the limits with a free path")
    for step in range(steps):
        # of the ranges, at first and at last
        size = 0.5 * (1 - step / steps) + 0.02
        center = best.center + size * rng.uniform(-0.5, 0.5, joints) * (limits.upper - limits.lower)
        shapes = _waves(best)
        largest: Array = np.abs(shapes).max(axis=(1, 2), keepdims=True)
        waves = shapes / np.where(largest > 0, largest, 1.0) + size * rng.standard_normal(shapes.shape)
        center = np.clip(center, limits.lower, limits.upper)
        other = _fit(robot, base_columns, limits, shape, free, center, waves)
        if other is not None and other.condition < best.condition:
            best = other
    return best


def _fit(
    robot: Robot,
    base_columns: Sequence[int],
    limits: TrajectoryLimits,
    shape: TrajectoryShape,
    free: Callable[[Array], bool],
    center: Array,
    waves: Array,
) -> Trajectory | None:
    """The shape (n, h, 2: cosine and sine of the velocity) about `center`, as large as allowed; None if it does not
    fit.
    """
    if not free(center[None]):
        return None
    duration = _excitation(shape, waves[0]).duration
    # 16 instants of the highest harmonic's period
    time = np.linspace(0.0, duration, round(16 * shape.harmonics * duration / shape.period))
    whole = np.zeros(len(waves))
    for k in np.flatnonzero(limits.moving).tolist():
        whole[k] = _largest(limits, shape, k, center[k], waves[k], time)
    scale = 1.0
    while scale > 0.1:  # below, another shape is tried
        scaled = waves * (scale * whole)[:, None, None]
        trajectory = _build(shape, center, scaled)
        path = trajectory.path(time)
        inside = bool(((path >= limits.lower) & (path <= limits.upper))[:, limits.moving].all())
        if inside and _effort_fits(robot, limits, trajectory, time) and free(path):
            condition = condition_number(
                _rows(robot, base_columns, trajectory)[:, limits.moving].reshape(-1, len(base_columns))
            )
            return Trajectory(trajectory.start, center, trajectory.excitations, condition)
        scale *= 0.8  # effort or path do not fit
    return None


def _largest(
    limits: TrajectoryLimits, shape: TrajectoryShape, axis: int, center: float, waves: Array, time: Array
) -> float:
    """Factor on an axis' waves at which the first of position, velocity and acceleration reaches its limit."""
    excitation = _excitation(shape, waves)
    velocity = velocity_setpoint(excitation, time)
    path = way(excitation, time) - _shift(excitation)
    room = min(center - limits.lower[axis], limits.upper[axis] - center)
    # sum of the amplitudes, as in the limit check of the drives
    fastest = sum(sine.amplitude for sine in excitation.sines)
    peaks = (np.abs(path).max(), fastest, np.abs(np.gradient(velocity, time)).max())
    ends = (room, limits.velocity[axis], limits.acceleration[axis])
    return min(float(end / peak) for end, peak in zip(ends, peaks, strict=True))


def _effort_fits(robot: Robot, limits: TrajectoryLimits, trajectory: Trajectory, time: Array) -> bool:
    """Whether the nominal model, with links and gravity increased by twice its prior, stays below the effort limits."""
    velocity = np.stack([velocity_setpoint(excitation, time) for excitation in trajectory.excitations], -1)
    motion = JointMotion(trajectory.path(time), velocity, np.gradient(velocity, time, axis=0))
    return bool((np.abs(nominal_effort(robot, motion)) <= limits.effort).all())


def nominal_effort(robot: Robot, motion: JointMotion, breakaway: float = BREAKAWAY) -> Array:
    """Effort (m, n) of the nominal model, enlarged by two sigma of its prior, and counterbalances; N m (N).

    `breakaway`: assumed Coulomb friction, share of the rated effort.
    """
    prior = robot.prior
    motors = [axis.reflected_motor_inertia or 0.0 for axis in robot.axes]
    viscous = [(1 + prior.viscous_friction) * (axis.viscous_friction or 0.0) for axis in robot.axes]
    dry = [breakaway * axis.rated_effort for axis in robot.axes]
    inertial = robot.chain.inertial.ravel()
    rows = dynamics_rows(robot.chain, robot.gravity, motion)
    links = rows[..., : inertial.size] @ inertial
    drives = rows[..., inertial.size :] @ np.concatenate([motors, viscous, dry, np.zeros(len(motors))])
    carried = robot.counterbalance_efforts(motion.position)
    spread = 2 * max(prior.inertia, prior.gravity)
    most, least = ((1 + way * spread) * links + drives + carried for way in (1, -1))
    # lighter links need more where a counterbalance carries them
    return np.where((carried != 0) & (np.abs(least) > np.abs(most)), least, most)


def steady_motion(trajectory: Trajectory, time: Array) -> JointMotion:
    """The periodic motion in the window, `time` (m,) s since its start: ideal, as commanded."""
    parts: list[tuple[Array, Array, Array]] = []
    for excitation in trajectory.excitations:
        position, velocity, acceleration = np.zeros((3, len(time)))
        for sine in excitation.sines:
            omega = 2 * np.pi * sine.frequency
            angle = omega * time + sine.phase
            position -= sine.amplitude / omega * np.cos(angle)
            velocity += sine.amplitude * np.sin(angle)
            acceleration += sine.amplitude * omega * np.cos(angle)
        parts.append((position, velocity, acceleration))
    position, velocity, acceleration = np.moveaxis(np.array(parts), 0, -1)
    return JointMotion(trajectory.center + position, velocity, acceleration)


def _rows(robot: Robot, base_columns: Sequence[int], trajectory: Trajectory) -> Array:
    """Rows (instants, n, r) of the base parameters over one period, in units of the rated efforts."""
    period = trajectory.excitations[0].period
    # instants used for the condition number
    motion = steady_motion(trajectory, np.linspace(0.0, period, 80, endpoint=False))
    rows = dynamics_rows(robot.chain, robot.gravity, motion)[..., list(base_columns)]
    return rows / np.array([axis.rated_effort for axis in robot.axes])[:, None]


def _build(shape: TrajectoryShape, center: Array, waves: Array) -> Trajectory:
    excitations = tuple(_excitation(shape, each) for each in waves)
    return Trajectory(center - np.array([_shift(each) for each in excitations]), center, excitations, np.inf)


def _excitation(shape: TrajectoryShape, waves: Array) -> Excitation:
    """The sweep of one axis with the velocity sum c cos + s sin, `waves` (h, 2)."""
    sines = tuple(
        Sine(
            frequency=(number + 1) / shape.period,
            amplitude=float(np.hypot(cosine, sine)),
            phase=float(np.arctan2(cosine, sine) % (2 * np.pi)),
        )
        for number, (cosine, sine) in enumerate(waves)
    )
    return Excitation(0.0, sines, shape.period, shape.periods, shape.ramp, shape.settle)


def _waves(trajectory: Trajectory) -> Array:
    """The inverse: (n, h, 2)."""
    return np.array(
        [
            [(sine.amplitude * np.sin(sine.phase), sine.amplitude * np.cos(sine.phase)) for sine in excitation.sines]
            for excitation in trajectory.excitations
        ]
    )


def _shift(excitation: Excitation) -> float:
    """Centre of the oscillation in the window minus the start, rad (m)."""
    start = way(excitation, np.array([excitation.measure_from]))[0]
    return float(start) + sum(s.amplitude / (2 * np.pi * s.frequency) * np.cos(s.phase) for s in excitation.sines)
