r"""Faults of the records of free motions: one or several of them, found by the fit of the whole inverse dynamics.

An effort has the wrong sign or unit, two efforts are exchanged, all efforts are late, or gravity has another direction.
With h_k the factor of the recorded effort of axis k over the true one, 1 without fault, and Y of the standard
parameters,

    effort_order(k)(t + late) = h_k Y_k(gravity) parameters + noise of std s_k,

so that every hypothesis needs only cross products of columns and efforts, which are computed once. Gains are fitted by
Gauss-Newton on log |h|: noise is on the efforts, so nothing biases them. Hypotheses are compared by Laplace's
approximation of their evidence (MacKay 1992, Neural Computation 4:415), in nats,

    - sum_k n_k log(s_k / rms_k) - |deviation from the prior|^2 / 2 - log det(posterior / prior precision) / 2
    + log P(friction and rotors > 0) - `_Settings.fault` for each fault,

where the nominal model may be three times as good as its prior says, or as bad. Each fault more must raise it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.special import log_ndtr

from service.identification.model import JointMotion, link_rows, nominal_parameters, parameter_spread, scaled_solution
from service.identification.motion.equations import Sampling, at_rest, drive_along, load_and_motor
from service.identification.motion.free_motion import FreeMotion, low_pass, memory
from service.model import Array, Robot


@dataclass(frozen=True)
class _Settings:
    rate: float = 4.0  # Hz, of independent samples: errors of friction and springs last longer than noise
    floor: float = 0.02  # of an axis' RMS effort: least std, what no rigid model explains
    fault: float = 3.0  # nats: evidence against each fault
    width: float = 2.0  # nats: against a nominal model that is three times as good or bad as its prior says
    widths: tuple[float, ...] = (1 / 3, 1.0, 3.0)
    gain: float = 0.5  # of a wrong effort: scale of the Cauchy distribution of log |h|
    rated: float = 0.3  # of the rated effort: RMS of an effort
    rated_spread: float = 0.92  # std of its logarithm: two of them are a factor of 6
    least_gain: float = 1.3  # of a wrong effort: below, a motor's constant or the nominal model is off
    lags: tuple[float, ...] = tuple(0.01 * k for k in range(-30, 31) if k == 0 or abs(k) > 4)  # s, as efforts are late
    on_time: int = lags.index(0.0)
    kept: int = 5  # hypotheses to which a fault is added


@dataclass(frozen=True, order=True)
class _Fault:
    """`kind`: sign, gain, swap, late, gravity; load and spring, which are none: the last link carries, or an axis is
    balanced by, what the nominal model lacks.

    `axes` that it is about; `choice`: number of the lag or direction.
    """

    kind: str
    axes: tuple[int, ...] = ()
    choice: int = 0


@dataclass(frozen=True)
class _Products:
    """Means of products over each axis' own equations; n axes, g directions of gravity, l lags,
    p = 16 n parameters: those of `inverse_dynamics`, then the cosine and the sine of the angle of every axis.
    """

    directions: Array  # (g, 3) m/s^2, the first of the robot file
    rows: Array  # (g, n, p, p)
    efforts: Array  # (g, n, p, n, l): columns of an axis by the efforts of all
    squares: Array  # (n, n, l): of the efforts of all at the instants of an axis
    duration: Array  # (n,) s, of all equations
    pairs: tuple[tuple[int, int], ...]  # axes that move and are recorded together


@dataclass(frozen=True)
class _Hypothesis:
    """Of a hypothesis. `gains` (n,): log |h|; `left` (n,): RMS residual over RMS effort; `off`: RMS deviation of the
    links from the nominal model, in standard deviations of the robot file's prior.
    """

    faults: tuple[_Fault, ...]
    width: float
    evidence: float
    gains: Array
    left: Array
    off: float


def faults(robot: Robot, records: Sequence[FreeMotion]) -> tuple[str, ...]:
    """One sentence for each fault that the records of the most probable hypothesis have, with what mends it."""
    search = _Search(robot, _products(robot, records))
    best = search.best()
    return tuple(search.told(best, fault) for fault in best.faults if search.matters(best, fault))


def _products(robot: Robot, records: Sequence[FreeMotion]) -> _Products:
    n, lags = len(robot.axes), _Settings.lags
    size = float(np.linalg.norm(robot.gravity)) or 9.81  # where the robot file has no gravity
    turned = [sign * size * unit for unit in np.eye(3) for sign in (1.0, -1.0)]
    own = np.array(robot.gravity, dtype=float)
    directions = np.array([own, *(one for one in turned if not np.allclose(one, own, atol=0.1 * size))])
    falling = np.array([10 * link + part for link in range(n) for part in range(4)])  # mass and first moments
    rows = np.zeros((n, 28 * n, 28 * n))
    efforts, squares = np.zeros((n, 28 * n, n, len(lags))), np.zeros((n, n, len(lags)))
    count, duration = np.zeros((2, n))
    for record in records:
        load, motor = load_and_motor(robot, record)
        rate, band = record.rate, record.band
        coarse = max(1, int(2 * rate / Sampling.link_rate))
        fine = max(1, int(rate / coarse / (2 * band)))
        kept, time = slice(0, None, coarse * fine), np.arange(len(load.position)) / rate
        inside = (time[kept] > memory(band)) & (time[kept] < time[-1] - memory(band))
        part = JointMotion(load.position[::coarse], load.velocity[::coarse], load.acceleration[::coarse])
        still = JointMotion(part.position, 0 * part.velocity, 0 * part.velocity)
        weights = [link_rows(robot.chain, unit, still)[..., falling] for unit in np.eye(3)]
        links = np.concatenate([link_rows(robot.chain, np.zeros(3), part), *weights], axis=-1)
        smooth = low_pass(record.effort, rate, band)
        late = np.zeros((len(time[kept]), n, len(lags)))
        for column, joint in enumerate(record.joints):
            for number, lag in enumerate(lags):
                late[:, robot.index(joint), number] = np.interp(time[kept] + lag, time, smooth[:, column])
        for k in map(robot.index, record.joints):
            if np.ptp(motor.position[:, k]) < 1e-3:  # rad (m)
                continue
            sound = inside & ~at_rest(motor.velocity[:, k], rate, band)[kept]
            of_links = low_pass(links[:, k], rate / coarse, band)[::fine]
            turn = np.stack([np.cos(motor.position[:, k]), np.sin(motor.position[:, k])], -1)
            springs = (turn[:, :, None] * np.eye(n)[k]).reshape(len(turn), 2 * n)
            drives = low_pass(np.hstack([drive_along(motor, k), springs]), rate, band)[kept]
            columns = np.hstack([of_links, drives])[sound]
            rows[k] += columns.T @ columns
            efforts[k] += np.tensordot(columns.T, late[sound], 1)
            squares[k] += np.sum(late[sound] ** 2, axis=0)
            count[k] += len(columns)
            duration[k] += len(columns) * coarse * fine / rate
    known = np.maximum(count, 1.0)
    spread = np.zeros((len(directions), 28 * n, 16 * n))  # from parameters to columns
    spread[:, : 10 * n, : 10 * n], spread[:, 22 * n :, 10 * n :] = np.eye(10 * n), np.eye(6 * n)
    for axis in range(3):
        first = 10 * n + 4 * n * axis
        spread[:, first + np.arange(4 * n), falling] = directions[:, axis, None]
    return _Products(
        directions,
        np.swapaxes(spread, 1, 2)[:, None] @ (rows / known[:, None, None]) @ spread[:, None],
        np.einsum("gcp,kcjl->gkpjl", spread, efforts / known[:, None, None, None], optimize=True),
        squares / known[:, None, None],
        duration,
        tuple(
            (one, other)
            for one, other in combinations(np.flatnonzero(count).tolist(), 2)
            if all((robot.joints[one] in each.joints) == (robot.joints[other] in each.joints) for each in records)
        ),
    )


@dataclass(frozen=True)
class _Model:
    """Of a hypothesis with f gains: its `_Products`; `size` (n,): RMS efforts, N m (N); `independent` (n,): samples.

    `sign` (n,); `shares` (n, f): 1 where a gain is that of an axis; `expected` (n,): log |h| by the rated efforts;
    `known` (p,), `unknown` (6, n): standard deviations of the prior, and of what only the motion tells, per effort.
    """

    rows: Array
    efforts: Array
    size: Array
    independent: Array
    sign: Array
    shares: Array
    expected: Array
    known: Array
    unknown: Array

    def left(self, values: Array, gains: Array) -> Array:
        """(n,): RMS residual over RMS effort."""
        gain = self.sign * np.exp(self.shares @ gains)
        power = (self.rows @ values) @ values
        residual = self.size**2 - 2 * gain * (self.efforts @ values) + gain**2 * power
        return np.sqrt(np.maximum(residual, 0.0)) / self.size

    def normal(self, start: Array, values: Array, gains: Array, left: Array) -> tuple[Array, Array, Array]:
        """Normal matrix (p + f, p + f) and vector of a step of Gauss-Newton, with the prior about `start` (p,), and its
        standard deviations (p,). `left` (n,): noise over RMS effort.
        """
        factor, along = np.exp(self.shares @ gains), self.rows @ values
        gain, links = self.sign * factor, len(values) - self.unknown.size
        drives = (self.unknown * self.size / factor).ravel()
        std = np.append(self.known[:links], np.where(drives > 0, drives, self.known[links:]))
        weight = self.independent / (left * self.size) ** 2
        rated, common = (self.independent > 0) / _Settings.rated_spread**2, 2 / (_Settings.gain**2 + gains**2)
        misfit = weight * gain * (self.efforts @ values - gain * (along @ values))
        misfit += rated * (self.expected - self.shares @ gains)
        coupling = ((weight * gain**2)[:, None] * along).T @ self.shares
        inner = (self.shares.T * (weight * gain**2 * (along @ values) + rated)) @ self.shares + np.diag(common)
        outer = np.tensordot(weight * gain**2, self.rows, 1) + np.diag(std**-2)
        vector = (weight * gain) @ (self.efforts - gain[:, None] * along) + (start - values) / std**2
        matrix = np.block([[outer, coupling], [coupling.T, inner]])
        return matrix, np.append(vector, self.shares.T @ misfit - common * gains), std


@dataclass(frozen=True)
class _Search:
    robot: Robot
    products: _Products
    tried: dict[tuple[tuple[_Fault, ...], float], _Hypothesis] = field(default_factory=dict)

    @cached_property
    def moving(self) -> list[int]:
        return np.flatnonzero(self.products.duration).tolist()

    def best(self) -> _Hypothesis:
        """Faults are added one by one to the most probable hypotheses, until none is more probable."""
        best = self._of(())
        front = [best]
        while front:
            longer = {(*one.faults, fault) for one in front for fault in self._further(one.faults)}
            found = sorted({tuple(sorted(one)) for one in longer})
            # with the right faults the nominal model is good
            widths = {front[0].width, _Settings.widths[0]}
            ranked = sorted(found, key=lambda one: -max(self._fit(one, width).evidence for width in widths))
            front = sorted((self._of(one) for one in ranked[: _Settings.kept]), key=lambda one: -one.evidence)
            if not front or (front[0].evidence <= best.evidence and len(front[0].faults) > 1):
                break
            best = max(best, front[0], key=lambda one: one.evidence)
        return best

    def _of(self, faults: tuple[_Fault, ...]) -> _Hypothesis:
        """With the best width, and the best one of three neighbouring lags."""
        late = [one for one in faults if one.kind == "late"]
        near = {number for one in late for number in range(one.choice - 1, one.choice + 2)}
        near &= set(range(len(_Settings.lags))) - {_Settings.on_time}
        rest = tuple(one for one in faults if one.kind != "late")
        all_ = [tuple(sorted((*rest, _Fault("late", (), number)))) for number in sorted(near)] or [faults]
        return max((self._fit(one, width) for one in all_ for width in _Settings.widths), key=lambda one: one.evidence)

    def _further(self, faults: tuple[_Fault, ...]) -> list[_Fault]:
        """Faults that a hypothesis may have besides its own."""
        once = {one.kind for one in faults} & {"load", "late", "gravity"}
        alone = [(k,) for k in self.moving]
        possible = [
            *(_Fault(kind, axes) for axes in (*alone, tuple(self.moving)) for kind in ("sign", "gain")),
            *(_Fault("swap", pair) for pair in self.products.pairs),
            _Fault("load"),
            *(_Fault("spring", axes) for axes in alone),
            # their neighbours are tried by `_of`
            *(_Fault("late", (), number) for number in range(1, len(_Settings.lags), 3) if number != _Settings.on_time),
            *(_Fault("gravity", (), number) for number in range(1, len(self.products.directions))),
        ]
        return [one for one in possible if one.kind not in once and one not in faults]

    def _fit(self, faults: tuple[_Fault, ...], width: float) -> _Hypothesis:
        if (faults, width) not in self.tried:
            self.tried[faults, width] = self._fitted(faults, width)
        return self.tried[faults, width]

    def _fitted(self, faults: tuple[_Fault, ...], width: float) -> _Hypothesis:
        model = self._model(faults, width)
        start = np.append(nominal_parameters(self.robot), np.zeros(2 * len(self._rated)))
        axes, settings = self.moving, _Settings
        expected = np.array([np.median(model.expected[list(one.axes)]) for one in faults if one.kind == "gain"])
        values, gains = start, np.where(np.abs(expected) > 2.0, expected, 0.0)  # of N mm, or percent
        left = raw = np.full(len(self._rated), 0.3)
        for _ in range(8):
            matrix, vector, _ = model.normal(start, values, gains, left)
            step = scaled_solution(matrix[None], vector[None, :, None])[0, :, 0]
            values, gains, before = values + step[: len(start)], gains + np.clip(step[len(start) :], -1.0, 1.0), left
            raw = model.left(values, gains)
            left = np.hypot(raw, settings.floor)
            if np.all(np.abs(np.log(left / before))[axes] < 0.03) and np.all(np.abs(step[len(start) :]) < 0.05):
                break
        matrix, _, std = model.normal(start, values, gains, left)
        scale = np.append(std, np.ones(len(gains)))
        variance = np.diag(scaled_solution(matrix[None], np.eye(len(matrix))[None])[0])
        deviation, apart = (values - start) / std, (model.shares @ gains - model.expected)[axes]
        drives = np.array([part * len(left) + k for part in (10, 11, 12) for k in axes])  # rotors and friction
        positive = log_ndtr(np.stack([values[drives] / np.sqrt(np.abs(variance[drives])), start[drives] / std[drives]]))
        terms: list[float] = [
            -2 * float(model.independent[axes] @ np.log(left[axes])),
            -float(np.sum(deviation**2)),
            -float(np.linalg.slogdet(matrix * np.outer(scale, scale))[1]),
            -float(np.sum((apart / settings.rated_spread) ** 2)),
            -2 * float(np.sum(np.log1p((gains / settings.gain) ** 2) + np.log(settings.gain * np.sqrt(np.pi / 2)))),
            2 * float(np.sum(positive[0] - positive[1])),
            -np.inf if np.any(np.abs(gains) < np.log(settings.least_gain)) else 0.0,
            -2 * settings.fault * len(faults) - 2 * settings.width * abs(math.log(width)) / math.log(3),
        ]
        off = width * float(np.sqrt(np.mean(deviation[: 10 * len(left)] ** 2)))
        return _Hypothesis(faults, width, sum(terms) / 2, model.shares @ gains, raw, off)

    def _model(self, faults: tuple[_Fault, ...], width: float) -> _Model:
        data, n = self.products, len(self._rated)
        chosen = {one.kind: one.choice for one in faults}
        order, sign = np.arange(n), np.ones(n)
        for one in faults:
            if one.kind == "swap":
                order[list(one.axes)] = order[list(one.axes[::-1])]
            if one.kind == "sign":
                sign[list(one.axes)] *= -1
        sprung = [_Fault("spring", (k,)) in faults for k in range(n)]
        shares = [np.isin(np.arange(n), one.axes) for one in faults if one.kind == "gain"]
        direction, lag = chosen.get("gravity", 0), chosen.get("late", _Settings.on_time)
        links = self._known[: 10 * n]
        last = links.reshape(n, 10).max(axis=0) / self.robot.prior.inertia if "load" in chosen else width * links[-10:]
        size = np.sqrt(np.maximum(data.squares[np.arange(n), order, lag], 1e-18))  # N m (N)
        return _Model(
            rows=data.rows[direction],
            efforts=data.efforts[direction][np.arange(n), :, order, lag],
            size=size,
            independent=_Settings.rate * data.duration,
            sign=sign,
            shares=np.array(shares, dtype=float).reshape(-1, n).T,
            expected=np.log(size / self._rated) - np.log(_Settings.rated),
            known=np.concatenate([width * links[:-10], last, self._known[10 * n :]]),
            unknown=np.vstack([self._unknown[:4], self._unknown[4:] * sprung]),
        )

    @cached_property
    def _rated(self) -> Array:
        return np.array([axis.rated_effort for axis in self.robot.axes])

    @cached_property
    def _known(self) -> Array:
        """Standard deviations (16 n,) of the prior: no axis is balanced."""
        return np.append(parameter_spread(self.robot), 1e-6 * self._rated.repeat(2))

    @cached_property
    def _unknown(self) -> Array:
        """(6, n): what no data sheet gives may cause all of an effort of 1 N m (N); 0 where one does."""
        axes, n = self.robot.axes, len(self.robot.axes)
        square = np.diagonal(self.products.rows[0], axis1=1, axis2=2).max(axis=0)[10 * n :].reshape(6, n)
        motors, viscous = ([not one for one in known] for known in zip(*(
            (axis.reflected_motor_inertia, axis.viscous_friction) for axis in axes
        ), strict=True))  # fmt: skip
        largest = np.vstack([motors, viscous, np.ones(n), np.full(n, 0.2), np.ones((2, n))])
        return largest / np.sqrt(np.where(square > 0, square, 1.0))

    def matters(self, fit: _Hypothesis, fault: _Fault) -> bool:
        """Whether it is one, and no nominal model explains it."""
        if fault.kind != "gain":
            return fault.kind not in ("load", "spring")
        gain, axes = self._log_gain(fit, fault), list(fault.axes)
        # of all axes: or all masses of the nominal model are wrong
        apart = float(np.median(self._model(fit.faults, fit.width).expected[axes]))
        return len(axes) == 1 or abs(apart) > max(2 * _Settings.rated_spread, abs(apart - gain))

    def _log_gain(self, fit: _Hypothesis, fault: _Fault) -> float:
        return float(np.median(fit.gains[list(fault.axes)]))

    def told(self, fit: _Hypothesis, fault: _Fault) -> str:
        without = self._of(tuple(one for one in fit.faults if one != fault))
        axes = list(fault.axes) or self.moving
        before, after = (100 * float(np.sqrt(np.mean(one.left[axes] ** 2))) for one in (without, fit))
        return (
            f"{self._mend(fit, fault)}. With this change {after:.2g} % of the effort remain unexplained, without it "
            f"{before:.2g} %, and the nominal model is {fit.off:.2g} standard deviations off, without it "
            f"{without.off:.2g}"
        )

    def _mend(self, fit: _Hypothesis, fault: _Fault) -> str:
        joints = [self.robot.joints[k] for k in fault.axes]
        of = f"the effort of {joints[0]} seems" if len(joints) == 1 else "all efforts seem"
        match fault.kind:
            case "sign":
                return f"{of} to have the wrong sign: change it"
            case "swap":
                return f"the efforts of {joints[0]} and {joints[1]} seem to be exchanged: exchange their columns"
            case "late":
                lag = 1000 * _Settings.lags[fault.choice]
                return f"the efforts seem to be {lag:.0f} ms late: take them earlier by that"
            case "gravity":
                gravity = self.products.directions[fault.choice]
                axis = int(np.argmax(np.abs(gravity)))
                sign = "-" if gravity[axis] < 0 else ""
                return f'gravity seems to act along {sign}{"xyz"[axis]} of the base: set "gravity"'
            case _:
                factor, axis = float(np.exp(self._log_gain(fit, fault))), self.robot.axes[fault.axes[0]]
                size = f"{factor:.3g} times too large" if factor > 1 else f"{1 / factor:.3g} times too small"
                units = {
                    "in N mm": 1000.0,
                    "in percent of the rated effort": 100 / axis.rated_effort,
                    "on the motor's side": 1 / abs(axis.gear_ratio),
                }
                apart = {name: abs(float(np.log(factor / unit))) for name, unit in units.items()}
                name = min(apart, key=lambda one: apart[one])
                named = f", as if {name}" if apart[name] < 0.2 else ""
                return f"{of} to be {size}{named}: multiply by {1 / factor:.3g}, or correct unit, gear ratio or masses"
