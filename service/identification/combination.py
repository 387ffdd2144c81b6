r"""Sweeps and trajectories together: one weighted least-squares problem in the base parameters of the whole dynamics.

Rows of the sweeps: the axis inertias J with their covariance (`estimate`), J_k = M_kk(q) with the motor's share.
Rows of the trajectories: harmonic by harmonic, for every moving axis,

    DFT[effort] = sum_j x_j DFT[regressor_j] + ripple + reversals + noise                (`inverse_dynamics`)

Every regressor is formed from the measured motion at full rate and then transformed, so cutting both sides at the
band's end (`trajectory_record`) is one low-pass for all of them, and biases nothing. The links' rows take the load's
motion, the drives' rows the motor's. Where no direct encoder is, the load is put where the compliance c of the joint
fit of the axis' sweeps has it,  ql = qm - c (effort - Jm d2qm/dt2).

Fitted along, and eliminated before anything else: cogging of the known orders, a cosine and a sine of the motor angle
each; and friction while an axis reverses, when it sticks at any torque and motor and load turn one after the other: a
step and a slope for every such stretch.

Weights: the noise of an axis is the scatter of its effort between periods, enlarged until the residuals of the fit are
no larger than it: what the model cannot explain counts as noise.

A base parameter counts as *identified* when its standard deviation is below half of what the nominal model and its
prior leave open; else the reason says so. Sweeps see neither gravity nor friction nor what only Coriolis and coupling
show; trajectories see all of it, but at low frequency, where inertia has to be told from the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from service.errors import BadInput
from service.identification.axis_inertia import DriveTrain
from service.identification.base_parameters import BaseParameters, joint_ranges, reduce_columns
from service.identification.estimate import Estimate
from service.identification.frequency_response import Complex
from service.identification.inverse_dynamics import Motion, drive_rows, dynamics_names, dynamics_rows, link_rows
from service.identification.least_squares import Information, Solution
from service.identification.regressor import axis_rows
from service.identification.trajectory_record import TrajectoryRecord, calibrated, with_loads
from service.robot import Robot

Array = NDArray[np.float64]

IDENTIFIED = 0.5  # of the prior's standard deviation that the data must leave at most
ALONE = 1.5  # times the standard deviation of both together: so near, one source suffices
SAMPLES = 200  # random motions that stand for all motions
LINK_RATE = 200.0  # Hz, at which the links' rows are formed: products of a few harmonics
DRIVE_RATE = 2000.0  # Hz, at which friction and ripple are formed: sign and cogging reach far above the band
COULOMB_PRIOR, OFFSET_PRIOR = 0.1, 0.02  # of the rated effort: one sigma of what no data sheet tells
STILL = 0.01  # of the largest velocity: below, an axis is reversing
NOISE_GUESS = 1e-4  # of the rated effort, of a harmonic: start value only
ROUNDS = 3  # of weighting
ROUNDING = 1e-12  # kg m^2 per unit of a parameter: below, a row does not hold it


@dataclass(frozen=True)
class AxisInertias:
    """What the sweeps of one axis tell: inertias (m,) with covariance (m, m) at poses (m, n), kg m^2 (kg).

    `train`: of their joint fit, None if there was none. `gain`: effort as the drive tells it over true effort, taken
    out of the inertias already and of the trajectories' efforts here.
    """

    joint: str
    poses: Array
    values: Array
    covariance: Array
    train: DriveTrain | None
    gain: float


class Source(Enum):
    """What determines a parameter."""

    SWEEPS = "sweeps"
    TRAJECTORIES = "trajectories"
    EITHER = "either"  # each of them would do alone
    BOTH = "both"  # only together
    NONE = "none"


@dataclass(frozen=True)
class CombinedParameter:
    """One base parameter. Standard deviations with all data, with one source alone (inf: it does not show it), and of
    the nominal model; `reason` is empty for what is identified."""

    name: str
    value: float
    std: float
    std_sweeps: float
    std_trajectories: float
    std_prior: float
    source: Source
    reason: str

    @property
    def identified(self) -> bool:
        return not self.reason

    @property
    def by_combination(self) -> bool:
        """Identified, though neither source alone identifies it."""
        return self.identified and min(self.std_sweeps, self.std_trajectories) > IDENTIFIED * self.std_prior


@dataclass(frozen=True)
class Combination:
    """Result over the whole robot. `solution` is of the base parameters (r,).

    `noise`: standard deviation of real and imaginary part of an effort harmonic by joint, model error included, N m
    (N); `scatter` the same from the periods' scatter alone, None where only single periods were measured.
    """

    robot: Robot
    base: BaseParameters
    parameters: tuple[CombinedParameter, ...]
    solution: Solution
    noise: dict[str, float]
    scatter: dict[str, float | None]
    trajectories: tuple[tuple[str, ...], ...]  # ids of the sweeps of each

    def effort(self, load: Motion, motor: Motion | None = None) -> Array:
        """Predicted efforts (m, n) along a motion, without ripple, N m (N)."""
        rows = dynamics_rows(self.robot.chain, self.robot.gravity, load, motor)
        return rows[..., list(self.base.columns)] @ self.solution.values

    def inertia(self, joint: str, poses: Array) -> Array:
        """Identified inertia (m,) of an axis at poses (m, n), kg m^2 (kg)."""
        return _inertia_rows(self.robot, self.base, joint, poses) @ self.solution.values


def inertias_of(estimate: Estimate) -> tuple[AxisInertias, ...]:
    """The measured inertias of an estimate, by axis."""
    ids = sorted(sweep.sweep for axis in estimate.axes for sweep in axis.sweeps)
    pose_of = dict(zip(ids, estimate.poses, strict=True))
    return tuple(
        AxisInertias(
            joint=axis.joint,
            poses=np.array([pose_of[sweep.sweep] for sweep in axis.sweeps]),
            values=np.array([sweep.value for sweep in axis.sweeps]),
            covariance=axis.covariance,
            train=None if axis.fit is None else axis.fit.train,
            gain=axis.gain.gain,
        )
        for axis in estimate.axes
    )


def combine(robot: Robot, inertias: Sequence[AxisInertias], records: Sequence[TrajectoryRecord]) -> Combination:
    """Joint estimate of sweeps (there may be none) and trajectories of the whole robot; BadInput without these."""
    if not records:
        raise BadInput("combination", "there is no trajectory")
    base = dynamic_base(robot)
    start = base.combination @ nominal_parameters(robot)
    trains = {axis.joint: axis.train for axis in inertias if axis.train is not None}
    gains = {axis.joint: axis.gain for axis in inertias}
    records = [with_loads(calibrated(record, gains), trains) for record in records]
    equations = [equation for record in records for equation in _equations(robot, base, record)]
    sweeps = _sweep_information(robot, base, inertias)
    scatter = {joint: _scatter(records, joint) for joint in dict.fromkeys(each.joint for each in equations)}
    noise = {joint: value or NOISE_GUESS * robot.axis(joint).rated_effort for joint, value in scatter.items()}
    motions = _motion_information(equations, noise, len(start))
    for _ in range(ROUNDS):
        values = _together(sweeps, motions).solve(start).values
        noise = {joint: max(scatter[joint] or 0.0, _misfit(equations, joint, values)) for joint in noise}
        motions = _motion_information(equations, noise, len(start))
    solution = _together(sweeps, motions).solve(start)
    stds = (solution.std, sweeps.solve(start).std, motions.solve(start).std, _prior_std(robot, base))
    return Combination(
        robot=robot,
        base=base,
        parameters=tuple(
            _judged(name, float(value), *(float(std[k]) for std in stds))
            for k, (name, value) in enumerate(zip(base.names, solution.values, strict=True))
        ),
        solution=solution,
        noise=noise,
        scatter=scatter,
        trajectories=tuple(tuple(track.spec.id for track in record.tracks) for record in records),
    )


def dynamic_base(robot: Robot, ends: tuple[Array, Array] | None = None) -> BaseParameters:
    """The base parameters of the efforts of all axes that move, friction and offsets included; columns of the 14 n.

    `ends`: lower and upper (n,) of the joints' positions, rad (m); a joint stands where they are the same. None: the
    whole range of every joint.
    """
    rng = np.random.default_rng(0)
    lower, upper = ends or joint_ranges(robot.chain)
    moving, shape = lower < upper, (SAMPLES, len(lower))
    motion = Motion(rng.uniform(lower, upper, shape), *(moving * rng.uniform(-1.0, 1.0, (2, *shape))))
    rows = dynamics_rows(robot.chain, robot.gravity, motion)[:, moving]
    return reduce_columns(rows.reshape(-1, rows.shape[-1]), dynamics_names(robot.chain))


def nominal_parameters(robot: Robot) -> Array:
    """The model's (14 n,): links of CAD, motors and viscous friction of the data sheets; dry friction is in none."""
    motors = [axis.reflected_motor_inertia or 0.0 for axis in robot.axes]
    viscous = [axis.viscous_friction or 0.0 for axis in robot.axes]
    return np.concatenate([robot.chain.inertial.ravel(), motors, viscous, np.zeros(2 * len(robot.axes))])


