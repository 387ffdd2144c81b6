r"""From the spectra of a campaign to its estimate: axis inertias, base parameters, Table 1.

For each axis the periodic sweeps are fitted jointly (`joint_fit`), free records one by one (`time_domain`). The
inertias J with their covariance C are then the right-hand side of  J = W beta  over all axes (`least_squares`), W in
the base parameters of the chain in which every joint that never moved is locked. Whatever the order in which sweeps
came in, the same set of spectra gives the same estimate: they are sorted by sweep id first.

A torque constant that is wrong by 5 % scales every J by 5 % and no sweep shows it: `std` is conditional on the gain,
`std_total` includes its prior.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from service.errors import BadInput
from service.identification.axis_inertia import paper_inertia
from service.identification.base_parameters import BaseParameters, base_parameters, condition_number, joint_ranges
from service.identification.frequency_response import Spectrum
from service.identification.joint_fit import JointFit, PosePrior, SharedPrior, fit_axis
from service.identification.least_squares import Information, Solution
from service.identification.regressor import axis_rows, gravity_terms, lock
from service.identification.time_domain import fit_record
from service.robot import Robot
from service.urdf import Chain

Array = NDArray[np.float64]

SAME_POSITION = 2e-3  # rad (m): a joint whose position differs by less over all sweeps was locked
NOISE_GUESS = 0.002  # of the rated effort: start value only, the noise is then estimated
WORKSPACE = 2000  # poses that stand for the workspace where no collision-free grid is given


@dataclass(frozen=True)
class SweepInertia:
    """One sweep's result, SI on the joint side. `response` rows: frequency Hz, Z complex, std of its parts."""

    sweep: str
    value: float
    std: float
    std_total: float
    reference: float  # of the nominal model in that pose
    paper_value: float | None  # equation (8) at the ideal sweep frequency; None without lines
    viscous_friction: float
    response: tuple[tuple[float, complex, float], ...]
    terms: dict[str, tuple[float, float]]  # of a free record: the other terms' value and std


@dataclass(frozen=True)
class AxisEstimate:
    """Result of one axis: its sweeps, covariance (n, n) of their inertias, and the joint fit of the periodic ones."""

    joint: str
    sweeps: tuple[SweepInertia, ...]
    covariance: Array
    fit: JointFit | None


@dataclass(frozen=True)
class Estimate:
    """Everything a set of spectra tells of a robot."""

    robot: Robot
    chain: Chain  # unlocked joints only
    unlocked: tuple[int, ...]  # their numbers in the robot
    poses: Array  # (k, all joints) of the sweeps, by sweep id
    axes: tuple[AxisEstimate, ...]
    base: BaseParameters
    nominal: Array  # (11 n,) parameters of the model
    solution: Solution
    condition_number: float
    observation: dict[str, Array]  # rows (n, r) of each axis' sweeps in the base parameters

    @cached_property
    def workspace(self) -> Array:
        """Quasi-random poses (m, all joints) over the limits of the unlocked joints; the locked ones stay locked."""
        lower, upper = joint_ranges(self.chain)
        poses = np.tile(self.poses.mean(axis=0), (WORKSPACE, 1))
        poses[:, list(self.unlocked)] = qmc.scale(
            qmc.Halton(len(lower), scramble=False).random(WORKSPACE), lower, upper
        )
        return poses

    def identified(self, joint: str, poses: Array) -> Array:
        """Identified inertia (m,) of an axis at poses (m, all joints), kg m^2 (kg)."""
        return self._rows(joint, poses[:, list(self.unlocked)]) @ self.solution.values

    def identified_std(self, joint: str, poses: Array) -> Array:
        """Standard deviation (m,) of `identified`, conditional on the torque gain."""
        rows = self._rows(joint, poses[:, list(self.unlocked)])
        return np.sqrt(np.maximum(np.einsum("mi,ij,mj->m", rows, self.solution.covariance, rows), 0.0))

    def reference(self, joint: str, poses: Array) -> Array:
        """Inertia (m,) of the nominal model."""
        return axis_rows(self.chain, self._own(joint), poses[:, list(self.unlocked)]) @ self.nominal

    def model_at_sweeps(self, joint: str) -> Array:
        """Identified inertia (n,) of an axis in the poses of its own sweeps."""
        return self.observation[joint] @ self.solution.values

    def _own(self, joint: str) -> int:
        return self.unlocked.index(self.robot.index(joint))

    def _rows(self, joint: str, poses: Array) -> Array:
        return self.base.rows(self.chain, self._own(joint), poses)


