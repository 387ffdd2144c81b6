"""Sweeps and trajectories together: one weighted least-squares problem in the base parameters of the whole dynamics.

Rows of the sweeps: the axis inertias J with their covariance (`estimate`), J_k = M_kk(q) with the motor's share.
Rows of the trajectories: harmonic by harmonic, for every moving axis,

    DFT[effort] = sum_j x_j DFT[regressor_j] + ripple + reversals + noise                (`inverse_dynamics`)

Every regressor is computed from the measured motion at full rate and then transformed, so cutting both sides at the
band's end (`trajectory_record`) is the same low-pass for all of them and causes no bias. The links' rows use the load's
motion, the drives' rows the motor's. Without a direct encoder, the load position is computed with the compliance c of
the joint fit of the axis' sweeps,  ql = qm - c (effort - Jm d2qm/dt2).

Also fitted, and eliminated first: cogging of the known orders, a cosine and a sine of the motor angle
each; and friction while an axis reverses, when it may stick at any torque and motor and load reverse one after the
other: a step and a slope for every such stretch.

Weights: the noise of an axis is the scatter of its effort between periods, enlarged until the residuals of the fit are
no larger than it: model error counts as noise. Free motions, which have no period, give equations in
time instead of harmonics, with their own covariance (`motion.fit`). The nominal model is a further measurement,
with the prior's standard deviations; dry friction has no prior.

A base parameter counts as *identified* if its standard deviation is below half of that of the nominal model and its
prior; otherwise the reason states it. Sweeps contain no gravity, no friction, and nothing that only Coriolis and
coupling torques show; trajectories contain all of it, but at low frequency, where inertia must be separated from the
rest.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from service import BadInput
from service.identification.axis.drive_train import SHARED, TwoMassTrain
from service.identification.axis.nominal_priors import SharedPrior, TorqueGain, shared_prior, uncalibrated
from service.identification.estimates.estimate import RobotEstimate
from service.identification.estimates.standard_parameters import physical_document, standard_document
from service.identification.model import (
    BaseParameters,
    Information,
    JointMotion,
    Solution,
    axis_rows,
    dynamic_base,
    dynamics_rows,
    finite,
    inertia_rows,
    inertial_parameters,
    joint_ranges,
    link_rows,
    nominal_parameters,
    parameter_spread,
    prior_information,
    scaled_inverse,
    span,
    spread_evenly,
    unsettled,
)
from service.identification.model.physical_consistency import NearestPhysical, SearchEnded, nearest_physical
from service.identification.motion import free_motion
from service.identification.motion.choice import (
    SIMPLE,
    Chosen,
    HeldOutMotion,
    IdentifiedFriction,
    choose,
    extended,
    held_out,
    scales,
    wider,
)
from service.identification.motion.equations import Sampling, cogging, drive_along, told_apart, whole_parameters
from service.identification.motion.free_motion import FreeMotion
from service.identification.motion.record_faults import faults
from service.identification.motion.trajectory_record import TrajectoryRecord, calibrated, with_loads
from service.identification.spectra.frequency_response import held, stretches, torques_within
from service.model import Array, Complex, Robot
from service.model.results import combination as results

IDENTIFIED = 0.5  # of the prior's standard deviation: maximum for an identified parameter
POSITIVE_NAMES = ("Jm(", "Fv(", "Fc(")  # alone: names of parameters that are positive on every robot


@dataclass(frozen=True)
class AxisInertias:
    """Inertias of one axis from its sweeps: (m,) with covariance (m, m) at poses (m, n), kg m^2 (kg).

    `train`: drive train of their joint fit, None if there was none. `gain`: effort reported by the drive over true
    effort, already removed from the inertias, and removed from the trajectories' efforts here. `train_std` (5,): of
    the train's parameters; None: they count as exact.
    """

    joint: str
    poses: Array
    values: Array
    covariance: Array
    train: TwoMassTrain | None
    gain: float
    train_std: Array | None = None


@dataclass(frozen=True)
class JointEstimate:
    """Result over the whole robot. `solution` is of the base parameters (r,).

    `noise`: standard deviation of real and imaginary part of an effort harmonic by joint, including model error, N m
    (N); `scatter`: the same from the scatter between periods alone, None if only single periods were measured.
    `squares` (r, r): of least squares, how the squared residuals of all efforts grow with a change of the parameters.
    """

    robot: Robot
    base: BaseParameters
    parameters: tuple[results.CombinedParameter, ...]
    solution: Solution
    squares: Array
    noise: dict[str, float]
    noise_change: dict[str, float]  # of `noise` in the last of the 3, relative
    scatter: dict[str, float | None]
    trajectories: tuple[tuple[str, ...], ...]  # ids of the sweeps of each
    free: tuple[tuple[str, ...], ...]  # the same of free motions
    free_axes: dict[str, HeldOutMotion]  # by joint, prediction error of free motions
    friction: dict[str, IdentifiedFriction]  # by joint, beyond Coulomb and viscous friction
    chosen: Chosen | None  # the fit of free motions
    faults: tuple[str, ...]  # of their records

    def effort(self, load: JointMotion, motor: JointMotion | None = None) -> Array:
        """Predicted efforts (m, n) along a motion, without ripple, N m (N)."""
        rows = dynamics_rows(self.robot.chain, self.robot.gravity, load, motor)
        efforts = rows[..., list(self.base.columns)] @ self.solution.values
        velocity = (motor or load).velocity
        for joint, law in self.friction.items():
            index = self.robot.index(joint)
            efforts[:, index] += law.effort(velocity[:, index])
        return efforts

    def inertia(self, joint: str, poses: Array) -> Array:
        """Identified inertia (m,) of an axis at poses (m, n), kg m^2 (kg)."""
        return _inertia_rows(self.robot, self.base, joint, poses) @ self.solution.values

    def inertia_matrix(self, poses: Array) -> tuple[Array, Array]:
        """M(q) (m, n, n) with the motors at poses (m, n), and its standard deviation without that of the torque
        constants, kg m^2 (kg, kg m).
        """
        still = np.zeros_like(poses)
        columns = [
            dynamics_rows(self.robot.chain, np.zeros(3), JointMotion(poses, still, still + unit))
            for unit in np.eye(len(self.robot.axes))
        ]
        rows = np.stack(columns, 2)
        rows[..., 11 * len(self.robot.axes) :] = 0.0  # friction and offsets
        rows = rows[..., list(self.base.columns)]
        variance = np.sum((rows @ self.solution.covariance) * rows, -1)
        return rows @ self.solution.values, np.sqrt(np.maximum(variance, 0.0))


def inertias_of(estimate: RobotEstimate) -> tuple[AxisInertias, ...]:
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
            train_std=None if axis.fit is None else axis.fit.train_std,
        )
        for axis in estimate.axes
    )


def combine(
    robot: Robot,
    inertias: Sequence[AxisInertias],
    records: Sequence[TrajectoryRecord],
    motions: Sequence[FreeMotion] = (),
    gains: Mapping[str, TorqueGain] | None = None,
) -> JointEstimate:
    """Joint estimate of sweeps (optional), trajectories and free motions of the whole robot.

    `gains`: calibrated with a test mass, by joint. BadInput if neither contains a common motion of axes, or an inertia,
    a harmonic or the noise of one is not finite.
    """
    base = dynamic_base(robot)
    apart = {joint for joint in told_apart(motions) if f"Jm({joint})" not in base.names}
    if apart:
        found = _combined(robot, dynamic_base(robot, apart=apart), inertias, records, motions, gains)
        shown = {joint for joint in apart for one in found.parameters if one.identified and one.name == f"Jm({joint})"}
        if shown == apart:
            return found
        base = dynamic_base(robot, apart=shown)  # of the others the sum with the link is known better than either
    return _combined(robot, base, inertias, records, motions, gains)


def _combined(
    robot: Robot,
    base: BaseParameters,
    inertias: Sequence[AxisInertias],
    records: Sequence[TrajectoryRecord],
    motions: Sequence[FreeMotion],
    gains: Mapping[str, TorqueGain] | None,
) -> JointEstimate:
    if not records and not motions:
        raise BadInput("combination", "there is no trajectory and no free motion of several axes")
    for axis in inertias:
        finite(np.append(axis.values, axis.covariance), axis.joint, "the inertias and the covariance of its sweeps")
    for track in (track for record in records for track in record.tracks):
        finite(np.append(track.effort, track.position), f"sweep {track.spec.id} of {track.joint}", "its harmonics")
    of = scales(motions)
    start, prior = base.combination @ nominal_parameters(robot), prior_information(robot, base, of)
    trains = {axis.joint: axis.train for axis in inertias if axis.train is not None}
    gain = {joint: one.gain for joint, one in (gains or {}).items()} | {axis.joint: axis.gain for axis in inertias}
    records = [calibrated(record, gain) for record in records]
    priors = _train_priors(robot, records, inertias)
    equations = _all_equations(robot, base, records, trains)
    sweeps = _sweep_information(robot, base, inertias)
    free, free_gains = None, np.zeros((len(start), len(robot.axes)))
    evidence = honest = Information.empty(len(start))
    if motions:
        motions = [free_motion.with_loads(free_motion.calibrated(motion, gain), trains) for motion in motions]
        free = choose(robot, base, motions, _sum(sweeps, len(start)), prior, start, of)
        prior = wider(prior, free.widened)
        (evidence, free_gains), honest = free.evidence(len(start)), free.honest(len(start))
    others = _sum(sweeps, len(start)).plus(prior).plus(evidence)
    scatter = {joint: _scatter(records, joint) for joint in dict.fromkeys(each.joint for each in equations)}
    # start value only
    noise = {joint: value or 1e-4 * robot.axis(joint).rated_effort for joint, value in scatter.items()}
    at_once = _motion_information(equations, noise, len(start))
    values = _sum(at_once, len(start)).plus(others).solve(start).values
    count = int(sum(np.count_nonzero(prior.sigma) for prior in priors.values()))
    size, by_train = len(start) + count, np.zeros(count)
    before, begin, further = noise, np.zeros(size), np.diag(np.arange(size) >= len(start)).astype(float)
    begin[: len(start)] = start
    known, linear = Information(further, np.zeros(size)).plus(extended(others, size)), equations
    for _ in range(3):  # rounds of weighting, and of the drive trains
        # of stiff trains at first
        unexplained = {} if linear is equations else _unexplained(robot, base, records, linear, values)
        linear = _with_trains(
            robot, base, records, trains, priors, equations, values[: len(start)], by_train, unexplained
        )
        values = _sum(_motion_information(linear, noise, size), size).plus(known).solve(begin).values
        by_train = values[len(start) :]
        misfit = {joint: max(scatter[joint] or 0.0, _misfit(linear, joint, values)) for joint in noise}
        before, noise = noise, {joint: value or noise[joint] for joint, value in misfit.items()}
        finite(np.array(list(noise.values())), ", ".join(noise), "the noise of its trajectories")
    at_once = _marginal(_motion_information(linear, noise, size), len(start))
    alone, moved = _sum(sweeps, len(start)), _sum(at_once, len(start))
    solution = alone.plus(moved).plus(evidence).plus(prior).solve(start)
    by_gain = np.zeros((len(start), len(robot.axes)))
    for joint, own in [*sweeps.items(), *at_once.items()]:
        by_gain[:, robot.index(joint)] += own.vector
    by_gain += free_gains
    spread = [one.std / one.gain for one in ((gains or {}).get(joint) or uncalibrated(robot) for joint in robot.joints)]
    total = np.sqrt(solution.std**2 + (solution.covariance @ by_gain) ** 2 @ np.square(spread))
    left_open = prior.solve(start).std
    std = _shown(solution.std, left_open)
    stds = (
        std,
        np.where(np.isfinite(std), total, np.inf),
        _shown(alone.plus(prior).solve(start).std, left_open),
        _shown(moved.plus(honest).plus(prior).solve(start).std, left_open),
        np.sqrt(base.combination**2 @ parameter_spread(robot, of) ** 2),
    )
    of_runs = _sum(at_once, len(start))
    of_runs = of_runs if free is None else extended(of_runs, len(free.start))
    squares = alone.plus(moved).plus(prior) if free is None else free.fit.information.plus(free.others).plus(of_runs)
    return JointEstimate(
        robot=robot,
        base=base,
        parameters=tuple(
            _judged(name, float(value), *(float(std[k]) for std in stds))
            for k, (name, value) in enumerate(zip(base.names, solution.values, strict=True))
        ),
        solution=solution,
        squares=squares.matrix[: len(start), : len(start)],
        noise=noise,
        noise_change={joint: abs(value / before[joint] - 1) for joint, value in noise.items()},
        scatter=scatter,
        trajectories=tuple(tuple(track.spec.id for track in record.tracks) for record in records),
        free=tuple(motion.ids for motion in motions),
        free_axes={} if free is None else held_out(motions, free.fit, free.others.plus(of_runs), free.start),
        friction={} if free is None else free.friction(robot, base, of_runs, of),
        chosen=free,
        faults=(*_held(equations), *(() if free is None else faults(robot, motions))),
    )


def _all_equations(
    robot: Robot,
    base: BaseParameters,
    records: Sequence[TrajectoryRecord],
    trains: Mapping[str, TwoMassTrain],
    unexplained: Mapping[str, Complex] | None = None,
) -> list["_Equations"]:
    loads = [with_loads(record, trains, unexplained) for record in records]
    return [equation for record in loads for equation in _equations(robot, base, record, trains)]


def _train_priors(
    robot: Robot, records: Sequence[TrajectoryRecord], inertias: Sequence[AxisInertias]
) -> dict[str, SharedPrior]:
    """Drive trains of the axes of simultaneous sweeps before these: of their other sweeps, or of the data sheet with a
    compliance that may be anything.
    """
    fitted = {axis.joint: axis for axis in inertias if axis.train is not None}
    poses = np.array([record.pose for record in records if record.sloped])
    found: dict[str, SharedPrior] = {}
    for joint in dict.fromkeys(track.joint for record in records if record.sloped for track in record.tracks):
        axis = fitted.get(joint)
        if axis is not None and axis.train is not None:
            std = np.zeros(SHARED) if axis.train_std is None else axis.train_std
            found[joint] = SharedPrior(axis.train.as_array(), np.diag(std**2))
            continue
        index = robot.index(joint)
        sheet = shared_prior(robot, index, axis_rows(robot.chain, index, poses) @ inertial_parameters(robot), [])
        # the motor's share of the friction, which does not twist the spring, is open; the damping is kept
        variance = np.diag(sheet.covariance) * np.array([1.0, 1.0, 0.0, 1.0, 0.0])
        found[joint] = SharedPrior(sheet.mean, np.diag(variance))
    return found


def _with_trains(
    robot: Robot,
    base: BaseParameters,
    records: Sequence[TrajectoryRecord],
    trains: Mapping[str, TwoMassTrain],
    priors: Mapping[str, SharedPrior],
    equations: Sequence["_Equations"],
    values: Array,
    moved: Array,
    unexplained: Mapping[str, Complex],
) -> list["_Equations"]:
    """With a column for every parameter of a train with a std, in units of that: the equations of simultaneous sweeps
    linear about trains that differ by `moved` (u,) from their priors, and base parameters `values`. The `unexplained`
    part of an effort moves no load: otherwise a soft spring would explain noise. At the low frequencies of other
    trajectories a train is negligible.
    """
    sloped = [record for record in records if record.sloped]
    if not sloped:
        return list(equations)
    here = {joint: prior.mean.copy() for joint, prior in priors.items()}
    parameters = [(joint, n) for joint, prior in priors.items() for n in np.flatnonzero(prior.sigma).tolist()]
    for (joint, number), away in zip(parameters, moved, strict=True):
        here[joint][number] += away * priors[joint].sigma[number]

    step = 1e-3  # standard deviations: for a derivative

    def with_one(joint: str, number: int) -> list[_Equations]:
        changed = {**here, joint: here[joint] + step * priors[joint].sigma * (np.arange(SHARED) == number)}
        own = {name: TwoMassTrain.of(one) for name, one in changed.items()}
        return _all_equations(robot, base, sloped, {**trains, **own}, unexplained)

    now = with_one(next(iter(here)), SHARED)
    others = [with_one(*parameter) for parameter in parameters]
    found: list[_Equations] = []
    of_sweeps = iter(range(len(now)))
    owners = [record for record in records for _ in record.tracks]
    for one, owner in zip(equations, owners, strict=True):
        if not owner.sloped:
            found.append(replace(one, rows=np.hstack([one.rows, np.zeros((len(one.rows), len(parameters)))])))
            continue
        k = next(of_sweeps)
        columns = [((each[k].rows - now[k].rows) @ values - (each[k].values - now[k].values)) / step for each in others]
        beside = np.stack(columns, -1) if columns else np.zeros((len(one.rows), 0))
        found.append(replace(now[k], rows=np.hstack([now[k].rows, beside]), values=now[k].values + beside @ moved))
    return found


def _marginal(parts: Mapping[str, Information], size: int) -> dict[str, Information]:
    """By joint, on the first `size` parameters alone; the others have a prior with information 1. They are shared, so
    only the sum over the joints is an information.
    """
    whole = reduce(Information.plus, parts.values()) if parts else Information.empty(size)
    inner = whole.matrix[size:, size:]
    through = np.linalg.solve(inner + np.eye(len(inner)), whole.matrix[size:, :size])
    found: dict[str, Information] = {}
    for joint, own in parts.items():
        share = own.matrix[:size, size:] @ through
        matrix = own.matrix[:size, :size] - (share + share.T) / 2
        found[joint] = Information(matrix, own.vector[:size] - through.T @ own.vector[size:], own.count)
    return found


@dataclass(frozen=True)
class _Equations:
    """Harmonics of one axis along one trajectory, real and imaginary parts, with ripple and reversals eliminated."""

    joint: str
    rows: Array  # (m, r)
    values: Array  # (m,)
    freedom: int  # m minus the number of eliminated parameters
    held: float  # s, while friction holds an axis that should turn: then all is eliminated


def _equations(
    robot: Robot, base: BaseParameters, record: TrajectoryRecord, trains: Mapping[str, TwoMassTrain]
) -> list[_Equations]:
    # Hz; sign and cogging extend far above the band
    slow, fast = (round(rate * record.period) for rate in (Sampling.link_rate, 2000.0))
    motor, load = (record.motion(robot, fast, load=of_load) for of_load in (False, True))
    links = link_rows(robot.chain, robot.gravity, record.motion(robot, slow, load=True))
    # a base parameter may contain the rotor and its link: both with the load's acceleration
    drive = JointMotion(motor.position, motor.velocity, load.acceleration)
    count, sloped, joints = len(record.frequency), record.sloped, len(robot.axes)
    equations: list[_Equations] = []
    for track in record.tracks:
        index = robot.index(track.joint)
        drives = np.zeros((count, 4 * joints), dtype=complex)
        drives[:, index::joints] = _harmonics(drive_along(drive, index)[:, index::joints], count)
        rows = _real(np.hstack([_harmonics(links[:, index], count), drives])[:, list(base.columns)])
        train = trains.get(track.joint)
        rotor = train.motor_inertia if train else robot.axis(track.joint).reflected_motor_inertia or 0.0
        ahead = _harmonics(motor.acceleration[:, [index]] - load.acceleration[:, [index]], count)
        values = _real(track.effort[:, None] - rotor * ahead)[:, 0]
        ripple = cogging(robot, index, motor.position[:, index])
        reversals = _reversals(motor.velocity[:, index], load.velocity[:, index])
        beside = _harmonics(np.hstack([ripple, reversals]), count)
        if sloped:
            beside = np.hstack([beside, _jump(count)])
        stuck = sum(one.stop - one.start for one in held(motor.position[:, index], 2000.0, track.slope)) / 2000.0
        # what friction held would twist the spring
        spanned = np.eye(len(values)) if stuck else span(_real(beside))
        equations.append(
            _Equations(
                joint=track.joint,
                rows=rows - spanned @ (spanned.T @ rows),
                values=values - spanned @ (spanned.T @ values),
                freedom=len(values) - spanned.shape[1],
                held=stuck,
            )
        )
    return equations


def _unexplained(
    robot: Robot,
    base: BaseParameters,
    records: Sequence[TrajectoryRecord],
    equations: Sequence[_Equations],
    values: Array,
) -> dict[str, Complex]:
    """What moves no load, by sweep, as harmonics (h + 1,), with the first parameters of `values`: the residuals, and
    the motor's dry friction and offset.
    """
    tracks = [track for record in records for track in record.tracks]
    dry, offset = whole_parameters(robot, base, values[: len(base.columns)]).reshape(14, -1)[12:]
    found: dict[str, Complex] = {}
    for track, own in zip(tracks, equations, strict=True):
        left, count = own.values - own.rows @ values[: own.rows.shape[1]], len(track.effort)
        still = dry[robot.index(track.joint)] * np.sign(track.slope) + offset[robot.index(track.joint)]
        found[track.spec.id] = np.append(np.sqrt(2) * left[0] + still, left[1:count] + 1j * left[count:])
    return found


def _held(equations: Sequence[_Equations]) -> list[str]:
    found: list[str] = []
    for joint in dict.fromkeys(each.joint for each in equations if each.held):
        own = [each.held for each in equations if each.joint == joint]
        found.append(
            f"friction holds {joint} for up to {max(own):.2g} s in {np.count_nonzero(own)} of {len(own)} simultaneous "
            "sweeps, limit 0.1 s: its torque in these is not used. Check gain and reset time of its speed control, or "
            "measure it alone"
        )
    return found


def _harmonics(signals: Array, count: int) -> Complex:
    """Harmonics 0 to count - 1 (count, p) of signals (n, p) over one period."""
    transform: Complex = np.fft.rfft(signals, axis=0)
    return transform[:count] / len(signals)


def _jump(count: int) -> Complex:
    """(count, 2): harmonics of a straight line over the window, and of the instant at which it jumps back."""
    number = np.arange(count)
    line: Complex = np.where(number > 0, 1j / (2 * np.pi * np.maximum(number, 1)), 0)
    return np.stack([line, np.ones(count, dtype=complex)], -1)


def _real(harmonics: Complex) -> Array:
    """(h + 1, p) -> (2 h + 1, p), every row with the same noise: that of the mean is larger by the square root
    of two.
    """
    return np.vstack([harmonics[:1].real / np.sqrt(2), harmonics[1:].real, harmonics[1:].imag])


def _reversals(*velocities: Array) -> Array:
    """(n, 2 reversals): a step and a slope over every interval in which motor or load is near standstill."""
    still = np.any([np.abs(velocity) < Sampling.still * np.abs(velocity).max() for velocity in velocities], axis=0)
    return torques_within(stretches(still), len(still)).T


def _motion_information(equations: Sequence[_Equations], noise: dict[str, float], size: int) -> dict[str, Information]:
    """By joint."""
    information = {joint: Information.empty(size) for joint in noise}
    for each in equations:
        covariance = noise[each.joint] ** 2 * np.eye(len(each.values))
        information[each.joint] = information[each.joint].add(each.rows, each.values, covariance)
    return information


def _sweep_information(robot: Robot, base: BaseParameters, inertias: Sequence[AxisInertias]) -> dict[str, Information]:
    """By joint."""
    return {
        axis.joint: Information.empty(len(base.columns)).add(
            _inertia_rows(robot, base, axis.joint, axis.poses), axis.values, axis.covariance
        )
        for axis in inertias
    }


def _sum(parts: Mapping[str, Information], size: int) -> Information:
    return reduce(Information.plus, parts.values(), Information.empty(size))


def _inertia_rows(robot: Robot, base: BaseParameters, joint: str, poses: Array) -> Array:
    """Rows (m, r) of the inertia about an axis, which does not depend on friction and offsets."""
    rows = axis_rows(robot.chain, robot.index(joint), poses)
    rows[np.abs(rows) < 1e-12] = 0.0  # otherwise a column of rounding errors would count as data
    return np.hstack([rows, np.zeros((len(rows), 3 * len(robot.axes)))])[:, list(base.columns)]


def _scatter(records: Sequence[TrajectoryRecord], joint: str) -> float | None:
    """RMS of the noise of an axis' harmonics over the records that contain it."""
    noise = [t.noise for record in records for t in record.tracks if t.joint == joint and t.noise is not None]
    return float(np.sqrt(np.mean(np.square(noise)))) if noise else None