@dataclass(frozen=True)
class _Equations:
    """Harmonics of one axis along one trajectory, real and imaginary parts, ripple and reversals eliminated."""

    joint: str
    rows: Array  # (m, r)
    values: Array  # (m,)
    freedom: int  # m less what was eliminated


def _equations(robot: Robot, base: BaseParameters, record: TrajectoryRecord) -> list[_Equations]:
    slow, fast = (round(rate * record.period) for rate in (LINK_RATE, DRIVE_RATE))
    motor, load = (record.motion(robot, fast, load=of_load) for of_load in (False, True))
    links = link_rows(robot.chain, robot.gravity, record.motion(robot, slow, load=True))
    count = len(record.frequency)
    equations: list[_Equations] = []
    for track in record.tracks:
        index = robot.index(track.joint)
        drives = _harmonics(drive_rows(motor)[:, index], count)
        rows = _real(np.hstack([_harmonics(links[:, index], count), drives])[:, list(base.columns)])
        values = _real(track.effort[:, None])[:, 0]
        ripple = _ripple(robot, index, motor.position[:, index])
        reversals = _reversals(motor.velocity[:, index], load.velocity[:, index])
        span = _span(_real(_harmonics(np.hstack([ripple, reversals]), count)))
        equations.append(
            _Equations(
                joint=track.joint,
                rows=rows - span @ (span.T @ rows),
                values=values - span @ (span.T @ values),
                freedom=len(values) - span.shape[1],
            )
        )
    return equations