def identify(robot: Robot, spectra: Sequence[Spectrum]) -> Estimate:
    """The estimate from these spectra; BadInput when none of them shows inertia (noise and standstill do not)."""
    spectra = sorted((s for s in spectra if s.spec.shows_inertia), key=lambda spectrum: spectrum.spec.id)
    if not spectra:
        raise BadInput("estimate", "there is no sweep to identify from")
    poses = np.array([spectrum.spec.pose for spectrum in spectra])
    moved = {robot.index(spectrum.spec.axis) for spectrum in spectra}
    fixed = {
        number: float(poses[:, number].mean())
        for number in range(len(robot.axes))
        if number not in moved and np.ptp(poses[:, number]) < SAME_POSITION
    }
    unlocked = tuple(number for number in range(len(robot.axes)) if number not in fixed)
    chain = lock(robot.chain, fixed)
    motors = [robot.axes[number].reflected_motor_inertia or 0.0 for number in unlocked]
    nominal = np.concatenate([chain.inertial.ravel(), motors])
    base = base_parameters(chain, tuple(unlocked.index(number) for number in sorted(moved)))

    axes: list[AxisEstimate] = []
    information = Information.empty(len(base.columns))
    observation: dict[str, Array] = {}
    for number in sorted(moved):
        own = [spectrum for spectrum in spectra if robot.index(spectrum.spec.axis) == number]
        axis = _identify_axis(robot, number, chain, unlocked, nominal, own)
        axes.append(axis)
        rows = base.rows(chain, unlocked.index(number), np.array([s.spec.pose for s in own])[:, list(unlocked)])
        values = np.array([sweep.value for sweep in axis.sweeps])
        information = information.add(rows, values, axis.covariance)
        observation[axis.joint] = rows
    return Estimate(
        robot=robot,
        chain=chain,
        unlocked=unlocked,
        poses=poses,
        axes=tuple(axes),
        base=base,
        nominal=nominal,
        solution=information.solve(base.combination @ nominal),
        condition_number=condition_number(np.vstack(list(observation.values()))),
        observation=observation,
    )


def _identify_axis(
    robot: Robot, number: int, chain: Chain, unlocked: tuple[int, ...], nominal: Array, spectra: list[Spectrum]
) -> AxisEstimate:
    own = unlocked.index(number)
    poses = np.array([spectrum.spec.pose for spectrum in spectra])[:, list(unlocked)]
    reference = axis_rows(chain, own, poses) @ nominal
    gravity = gravity_terms(chain, nominal, robot.gravity, own, poses)
    periodic = [k for k, spectrum in enumerate(spectra) if spectrum.spec.periodic]
    sweeps: dict[int, SweepInertia] = {}
    covariance = np.zeros((len(spectra), len(spectra)))
    fit = None
    if periodic:
        fit = fit_axis(
            [spectra[k] for k in periodic],
            shared_prior(robot, number, reference, [spectra[k] for k in periodic]),
            [pose_prior(robot, number, reference[k], gravity[k]) for k in periodic],
            NOISE_GUESS * robot.axes[number].rated_effort,
        )
        covariance[np.ix_(periodic, periodic)] = fit.covariance
        for row, k in enumerate(periodic):
            sweeps[k] = _from_joint_fit(robot, spectra[k], float(reference[k]), fit, row)
    for k, spectrum in enumerate(spectra):
        if not spectrum.spec.periodic:
            sweeps[k] = _from_record(robot, spectrum, float(reference[k]))
            covariance[k, k] = sweeps[k].std ** 2
    return AxisEstimate(robot.joints[number], tuple(sweeps[k] for k in sorted(sweeps)), covariance, fit)


def _from_joint_fit(robot: Robot, spectrum: Spectrum, reference: float, fit: JointFit, row: int) -> SweepInertia:
    value, std = float(fit.inertia[row]), float(np.sqrt(fit.covariance[row, row]))
    response = _lines(spectrum, float(fit.noise[row]))
    return SweepInertia(
        sweep=spectrum.spec.id,
        value=value,
        std=std,
        std_total=float(np.hypot(std, robot.prior.effort_gain * value)),
        reference=reference,
        paper_value=_paper_value(response, fit, row),
        viscous_friction=fit.train.motor_friction + fit.train.load_friction,
        response=response,
        terms={},
    )