def _misfit(equations: Sequence[_Equations], joint: str, values: Array) -> float:
    """RMS of the residual of an axis' harmonics, with the parameters' degrees of freedom distributed evenly."""
    own = [each for each in equations if each.joint == joint]
    squares = sum(float(np.sum((each.values - each.rows @ values) ** 2)) for each in own)
    freedom = sum(each.freedom for each in own)
    whole = sum(each.freedom for each in equations)
    return float(np.sqrt(squares / max(freedom * (1 - len(values) / whole), 1.0)))


def _shown(std: Array, left_open: Array) -> Array:
    """Standard deviations (r,), inf if the prior alone has nearly the same."""
    # above, no measurement shows the parameter
    return np.where(std < 0.9 * left_open, std, np.inf)


def _judged(
    name: str, value: float, std: float, total: float, by_sweeps: float, by_trajectories: float, nominal: float
) -> results.CombinedParameter:
    one_source = 1.5  # times the standard deviation of both together: below, one source is sufficient
    alone = (by_sweeps <= one_source * std, by_trajectories <= one_source * std)
    source = {(True, True): "either", (True, False): "sweeps", (False, True): "trajectories"}.get(alone, "both")
    reason = ""
    if not np.isfinite(std):
        source, reason = "none", "no sweep and no trajectory shows it"
    elif std > IDENTIFIED * nominal:
        reason = f"too weakly excited: standard deviation {std:.3g}, the nominal model's is {nominal:.3g}"
    # it is positive on every robot
    elif name.startswith(POSITIVE_NAMES) and " " not in name and std > 0.5 * abs(value):
        reason = f"the standard deviation {std:.3g} is above half of the value"
    return results.CombinedParameter(
        name=name,
        value=value,
        std=_finite(std),
        std_total=_finite(total),
        std_sweeps=_finite(by_sweeps),
        std_trajectories=_finite(by_trajectories),
        std_nominal=nominal,
        source=source,
        identified=not reason,
        reason=reason,
    )