def _span(columns: Array) -> Array:
    """Orthonormal columns (m, k) that span `columns` (m, p)."""
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, singular > 1e-9 * singular.max(initial=0.0)]


def _harmonics(signals: Array, count: int) -> Complex:
    """Harmonics 0 to count - 1 (count, p) of signals (n, p) over one period."""
    transform: Complex = np.fft.rfft(signals, axis=0)
    return transform[:count] / len(signals)


def _real(harmonics: Complex) -> Array:
    """(h + 1, p) -> (2 h + 1, p), every row with the same noise: the mean's is larger by the square root of two."""
    return np.vstack([harmonics[:1].real / np.sqrt(2), harmonics[1:].real, harmonics[1:].imag])


def _ripple(robot: Robot, index: int, position: Array) -> Array:
    """(n, 2 orders): cosine and sine of the motor angle at every cogging order."""
    axis = robot.axes[index]
    angle = np.outer(position, np.array(axis.cogging_orders) * axis.gear_ratio)
    return np.hstack([np.cos(angle), np.sin(angle)])


def _reversals(*velocities: Array) -> Array:
    """(n, 2 reversals): a step and a slope over every stretch in which motor or load is near to standstill."""
    still = np.any([np.abs(velocity) < STILL * np.abs(velocity).max() for velocity in velocities], axis=0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]])))
    stretches = np.zeros((len(still), len(edges)))
    for column in range(0, len(edges), 2):
        first, last = edges[column : column + 2]
        stretches[first:last, column] = 1.0
        stretches[first:last, column + 1] = np.linspace(-1.0, 1.0, last - first)
    return stretches