def _paper_value(response: tuple[tuple[float, complex, float], ...], fit: JointFit, row: int) -> float:
    """Equation (8) at the line nearest to the paper's ideal frequency (section 4.2).

    That is the geometric mean of the locked-rotor frequency and the corner mu/(2 pi J) below which friction rules.
    """
    friction = max(fit.train.motor_friction + fit.train.load_friction, 0.0)
    corner = friction / (2 * np.pi * float(fit.inertia[row]))
    resonance = fit.train.locked_rotor_frequency(float(fit.load_inertia[row]))
    ideal = np.sqrt(corner * resonance)
    frequency, z, _ = min(response, key=lambda line: abs(line[0] - ideal))
    return paper_inertia(frequency, z)


def _from_record(robot: Robot, spectrum: Spectrum, reference: float) -> SweepInertia:
    fit = fit_record(spectrum)
    return SweepInertia(
        sweep=spectrum.spec.id,
        value=fit.inertia,
        std=fit.inertia_std,
        std_total=float(np.hypot(fit.inertia_std, robot.prior.effort_gain * fit.inertia)),
        reference=reference,
        paper_value=None,
        viscous_friction=fit.terms["viscous_friction"][0],
        response=(),
        terms=fit.terms,
    )


def _lines(spectrum: Spectrum, noise: float) -> tuple[tuple[float, complex, float], ...]:
    return tuple(
        (float(frequency), complex(effort / velocity), float(noise / abs(velocity)))
        for frequency, effort, velocity in zip(
            spectrum.frequency[spectrum.line],
            spectrum.effort[spectrum.line],
            spectrum.velocity[spectrum.line],
            strict=True,
        )
    )


def _typical(robot: Robot, number: int, reference: Array, spectra: list[Spectrum]) -> float:
    """The size of an axis' inertia: the model's; as measured if the rotor, which may outweigh all links, is unknown."""
    if robot.axes[number].reflected_motor_inertia:
        return float(np.median(reference))
    first = [int(np.argmax(spectrum.line)) for spectrum in spectra]
    response = [abs((s.effort[k] / s.velocity[k]).imag) / s.frequency[k] for s, k in zip(spectra, first, strict=True)]
    return float(np.median(response)) / (2 * np.pi)


def shared_prior(robot: Robot, number: int, reference: Array, spectra: list[Spectrum]) -> SharedPrior:
    """The data sheet's drive train. What it does not know (null, or zero) gets a spread wide enough not to matter.

    `reference` (m,): the model's inertias in the axis' poses.
    """
    axis, prior = robot.axes[number], robot.prior
    typical = _typical(robot, number, reference, spectra)
    motor = axis.reflected_motor_inertia
    motor_mean, motor_sigma = (motor, prior.motor_inertia * motor) if motor else (0.5 * typical, 0.5 * typical)
    friction = axis.viscous_friction
    # a corner frequency of 1 Hz where nothing is known; half of it on either side of the spring
    total, spread = (friction, prior.viscous_friction) if friction else (2 * np.pi * typical, 1.0)
    half = total / 2
    half_sigma = max(2 * spread, 1.0) * half
    softest = 1 / (typical * (2 * np.pi * 3.0) ** 2)  # locked rotor at 3 Hz
    return SharedPrior(
        mean=np.array([motor_mean, half, half, 0.0, 1e-3]),
        sigma=np.array([motor_sigma, half_sigma, half_sigma, softest, 2e-3]),
    )


def pose_prior(robot: Robot, number: int, reference: float, gravity: Array) -> PosePrior:
    """The model's axis inertia and `gravity` (2,) torque and stiffness in a pose, and how far they may be off."""
    motor = robot.axes[number].reflected_motor_inertia or 0.0
    load = max(reference - motor, 0.1 * reference)
    # torque and stiffness are two components of one vector: either may be off by the error of its length
    spread = robot.prior.gravity * float(np.hypot(*gravity)) + 1e-3 * robot.axes[number].rated_effort
    return PosePrior(
        mean=np.array([load, gravity[1], gravity[0]]),
        sigma=np.array([2 * robot.prior.inertia * reference, spread, spread]),
    )