def combined_parameters(found: JointEstimate) -> NearestPhysical:
    """Parameters of the whole robot. A motor without data sheet is nominally what its axis has more than the links of
    CAD, a tenth of it at least. CAD is in the base parameters already: it counts a hundredth of its information again.

    Where no physical robot has the base parameters, it is the one whose efforts differ least along the measured motion,
    with friction as identified: the covariance is wide where the model's errors are, but its predictions need not be.
    """
    robot, count = found.robot, 11 * len(found.robot.axes)
    own = np.array(found.base.columns) < count
    middle = np.mean(joint_ranges(robot.chain), axis=0)[None]
    nominal, spread = np.zeros(len(robot.axes)), np.ones(len(robot.axes))
    for k, axis in enumerate(robot.axes):
        if axis.reflected_motor_inertia:
            nominal[k], spread[k] = axis.reflected_motor_inertia, robot.prior.motor_inertia
            continue
        whole = abs(float(found.inertia(axis.joint, middle)[0]))
        links = float((inertia_rows(robot.chain, k, middle) @ robot.chain.inertial.ravel())[0])
        nominal[k] = max(whole - links, 0.1 * whole)
    rows, values, among = found.base.combination[own, :count], found.solution.values[own], np.ix_(own, own)
    nearest = nearest_physical(
        np.concatenate([robot.chain.inertial.ravel(), nominal]),
        (10 * robot.prior.inertia, 10 * spread),
        rows,
        values,
        scaled_inverse(found.squares[among]),
    )
    if nearest.ended is SearchEnded.EXACT:
        return nearest
    away = rows @ nearest.parameters - values
    return replace(nearest, deviation=float(np.sqrt(away @ scaled_inverse(found.solution.covariance[among]) @ away)))