def _motion_information(equations: Sequence[_Equations], noise: dict[str, float], size: int) -> Information:
    information = Information.empty(size)
    for each in equations:
        information = information.add(each.rows, each.values, noise[each.joint] ** 2 * np.eye(len(each.values)))
    return information


def _sweep_information(robot: Robot, base: BaseParameters, inertias: Sequence[AxisInertias]) -> Information:
    information = Information.empty(len(base.columns))
    for axis in inertias:
        rows = _inertia_rows(robot, base, axis.joint, axis.poses)
        information = information.add(rows, axis.values, axis.covariance)
    return information


def _inertia_rows(robot: Robot, base: BaseParameters, joint: str, poses: Array) -> Array:
    """Rows (m, r) of the inertia about an axis: friction and offsets have no part in it."""
    rows = axis_rows(robot.chain, robot.index(joint), poses)
    rows[np.abs(rows) < ROUNDING] = 0.0  # or a column of rounding errors would count as seen
    return np.hstack([rows, np.zeros((len(rows), 3 * len(robot.axes)))])[:, list(base.columns)]


def _together(a: Information, b: Information) -> Information:
    return Information(a.matrix + b.matrix, a.vector + b.vector, a.count + b.count)


def _scatter(records: Sequence[TrajectoryRecord], joint: str) -> float | None:
    """RMS of the noise of an axis' harmonics over the records that show it."""
    noise = [t.noise for record in records for t in record.tracks if t.joint == joint and t.noise is not None]
    return float(np.sqrt(np.mean(np.square(noise)))) if noise else None


def _misfit(equations: Sequence[_Equations], joint: str, values: Array) -> float:
    """RMS of what is left of an axis' harmonics, the parameters' degrees of freedom taken off evenly."""
    own = [each for each in equations if each.joint == joint]
    squares = sum(float(np.sum((each.values - each.rows @ values) ** 2)) for each in own)
    freedom = sum(each.freedom for each in own)
    whole = sum(each.freedom for each in equations)
    return float(np.sqrt(squares / max(freedom * (1 - len(values) / whole), 1.0)))


def _prior_std(robot: Robot, base: BaseParameters) -> Array:
    """Standard deviations (r,) that the nominal model and its prior leave open."""
    links = robot.chain.inertial
    mass = np.maximum(links[:, :1], 1e-9)
    length = np.sqrt(np.maximum(links[:, [4, 6, 9]].sum(-1, keepdims=True), 0) / 2 / mass) + 1e-3
    size = np.hstack([mass, np.repeat(mass * length, 3, 1), np.repeat(mass * length**2, 6, 1)]).ravel()
    nominal, count, prior = nominal_parameters(robot), len(robot.axes), robot.prior
    rated = np.array([axis.rated_effort for axis in robot.axes])
    spread = np.concatenate(
        [
            prior.inertia * size,
            prior.motor_inertia * nominal[10 * count : 11 * count],
            prior.viscous_friction * nominal[11 * count : 12 * count],
            COULOMB_PRIOR * rated,
            OFFSET_PRIOR * rated,
        ]
    )
    return np.sqrt(base.combination**2 @ spread**2)


def _judged(
    name: str, value: float, std: float, std_sweeps: float, std_trajectories: float, std_prior: float
) -> CombinedParameter:
    source, reason = _source(std, std_sweeps, std_trajectories), ""
    if not np.isfinite(std):
        source, reason = Source.NONE, "no sweep and no trajectory shows it"
    elif std > IDENTIFIED * std_prior:
        reason = f"too weakly excited: standard deviation {std:.3g}, the nominal model's is {std_prior:.3g}"
    return CombinedParameter(name, value, std, std_sweeps, std_trajectories, std_prior, source, reason)


def _source(std: float, std_sweeps: float, std_trajectories: float) -> Source:
    sweeps, trajectories = std_sweeps <= ALONE * std, std_trajectories <= ALONE * std
    if sweeps and trajectories:
        return Source.EITHER
    if sweeps:
        return Source.SWEEPS
    return Source.TRAJECTORIES if trajectories else Source.BOTH
