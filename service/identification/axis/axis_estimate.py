r"""The inertias of one axis from its spectra: periodic sweeps jointly (`joint_fit`), free records one by one.

A torque constant that is wrong by 5 % scales every J by 5 %, and no sweep can detect it. `std` is conditional on the
gain; `std_total` includes the uncertainty of the gain. A gain calibrated by a test mass (`torque_gain`) is removed from
the effort first.

Known effects of the robot are removed first (`known_effects`), or enter the priors of spring and hose. Their
uncertainty is part of every standard deviation. Load-dependent friction requires the load; that fit is therefore
repeated with the inertias it found.

A free record is fitted as a rigid axis. If the drive train is known from other data (sweeps with lines, an initial
analysis), its impedance Z gives the error of that: the rigid fit yields the mean of Re Z/s weighted by the power of the
acceleration. The difference is added to the standard deviation, and the sweep gets a warning.

Separates noise and nonlinear distortion: sweeps of one pose that differ only in their phases (`realisations`).

The robust method for the best linear approximation (Pintelon and Schoukens, System RobotEstimate, 2012, sec.
4.3.1). A nonlinearity responds to sines at the lines and at other multiples of 1/period. At a line, part of its
response is linear and equal for all phases; the phase of the other part depends on all other phases. Over random
phases that part has the mean 0 and scatters like noise, but not between periods. Of M realisations, with D the
effort at a line that the linear model does not explain,

    s^2 = sum_m |D_m / Omega_m - mean|^2 / (M - 1)    estimates    (noise^2 + distortion^2) / |Omega|^2 .

The noise is the difference between the P periods of a window: the bins that are no multiple of 1/period; for each
multiple those that are nearest to it. The residual of the model contains no ripple and no drift of gravity, which would
be taken for noise. The noise absorbed by the sweep's own parameters is restored by their leverage. Multiples of
1/period without a sine contain only noise and distortion.

The friction of the axis distorts in all poses: variances of effort are pooled over the groups of an axis, weighted
by their degrees of freedom. A fitted inertia or stiffness of a sweep absorbs part of its distortion; D contains it
again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from service.identification.axis.drive_train import (
    TwoMassTrain,
    impedance,
    paper_inertia,
    stack_residual,
    stacks,
)
from service.identification.axis.ideal_frequency import InitialAnalysis
from service.identification.axis.joint_fit import JointFit, fit_axis
from service.identification.axis.known_effects import LOAD, Corrected, KnownAxis, corrected
from service.identification.axis.nominal_priors import (
    NOISE_GUESS,
    PosePrior,
    SharedPrior,
    TorqueGain,
    gear_load,
    pose_prior,
    shared_prior,
    with_known_hose,
    with_known_spring,
)
from service.identification.model import axis_rows, gravity_terms, unsettled
from service.identification.spectra.frequency_response import Spectrum
from service.identification.spectra.time_domain import fit_record
from service.model import Array, Chain, Complex, Robot
from service.model.results.estimate import Suspect

SAME_SINES = 1e-6  # relative, of frequencies and amplitudes; phases, rad


@dataclass(frozen=True)
class AxisDistortion:
    """Distortion of one axis, at the multiples (h,) of 1/period in use: standard deviation of the real and of the
    imaginary part of an effort bin, N m (N). `realisations`: largest number in one pose; `groups`: number of poses
    with several.
    """

    frequency: Array
    noise: Array
    distortion: Array
    realisations: int
    groups: int

    def spread(self, spectrum: Spectrum) -> Array:
        """Standard deviation of each bin (b,) relative to the noise."""
        ratio = np.ones(len(spectrum.frequency))
        for frequency, noise, distortion in zip(self.frequency, self.noise, self.distortion, strict=True):
            ratio[np.abs(spectrum.frequency - frequency) < SAME_SINES * frequency] = np.hypot(1.0, distortion / noise)
        return ratio


def distortion_of(
    spectra: Sequence[Spectrum], uncertain: Sequence[Complex], fit: JointFit, before: AxisDistortion | None = None
) -> AxisDistortion | None:
    """Distortion from the sweeps of one axis and their joint fit, which was made with the distortion `before`.

    None if no two sweeps are realisations of one sweep.
    """
    groups = _groups(spectra)
    if not groups:
        return None
    squares: dict[float, list[tuple[float, float]]] = {}  # by frequency: excess variance of effort, its weight
    noises: dict[float, list[tuple[float, float]]] = {}
    for members in groups:
        left, by_load, free = zip(*(_left(spectra[k], uncertain[k], fit, k, before) for k in members), strict=True)
        mean = np.mean([fit.own[k][:2] for k in members], axis=0)
        full = [
            rest + (fit.own[k][:2] - mean) @ columns for rest, columns, k in zip(left, by_load, members, strict=True)
        ]
        one = spectra[members[0]]
        period, periods = one.spec.period or 1.0, one.spec.periods or 1
        number = np.round(one.frequency * period * periods).astype(int)
        for place in np.flatnonzero(number % periods == 0):
            between = (np.abs(number - number[place]) <= periods // 2) & (number % periods != 0)
            if not between.any():
                continue
            frequency = round(float(one.frequency[place]), 9)
            freedom = float(np.sum([one_free[between] for one_free in free]))
            noise = float(np.sum([np.abs(rest[between]) ** 2 for rest in left])) / freedom
            noises.setdefault(frequency, []).append((noise, freedom))
            if one.line[place]:
                answer = np.array(
                    [rest[place] / spectra[k].velocity[place] for rest, k in zip(full, members, strict=True)]
                )
                size = float(np.mean([np.abs(spectra[k].velocity[place]) ** 2 for k in members]))
                total, freedom = float(np.var(answer, ddof=1)) * size, len(members) - 1
            else:
                freedom = float(np.sum([one_free[place] for one_free in free]))
                total = float(np.sum([np.abs(rest[place]) ** 2 for rest in left])) / freedom
            squares.setdefault(frequency, []).append((total - noise, freedom))
    frequencies = sorted(squares)
    return AxisDistortion(
        frequency=np.array(frequencies),
        noise=np.array([np.sqrt(_mean(noises[f]) / 2) for f in frequencies]),
        distortion=np.array([np.sqrt(max(_mean(squares[f]), 0.0) / 2) for f in frequencies]),
        realisations=max(len(members) for members in groups),
        groups=len(groups),
    )


def _groups(spectra: Sequence[Spectrum]) -> list[list[int]]:
    """Numbers of the sweeps that differ only in their phases, two or more."""
    alike: dict[tuple[object, ...], list[int]] = {}
    for k, one in enumerate(spectra):
        if (one.spec.periods or 0) > 1:
            alike.setdefault(but_phases(one), []).append(k)
    return [members for members in alike.values() if len(members) > 1 and _differ([spectra[k] for k in members])]


def but_phases(spectrum: Spectrum) -> tuple[object, ...]:
    """Equal for sweeps that differ only in their phases."""
    spec = spectrum.spec
    sines = tuple((round(sine.frequency, 6), float(f"{sine.amplitude:.6g}")) for sine in spec.sines)
    key = (tuple(np.round(spec.pose, 3)), float(f"{spec.offset_velocity:.6g}"), sines, spec.period, spec.periods)
    return *key, spectrum.samples


def _differ(spectra: Sequence[Spectrum]) -> bool:
    """Whether no two neighbours have the same phases: repeats contain no information on distortion."""
    phases = sorted(tuple(sine.phase for sine in one.spec.sines) for one in spectra)
    return all(np.abs(np.subtract(one, other)).max() > SAME_SINES for one, other in pairwise(phases))


def _left(
    spectrum: Spectrum, uncertain: Complex, fit: JointFit, number: int, before: "AxisDistortion | None"
) -> tuple[Complex, Complex, Array]:
    """Effort of a sweep not explained by the fit (b,), its derivatives by load inertia and gravity stiffness (2, b),
    and the part of each bin that its own parameters left free (b,).
    """
    (stack,) = stacks([spectrum], [uncertain])
    residual, _, by_own = stack_residual(stack, fit.shared, fit.own[number][None])
    weight = 1 / (np.ones(len(spectrum.frequency)) if before is None else before.spread(spectrum))
    columns = np.concatenate([(by_own[0] * weight).real, (by_own[0] * weight).imag], axis=1).T  # (2 b, p)
    length = np.linalg.norm(columns, axis=0)
    basis, singular, _ = np.linalg.svd(columns / np.where(length > 0, length, 1.0), full_matrices=False)
    # own parameters that no bin separates count as one
    taken = np.sum(basis[:, singular > 1e-6 * singular[0]] ** 2, axis=1)
    parts = taken.reshape(2, -1).sum(axis=0)
    # a twentieth of a bin is always free
    return residual[0], by_own[0, :2], np.maximum(1 - parts / 2, 0.05)


def _mean(values: Sequence[tuple[float, float]]) -> float:
    return sum(value * weight for value, weight in values) / sum(weight for _, weight in values)


@dataclass(frozen=True)
class FittedSweep:
    """Result of one sweep, SI on the joint side. `response` rows: frequency Hz, Z complex, std of its parts."""

    sweep: str
    value: float
    std: float
    std_total: float
    bound: float | None  # Cramer-Rao bound of std if everything but this inertia is known; None without lines
    reference: float  # of the nominal model in that pose
    paper_value: float | None  # equation (8) at the ideal sweep frequency; None without lines
    viscous_friction: float
    response: tuple[tuple[float, complex, float], ...]
    terms: dict[str, tuple[float, float]]  # of a free record: the other terms' value and std
    warning: str | None = None
    noise: tuple[float, ...] | None = None  # noise part of the std of `response`; the rest is distortion


@dataclass(frozen=True)
class AxisEstimate:
    """Result of one axis: its sweeps, covariance (n, n) of their inertias, and the joint fit of the periodic ones."""

    joint: str
    sweeps: tuple[FittedSweep, ...]
    covariance: Array
    fit: JointFit | None
    gain: TorqueGain
    suspects: tuple[Suspect, ...]
    distortion: AxisDistortion | None  # only if the axis has several realisations of its sweeps
    direct_encoder: bool  # every sweep with lines has the measured motion of the load

    @property
    def values(self) -> Array:
        """(n,) inertias."""
        return np.array([sweep.value for sweep in self.sweeps])

    def with_covariance(self, covariance: Array) -> "AxisEstimate":
        """The same inertias with another covariance (n, n)."""
        sweeps = tuple(
            replace(sweep, std=float(std), std_total=total_std(sweep.value, float(std), self.gain))
            for sweep, std in zip(self.sweeps, np.sqrt(np.diag(covariance)), strict=True)
        )
        return replace(self, sweeps=sweeps, covariance=covariance)


def identify_axis(
    robot: Robot,
    number: int,
    chain: Chain,
    unlocked: tuple[int, ...],
    nominal: Array,
    spectra: Sequence[Spectrum],
    analysis: InitialAnalysis | None,
    gain: TorqueGain,
    known: KnownAxis,
) -> AxisEstimate:
    """Axis `number` of the robot; `chain` holds its joints `unlocked`, `nominal` (11 n,) the parameters of that chain.

    The drive train of an initial analysis replaces that of the data sheet. `known`: effects in addition to the rigid
    body.
    """
    own = unlocked.index(number)
    poses = np.array([spectrum.spec.pose for spectrum in spectra])[:, list(unlocked)]
    reference = axis_rows(chain, own, poses) @ nominal
    gravity = gravity_terms(chain, nominal, robot.gravity, own, poses)
    periodic = [k for k, spectrum in enumerate(spectra) if spectrum.spec.periodic]
    sweeps: dict[int, FittedSweep] = {}
    covariance = np.zeros((len(spectra), len(spectra)))
    fit, distortion = None, None
    suspects: list[Suspect] = []
    if periodic:
        with_lines = [spectra[k] for k in periodic]
        poses_known = [pose_prior(robot, number, reference[k], gravity[k]) for k in periodic]
        fit, parts, distortion = _fit(robot, number, with_lines, reference, poses_known, analysis, gain, known)
        fit = replace(fit, covariance=fit.covariance + np.diag([part.doubt**2 for part in parts]))
        covariance[np.ix_(periodic, periodic)] = fit.covariance
        for row, k in enumerate(periodic):
            sweeps[k] = from_joint_fit(parts[row].spectrum, float(reference[k]), fit, row, gain, distortion)
            if fit.weight[row] < 1:
                why = f"its residual is {np.sqrt(fit.chi_squared[row]):.1f} times that of the others"
                weight = float(fit.weight[row])
                suspects.append(Suspect(axis=robot.joints[number], sweep=spectra[k].spec.id, why=why, weight=weight))
    train = fit.train if fit is not None else analysis.train if analysis is not None else None
    for k, spectrum in enumerate(spectra):
        if not spectrum.spec.periodic:
            true = replace(spectrum, effort=spectrum.effort / gain.gain)
            sweeps[k] = _from_record(true, float(reference[k]), gain, train)
            covariance[k, k] = sweeps[k].std ** 2
    return AxisEstimate(
        joint=robot.joints[number],
        sweeps=tuple(sweeps[k] for k in sorted(sweeps)),
        covariance=covariance,
        fit=fit,
        gain=gain,
        suspects=tuple(suspects),
        distortion=distortion,
        direct_encoder=bool(periodic) and all(spectra[k].load_velocity is not None for k in periodic),
    )


def _fit(
    robot: Robot,
    number: int,
    with_lines: Sequence[Spectrum],
    reference: Array,
    priors: Sequence[PosePrior],
    analysis: InitialAnalysis | None,
    gain: TorqueGain,
    known: KnownAxis,
) -> tuple[JointFit, list[Corrected], AxisDistortion | None]:
    """The joint fit of the sweeps with lines, the sweeps without gain and known effects, and their distortion."""
    loads = [gear_load(robot, number, one.spec.pose, prior) for one, prior in zip(with_lines, priors, strict=True)]
    rounds = 3 if known.get(LOAD) else 1  # its friction depends on the load found
    while True:
        parts = [corrected(one, known, gain.gain, load) for one, load in zip(with_lines, loads, strict=True)]
        spectra = [part.spectrum for part in parts]
        train = shared_prior(robot, number, reference, spectra) if analysis is None else _analysed(analysis, gain)
        uncertain = [part.uncertain for part in parts]
        given = (
            with_known_spring(train, known, gain.gain),
            [with_known_hose(prior, known, gain.gain) for prior in priors],
            NOISE_GUESS * robot.axes[number].rated_effort,
            uncertain,
        )
        fit = fit_axis(spectra, *given)
        rounds -= 1
        if not rounds:
            distortion = distortion_of(spectra, uncertain, fit)
            # each with the distortion of the previous fit
            for _ in range(2 if distortion else 0):
                spread = None if distortion is None else [distortion.spread(one) for one in spectra]
                fit = fit_axis(spectra, *given, spread)
                distortion = distortion_of(spectra, uncertain, fit, distortion)
            return fit, parts, distortion
        loads = [
            replace(load, inertia=float(found), train=fit.train)
            for load, found in zip(loads, fit.load_inertia, strict=True)
        ]


def _analysed(analysis: InitialAnalysis, gain: TorqueGain) -> SharedPrior:
    """The analysis used the effort as reported by the drive: its inertia and friction are `gain` times too large."""
    scale = np.array([1, 1, 1, gain.gain**2, gain.gain]) / gain.gain
    return SharedPrior(scale * analysis.mean, np.outer(scale, scale) * analysis.covariance)


def total_std(value: float, std: float, gain: TorqueGain) -> float:
    return float(np.hypot(std, gain.std / gain.gain * value))


def from_joint_fit(
    spectrum: Spectrum, reference: float, fit: JointFit, row: int, gain: TorqueGain, distortion: AxisDistortion | None
) -> FittedSweep:
    value, std = float(fit.inertia[row]), float(np.sqrt(fit.covariance[row, row]))
    spread = np.ones(len(spectrum.frequency)) if distortion is None else distortion.spread(spectrum)
    response = _lines(spectrum, float(fit.noise[row]) * spread)
    stds = np.array([std for _, _, std in response])
    holds = "friction holds the axis for a part of the window: check gain and reset time of its speed control"
    return FittedSweep(
        sweep=spectrum.spec.id,
        value=value,
        std=std,
        std_total=total_std(value, std, gain),
        warning=unsettled(float(fit.noise_change[row])) or (holds if len(spectrum.named("rest")) else None),
        bound=float(fit.bound[row]),
        reference=reference,
        paper_value=_paper_value(response, fit, row),
        viscous_friction=fit.train.motor_friction + fit.train.load_friction,
        response=response,
        terms={},
        noise=None if distortion is None else tuple((stds / spread[spectrum.line]).tolist()),
    )


def _paper_value(response: tuple[tuple[float, complex, float], ...], fit: JointFit, row: int) -> float:
    """Equation (8) at the line nearest to the paper's ideal frequency (section 4.2).

    This is the geometric mean of the locked-rotor frequency and the corner mu/(2 pi J) below which friction
    dominates.
    """
    friction = max(fit.train.motor_friction + fit.train.load_friction, 0.0)
    corner = friction / (2 * np.pi * abs(float(fit.inertia[row])))  # effort of the wrong sign makes J negative
    resonance = fit.train.locked_rotor_frequency(float(fit.load_inertia[row]))
    ideal = np.sqrt(corner * resonance)
    frequency, z, _ = min(response, key=lambda line: abs(line[0] - ideal))
    return paper_inertia(frequency, z)


def _from_record(spectrum: Spectrum, reference: float, gain: TorqueGain, train: TwoMassTrain | None) -> FittedSweep:
    fit = fit_record(spectrum)
    excess = 0.0 if train is None else _elastic_excess(spectrum, train, fit.inertia)
    std = float(np.hypot(fit.inertia_std, excess))
    errors = {
        "fitted as a rigid axis; its spring": excess,
        "its friction is fitted as linear in speed; what is not so": fit.by_drag,
    }
    warnings = [
        f"{what} is good for an error of {100 * error / fit.inertia:.1f} %"
        for what, error in errors.items()
        # a larger error of the model is worth a warning
        if error > 0.5 * fit.inertia_std
    ]
    return FittedSweep(
        sweep=spectrum.spec.id,
        value=fit.inertia,
        std=std,
        std_total=total_std(fit.inertia, std, gain),
        warning="; ".join(warnings) or None,
        bound=None,
        reference=reference,
        paper_value=None,
        viscous_friction=fit.terms["viscous_friction"][0],
        response=(),
        terms=fit.terms,
    )


def _elastic_excess(spectrum: Spectrum, train: TwoMassTrain, inertia: float) -> float:
    """Error of the rigid fit of a free record for an elastic axis of about `inertia`, kg m^2 (kg)."""
    moving = spectrum.frequency > 0
    z = impedance(spectrum.frequency[moving], train, inertia - train.motor_inertia, 0.0)
    power = np.abs(spectrum.named("acceleration")[0][moving]) ** 2
    return abs(float(np.sum(power * (z.total / z.s).real) / np.sum(power)) - inertia)


def _lines(spectrum: Spectrum, noise: Array) -> tuple[tuple[float, complex, float], ...]:
    return tuple(
        (float(frequency), complex(effort / velocity), float(std / abs(velocity)))
        for frequency, effort, velocity, std in zip(
            spectrum.frequency[spectrum.line],
            spectrum.effort[spectrum.line],
            spectrum.velocity[spectrum.line],
            noise[spectrum.line],
            strict=True,
        )
    )