def combination_document(combination: JointEstimate) -> results.Combination:
    """All numbers; a standard deviation that a source does not determine is None.

    `became_identifiable`: names of the parameters that are identified by sweeps and trajectories only together.
    """
    parameters, standard, chosen = combination.parameters, combined_parameters(combination), combination.chosen
    fit = None if chosen is None else results.FreeMotionFit(simple_estimator=SIMPLE, prior_widened=chosen.widened)
    return results.Combination(
        base_parameters=parameters,
        became_identifiable=tuple(one.name for one in parameters if _by_combination(one)),
        trajectories=combination.trajectories,
        noise={
            joint: results.EffortNoise(harmonic=noise, scatter=combination.scatter[joint]).with_nonempty(
                warning=unsettled(combination.noise_change[joint])
            )
            for joint, noise in combination.noise.items()
        },
        free_motions=combination.free,
        free_motion_axes={joint: _free_motion_axis(combination, joint) for joint in combination.free_axes},
        covariance=tuple(map(tuple, combination.solution.covariance.tolist())),
        standard_parameters=standard_document(combination.robot, standard),
        physical=physical_document(standard),
    ).with_nonempty(free_motion_fit=fit, warnings=_warnings(combination, standard.deviation))


def _by_combination(parameter: results.CombinedParameter) -> bool:
    """Identified, though neither source alone identifies it."""
    alone = [one for one in (parameter.std_sweeps, parameter.std_trajectories) if one is not None]
    return parameter.identified and min(alone, default=np.inf) > IDENTIFIED * (parameter.std_nominal or 0.0)


