r"""The next revision of an estimate by one more sweep, without the sweeps before it.

After a fit of all sweeps (`estimate`) the cost of an axis is, with the own parameters of each sweep eliminated,
quadratic about its drive train t0: to the next sweep the others are a prior of the drive train, mean and precision M,
and it is fitted alone with this prior (`joint_fit.fit_sweep`). The inertias depend on the drive train by
J_i = y_i + B_i d + e_i, d = t - t0, var e_i = v_i. So with the base parameters beta each sweep is one equation

    y_i = W_i beta - B_i d + e_i,    and the drive train one more:    d = t - t0 with the precision M.

Their information matrix over (beta, d) has a fixed size, a sweep adds a product of its row, and with d eliminated it is
W' C^-1 W of the generalised least squares of all sweeps, C = B M^-1 B' + diag(v): the same base parameters.

The trust region. The neglected curvature of the cost moves t by about the square of d. While d is less than `TRUST`
standard deviations the update stands; else the axis is fitted again from where it is (`joint_fit.fit_again`). As d
after one more sweep falls with the number of sweeps, that costs little while it is frequent, and is rare where it costs
more. All sweeps of all axes are fitted again if the pooled variance of the noise has changed by more than `NOISE`, and
if the new sweep is an outlier by one of both tests (`joint_fit`, `estimate`), is in a pose of another chain, or the
first realisation of another.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtri, ndtri

from service.identification.axis.axis_estimate import (
    AxisDistortion,
    AxisEstimate,
    but_phases,
    from_joint_fit,
)
from service.identification.axis.drive_train import SHARED, TwoMassTrain
from service.identification.axis.joint_fit import FitLimits, JointFit, fit_again, fit_sweep
from service.identification.axis.known_effects import LOAD, Corrected, KnownAxis, corrected
from service.identification.axis.nominal_priors import (
    MeasuredInertias,
    TorqueGain,
    base_spread,
    gear_load,
    pose_prior,
    with_known_hose,
)
from service.identification.estimates.document import (
    base_document,
    cramer_rao_document,
    held_out_document,
    inertia_document,
    rmse_percent,
    spread_document,
    train_document,
)
from service.identification.estimates.estimate import (
    MEDIAN,
    SAME_POSITION,
    HeldOutPoses,
    RobotEstimate,
    check_alive,
    unexplained,
)
from service.identification.estimates.standard_parameters import StandardModel, physical_document, standard_document
from service.identification.model import (
    Information,
    Solution,
    axis_rows,
    condition_number,
    gravity_terms,
    scaled_inverse,
    scaled_solution,
)
from service.identification.spectra.frequency_response import Spectrum
from service.model import Array
from service.model.results import estimate as results
from service.model.results.estimate import Estimate

TRUST = 0.25  # standard deviations of the drive train since the last fit of all sweeps of the axis
NOISE = 0.1  # relative change of the noise variance since the last fit of all axes


@dataclass(frozen=True)
class _Sweeps:
    """What the sweeps (n,) of an axis say of base parameters and drive train: rows W and B, values y - W beta0 at the
    drive train of the last fit, variance v with what it has `more` than that fit says, the nominal inertia, the
    Cramer-Rao bound, and the errors of prediction.
    """

    rows: Array  # (n, r)
    by_train: Array  # (n, 5 + u)
    values: Array
    variance: Array
    more: Array
    reference: Array
    bound: Array
    held_out: HeldOutPoses

    def __len__(self) -> int:
        return len(self.values)

    def and_one(self, other: "_Sweeps") -> "_Sweeps":
        both = {
            name: np.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("rows", "by_train", "values", "variance", "more", "reference", "bound")
        }
        errors = (np.concatenate([getattr(each.held_out, name) for each in (self, other)]) for name in ("error", "std"))
        return _Sweeps(**both, held_out=HeldOutPoses(*errors))

    def information(self) -> tuple[Information, float]:
        """On (beta - beta0, d), and the squared values over their variance."""
        std = np.sqrt(self.variance)
        white, values = np.hstack([self.rows, -self.by_train]) / std[:, None], self.values / std
        return Information(white.T @ white, white.T @ values, len(self)), float(values @ values)


@dataclass(frozen=True)
class _Train:
    """The drive train of an axis (5 + u,) with its precision."""

    mean: Array
    precision: Array

    @property
    def covariance(self) -> Array:
        return scaled_inverse(self.precision)

    def with_noise(self, ratio: float, prior: "_Train") -> "_Train":
        """If the noise has `ratio` times the variance with which the data were weighted beside the prior."""
        information = prior.precision @ prior.mean
        precision = prior.precision + (self.precision - prior.precision) / ratio
        vector = information + (self.precision @ self.mean - information) / ratio
        return _Train(scaled_solution(precision[None], vector[None, :, None])[0, :, 0], precision)


@dataclass(frozen=True)
class _Axis:
    """An axis: the last `fit` of all its sweeps with those `added` to it, and the drive train `now`, all weighted by
    the noise of then. Variance of a sample of the effort when the estimate was made, then, and now, pooled over
    `freedom`.
    """

    number: int
    joint: str
    gain: TorqueGain
    distortion: AxisDistortion | None
    kinds: frozenset[tuple[object, ...]]  # of sweeps that are realisations of each other
    rate: float
    last: str  # sweep, in the order of their ids
    scale: float  # of the errors of prediction, 1 unless the whole axis fits badly
    fit: JointFit
    added: tuple[JointFit, ...]
    now: _Train
    noise_first: float
    noise: float
    noise_now: float
    freedom: float
    sweeps: _Sweeps
    pose: Information  # of the sweeps on (beta - beta0, d)
    squares: float
    workspace: Array  # (m, r) rows in the poses of the workspace, and the nominal inertia there
    nominal: Array
    document: results.EstimatedAxis  # from which a revision begins

    @property
    def ratio(self) -> float:
        """Of the noise variance."""
        return self.noise_now / self.noise

    @cached_property
    def train(self) -> _Train:
        """With the noise of now."""
        return self.now.with_noise(self.ratio, _Train(self.fit.priors.mean, self.fit.priors.precision))

    @property
    def away(self) -> Array:
        """d, (5 + u,)."""
        return self.train.mean - self.fit.shared

    def joint_information(self) -> Information:
        """On (beta - beta0, d), with what the efforts say of d."""
        size = len(self.away)
        matrix, vector = self.pose.matrix / self.ratio, self.pose.vector / self.ratio
        matrix[-size:, -size:] += self.train.precision
        vector[-size:] += self.train.precision @ self.away
        return Information(matrix, vector, self.pose.count)

    @cached_property
    def told(self) -> tuple[Information, float]:
        """On beta - beta0 with d eliminated, and the least sum of squares for beta0."""
        whole, size = self.joint_information(), len(self.away)
        train, beta = slice(-size, None), slice(None, -size)
        right = np.column_stack([whole.matrix[train, beta], whole.vector[train]])
        solved = scaled_solution(whole.matrix[train, train][None], right[None])[0]
        cross = whole.matrix[beta, train]
        information = Information(
            whole.matrix[beta, beta] - cross @ solved[:, :-1], whole.vector[beta] - cross @ solved[:, -1], whole.count
        )
        known = self.squares / self.ratio + self.away @ self.train.precision @ self.away
        squares = known - whole.vector[train] @ solved[:, -1]
        return information, float(squares)

    @property
    def trusted(self) -> bool:
        """Whether the drive train has not moved far from the last fit."""
        return bool(self.away @ self.fit.precision @ self.away <= TRUST**2)

    def fitted_again(self, fit: JointFit, start: Array) -> "_Axis":
        """About another fit, whose first sweeps are these; `start`: beta0."""
        count = len(self.sweeps)
        sweeps = replace(
            self.sweeps,
            by_train=fit.by_shared[:count],
            values=fit.inertia[:count] - self.sweeps.rows @ start,
            variance=fit.own_variance[:count] + self.sweeps.more,
            bound=fit.bound[:count],
        )
        pose, squares = sweeps.information()
        now = _Train(fit.shared, fit.precision)
        return replace(
            self, fit=fit, added=(), now=now, noise=self.noise_now, sweeps=sweeps, pose=pose, squares=squares
        )

    def inertias(self, start: Array) -> Array:
        """(n,) with the drive train of now; `start`: beta0."""
        return self.sweeps.values + self.sweeps.rows @ start + self.sweeps.by_train @ self.away

    def variance(self) -> Array:
        """(n,) of the inertias."""
        by_train = self.sweeps.by_train
        return np.sum((by_train @ self.train.covariance) * by_train, axis=1) + self.ratio * self.sweeps.variance


@dataclass(frozen=True)
class Condensed:
    """All sweeps of an estimate for its next revision; `updates` of them since the last fit of all."""

    estimate: RobotEstimate  # the last fit of all sweeps
    standard: StandardModel
    symbolic: tuple[str, ...]
    base: results.Base
    axes: Mapping[str, _Axis]
    document: Estimate
    updates: int = 0

    @classmethod
    def of(
        cls, estimate: RobotEstimate, spectra: list[Spectrum], workspace: Array, found: Estimate
    ) -> "Condensed | None":
        """None if a next revision needs all sweeps: poses that do not determine the base parameters, records without
        lines, motion measured at the load, friction that depends on it. `found`: document of the estimate.
        """
        if not np.isfinite(estimate.condition_number):
            return None
        axes: dict[str, _Axis] = {}
        for axis in estimate.axes:
            fit, own = axis.fit, [one for one in spectra if one.spec.axis == axis.joint and one.spec.shows_inertia]
            rates = {spectrum.spec.sample_rate for spectrum in own}
            load = estimate.known.of(axis.joint).get(LOAD)
            usable = fit is not None and len(fit.inertia) == len(axis.sweeps) and not axis.direct_encoder
            if fit is None or not usable or load is not None or len(rates) > 1 or fit.freedom < FitLimits.few_freedom:
                return None
            own.sort(key=lambda spectrum: spectrum.spec.id)
            axes[axis.joint] = _condensed(estimate, axis, fit, own, workspace, found.axes[axis.joint])
        return cls(
            estimate,
            StandardModel.of(estimate),
            tuple(one.symbolic or one.name for one in found.base_parameters),
            found.base,
            axes,
            found,
        )

    def updated(self, spectrum: Spectrum) -> "Condensed | None":
        """With one more sweep; None outside of the trust region. BadInput as `identify`."""
        axis, spec, estimate = self.axes.get(spectrum.spec.axis), spectrum.spec, self.estimate
        if axis is None or not self._alike(axis, spectrum):
            return None
        check_alive(spectrum)
        place = np.array([spec.pose])[:, list(estimate.unlocked)]
        own = estimate.unlocked.index(axis.number)
        reference = float((axis_rows(estimate.chain, own, place) @ estimate.nominal)[0])
        gravity = gravity_terms(estimate.chain, estimate.nominal, estimate.robot.gravity, own, place)[0]
        prior = pose_prior(estimate.robot, axis.number, reference, gravity)
        effects: KnownAxis = estimate.known.of(spec.axis)
        load = gear_load(estimate.robot, axis.number, spec.pose, prior)
        part = corrected(spectrum, effects, axis.gain.gain, load)
        fit = fit_sweep(
            part.spectrum,
            axis.now.mean,
            axis.now.precision,
            with_known_hose(prior, effects, axis.gain.gain),
            float(np.sqrt(axis.noise / spectrum.samples)),
            part.uncertain,
            None if axis.distortion is None else axis.distortion.spread(part.spectrum),
        )
        if fit is None:
            return None
        row = estimate.base.rows(estimate.chain, own, place)
        return self._with(axis, part, fit, row, reference)

    def _alike(self, axis: _Axis, spectrum: Spectrum) -> bool:
        """Whether the sweep is of the kind of the others."""
        spec, estimate = spectrum.spec, self.estimate
        away = np.delete(np.abs(np.array(spec.pose) - estimate.poses.mean(axis=0)), estimate.unlocked)
        return (
            spec.id > axis.last
            and spec.periodic
            and spec.excitation != "trajectory"
            and not spec.stepped
            and spec.shows_inertia
            and spec.sample_rate == axis.rate
            and spectrum.load_velocity is None
            and away.max(initial=0.0) < SAME_POSITION
            and (axis.distortion is not None or but_phases(spectrum) not in axis.kinds)
        )

    def _with(self, axis: _Axis, part: Corrected, fit: JointFit, row: Array, reference: float) -> "Condensed | None":
        """None unless the step stays in the trust region and the sweep fits the others."""
        spectrum, count = part.spectrum, len(axis.sweeps) + 1
        freedom, squares = fit.freedom, float(fit.chi_squared[0]) * fit.freedom * axis.noise
        worst = float(chdtri(freedom, FitLimits.chance / count)) * axis.noise_now
        immaterial = spectrum.samples * (FitLimits.material * float(np.abs(spectrum.effort).max())) ** 2
        whole = axis.freedom + freedom
        moved = replace(
            axis,
            added=(*axis.added, fit),
            now=_Train(fit.shared, fit.precision),
            noise_now=(axis.noise_now * axis.freedom + squares) / whole,
            freedom=whole,
        )
        outlier = squares > worst and squares > immaterial * freedom
        if outlier or abs(moved.noise_now / axis.noise_first - 1) > NOISE:
            return None
        start, told = self.estimate.solution.values, fit
        if not moved.trusted:
            again = fit_again(axis.fit, moved.added, moved.ratio)
            if again is None:
                return None
            moved, told = moved.fitted_again(again, start), again
        value, more = float(told.inertia[-1]), part.doubt**2
        own, by_train = float(told.own_variance[-1]) + more, told.by_shared[-1]
        there = value - float(by_train @ (told.shared - moved.fit.shared)) - float(row[0] @ start)
        error, expected = self._prediction(moved, np.append(row[0], -by_train), there, own)
        n = sum(len(each.sweeps) for each in self.axes.values()) + 1
        limit = -float(ndtri(FitLimits.chance / 2 / n)) * axis.scale * np.sqrt(expected)
        if abs(error) > limit and abs(error) > FitLimits.material * abs(value):
            return None
        one = _Sweeps(
            rows=row,
            by_train=by_train[None],
            values=np.array([there]),
            variance=np.array([own]),
            more=np.array([more]),
            reference=np.array([reference]),
            bound=told.bound[-1:],
            held_out=HeldOutPoses(np.array([error]), np.sqrt([expected])),
        )
        pose, squared = one.information()
        entry = inertia_document(from_joint_fit(spectrum, reference, fit, 0, axis.gain, axis.distortion), value)
        moved = replace(
            moved,
            document=axis.document.model_copy(update={"inertia": (*axis.document.inertia, entry)}),
            sweeps=moved.sweeps.and_one(one),
            pose=moved.pose.plus(pose),
            squares=moved.squares + squared,
            last=spectrum.spec.id,
            kinds=axis.kinds | {but_phases(spectrum)},
        )
        return self._revised({**self.axes, axis.joint: moved})

    def _prediction(self, axis: _Axis, row: Array, value: float, variance: float) -> tuple[float, float]:
        """Error, and its variance, of the equation `row` on (beta - beta0, d) predicted by all others."""
        whole, size = axis.joint_information(), len(self.estimate.base.columns)
        matrix, vector = whole.matrix.copy(), whole.vector.copy()
        for other in self.axes.values():
            if other.joint != axis.joint:
                matrix[:size, :size] += other.told[0].matrix
                vector[:size] += other.told[0].vector
        solved = scaled_solution(matrix[None], np.column_stack([vector, row])[None])[0]
        return value - float(row @ solved[:, 0]), axis.ratio * variance + float(row @ solved[:, 1])

    def _revised(self, axes: Mapping[str, _Axis]) -> "Condensed":
        estimate, start = self.estimate, self.estimate.solution.values
        total = Information.empty(len(start))
        for axis in axes.values():
            total = total.plus(axis.told[0])
        inverse = scaled_inverse(total.matrix)
        least = inverse @ total.vector
        weighted, tests = Information.empty(len(start)), dict[str, tuple[float, float, float]]()
        for axis in axes.values():
            told, squares = axis.told
            squares += float(least @ told.matrix @ least - 2 * least @ told.vector)
            freedom = told.count - float(np.sum(told.matrix * inverse))
            scale = unexplained(squares, freedom)
            tests[axis.joint] = squares, freedom, scale
            weighted = weighted.plus(Information(told.matrix / scale, told.vector / scale, told.count))
        absolute = Information(weighted.matrix, weighted.vector + weighted.matrix @ start, weighted.count)
        rows = np.vstack([axis.sweeps.rows for axis in axes.values()])
        values = {axis.joint: axis.inertias(start) for axis in axes.values()}
        stds = {axis.joint: np.sqrt(axis.variance() * tests[axis.joint][2]) for axis in axes.values()}
        nominal = estimate.base.combination @ estimate.nominal
        measured = MeasuredInertias(
            values=np.concatenate(list(values.values())),
            variance=np.concatenate(list(stds.values())) ** 2,
            model=rows @ nominal,
            rows=rows,
        )
        spread = base_spread(estimate.robot, estimate.chain, estimate.unlocked, estimate.base.combination, measured)
        solution = absolute.solve(nominal, spread)
        determined = all(solution.determines(axis.workspace, spread) for axis in axes.values())
        parameters = self.standard.parameters(rows, solution)
        covariance = tuple(tuple(map(float, row)) for row in solution.covariance)
        revision = {
            "axes": {
                name: _axis_document(axis, solution, values[name], stds[name], *tests[name][:2], determined=determined)
                for name, axis in axes.items()
            },
            "base_parameters": base_document(estimate, self.symbolic, solution, spread),
            "base": self.base.model_copy(update={"covariance": covariance}),
            "condition_number": condition_number(rows),
            "standard_parameters": standard_document(estimate.robot, parameters),
            "physical": physical_document(parameters),
            "updates": self.updates + 1,
        }
        return replace(self, axes=axes, document=self.document.model_copy(update=revision), updates=self.updates + 1)


def _condensed(
    estimate: RobotEstimate,
    axis: AxisEstimate,
    fit: JointFit,
    own: list[Spectrum],
    workspace: Array,
    found: results.EstimatedAxis,
) -> _Axis:
    start, rows = estimate.solution.values, estimate.observation[axis.joint]
    samples = np.array([float(spectrum.samples) for spectrum in own])
    by_train = np.sum((fit.by_shared @ scaled_inverse(fit.precision)) * fit.by_shared, axis=1)
    # known effects that could not be removed, and suspects
    more = np.maximum(np.diag(fit.covariance) - by_train - fit.own_variance, 0.0) + estimate.extra[axis.joint]
    sweeps = _Sweeps(
        rows=rows,
        by_train=fit.by_shared,
        values=fit.inertia - rows @ start,
        variance=fit.own_variance + more,
        more=more,
        reference=np.array([sweep.reference for sweep in axis.sweeps]),
        bound=fit.bound,
        held_out=estimate.held_out[axis.joint],
    )
    pose, squares = sweeps.information()
    noise = float(np.median(fit.noise**2 * fit.weight * samples))
    number = estimate.robot.index(axis.joint)
    return _Axis(
        number=number,
        joint=axis.joint,
        gain=axis.gain,
        distortion=axis.distortion,
        kinds=frozenset(but_phases(spectrum) for spectrum in own),
        rate=own[0].spec.sample_rate,
        last=own[-1].spec.id,
        scale=max(1.0, float(np.median(np.abs(estimate.errors[axis.joint]))) / MEDIAN),
        fit=fit,
        added=(),
        now=_Train(fit.shared, fit.precision),
        noise_first=noise,
        noise=noise,
        noise_now=noise,
        freedom=fit.freedom,
        sweeps=sweeps,
        pose=pose,
        squares=squares,
        workspace=estimate.base.rows(
            estimate.chain, estimate.unlocked.index(number), workspace[:, list(estimate.unlocked)]
        ),
        nominal=estimate.reference(axis.joint, workspace),
        document=found,
    )


def _axis_document(
    axis: _Axis, solution: Solution, values: Array, std: Array, squares: float, freedom: float, *, determined: bool
) -> results.EstimatedAxis:
    """The axis' part of the document, with inertias (n,) of its sweeps and their standard deviations."""
    sweeps, train = axis.sweeps, axis.train
    identified, there = sweeps.rows @ solution.values, axis.workspace @ solution.values
    spread = None
    if determined:
        variance = np.sum((axis.workspace @ solution.covariance) * axis.workspace, axis=1)
        spread = spread_document(np.sqrt(np.maximum(variance, 0.0)), there)
    held_out, moved = held_out_document(sweeps.held_out, values), train.mean[SHARED:]
    parameters = train_document(TwoMassTrain.of(train.mean), np.sqrt(np.diag(train.covariance))[:SHARED])
    total = np.hypot(std, axis.gain.std / axis.gain.gain * values)
    friction = float(train.mean[1] + train.mean[2])
    columns = (values.tolist(), std.tolist(), total.tolist(), identified.tolist())
    names = ("value", "std", "std_total", "identified")
    revision = {
        "inertia": tuple(
            one.model_copy(update={**dict(zip(names, row, strict=True)), "viscous_friction": friction})
            for one, *row in zip(axis.document.inertia, *columns, strict=True)
        ),
        "rmse_percent": results.Rmse(
            reference_measured=rmse_percent(sweeps.reference, values),
            identified_measured=rmse_percent(identified, values),
            reference_identified=rmse_percent(axis.nominal, there),
        ),
        "drive_train": parameters,
        "effects_moved_in_std": float(np.abs(moved).max()) if len(moved) else None,
        "confidence_percent": None if spread is None else spread.worst,
        "workspace_std_percent": spread,
        "reduced_chi_squared": squares / freedom if freedom > 0.5 else None,
        "held_out": held_out,
        "cramer_rao": cramer_rao_document(sweeps.bound, std, values),
    }
    return axis.document.model_copy(update=revision)