def _free_motion_axis(combination: JointEstimate, joint: str) -> results.FreeMotionAxis:
    axis, chosen = combination.free_axes[joint], combination.chosen
    found = results.FreeMotionAxis(
        residual_rms=axis.residual,
        held_out_rms=axis.error,
        held_out_percent=100 * axis.error / combination.robot.axis(joint).rated_effort,
        noise_floor_rms=axis.floor,
    )
    if chosen is None:
        return found
    moved = chosen.fit.moved
    warning = f"the fit of the free motions still moved by {moved:.2g} standard deviations in its last round"
    return found.with_nonempty(
        simple_held_out_rms=chosen.simple[joint],
        friction=_friction(combination, joint),
        lacks=chosen.fit.evidence.lacks.get(joint, ()),
        # standard deviations
        warning=warning if moved > 0.5 else "",
    )


def _friction(combination: JointEstimate, joint: str) -> tuple[results.FrictionPoint, ...]:
    law = combination.friction.get(joint)
    if law is None:
        return ()
    points = zip(law.speeds.tolist(), law.whole.tolist(), law.std.tolist(), strict=True)
    return tuple(results.FrictionPoint(velocity=speed, effort=effort, std=std) for speed, effort, std in points)


def _warnings(combination: JointEstimate, deviation: float) -> tuple[str, ...]:
    """What no robot can have, with the next step."""
    sign = (
        "The effort of this axis and its velocity seem to count in opposite directions: change the sign of one of them"
    )
    check = "Check signs and units of the efforts, the gear ratios and gravity's direction, or record a longer motion"
    far = 3.0  # standard deviations: greatest distance of the base parameters from those of a physical robot
    robot = combination.robot
    found = list(combination.faults)
    for one in combination.parameters:
        if not one.name.startswith(POSITIVE_NAMES) or " " in one.name or one.std is None:
            continue
        if one.value + 2 * one.std < 0:
            mend = sign if one.name.startswith("Fc(") else check
            found.append(f"{one.name} is {one.value:.3g} ± {one.std:.2g}: it is positive on every robot. {mend}")
    # poses of the workspace
    poses = spread_evenly(200, *joint_ranges(robot.chain))
    for joint in robot.joints:
        least = float(combination.inertia(joint, poses).min())
        if least <= 0:
            found.append(f"the inertia of {joint} is {least:.3g} in a pose: it is positive on every robot. {check}")
    if deviation > far:
        found.append(
            f"no robot of rigid bodies has these base parameters: the nearest is {deviation:.1f} standard deviations "
            f"away, limit {far:g}. {check}"
        )
    return tuple(found)


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
