r"""Play of a gear (backlash), from sweeps about standstill. Nothing is replayed: impacts are seen, not predicted.

The torque through the gear follows from the motor alone, Ts = effort - Jm a - motor friction. Where it is not 0, the
gear touches the flank of its sign. Between two contacts only its friction slows the load. With b the play, s the flank
(-1 or 1, linear between contacts), and e the motor's way beyond that of the load between two contacts,

    q_l = q - e - s b / 2,    effort = Jm a + J q_l'' + friction + gravity,

linear in J and J b. Below `IMPACTS` impacts of milliseconds are steps of momentum. Rivals: a twist in proportion to Ts
and to its cube has no e; presliding is a loop of the motor's angle (Nordin and Gutman, Automatica 38 (2002)).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from service.diagnosis.rows.signals import bristles, in_frequency
from service.identification.model import inertia_rows
from service.model import Array, Indices, Robot, Sweep
from service.model.results.diagnosis import Gap

PLAY = "backlash"
IMPACTS = 4.0  # Hz, of the Gaussian
STARTS = (4e-5, 8e-5, 1.6e-4, 3e-4, 5e-4, 8e-4, 1.3e-3, 2e-3)  # rad (m), where a search begins
BRISTLES = (2e-5, 1e-4, 5e-4, 2e-3)  # rad (m), of presliding as a rival


@dataclass(frozen=True)
class Play:
    """Play and its std, rad (m). RMS on held-out repeats below `IMPACTS`, N m (N): of the rigid model (`before`), of
    the best smooth law, with play (`after`), and of what differs between repeats after it (`floor`). `ratio`: part of
    the load's inertia that is missing between the flanks; 1 if the gear is open there.
    """

    width: float
    std: float
    ratio: float
    ratio_std: float
    before: float
    smooth: float
    after: float
    floor: float
    effort: float  # RMS
    rows: int

    @property
    def is_certain(self) -> bool:
        """Whether it is play: a value, an open gear, and better than every smooth law on held-out repeats."""
        opens = abs(self.ratio - 1) < 0.3 and self.ratio_std < 0.15
        return self.width > 4 * self.std and opens and self.after < min(0.7 * self.smooth, 0.5 * self.before)

    @property
    def gain(self) -> float:
        """Chi-squared by which held-out repeats are explained better."""
        return self.rows * (self.before**2 - self.after**2) / self.floor**2

    @property
    def gap(self) -> Gap:
        """On held-out repeats, below `IMPACTS`."""
        return Gap(
            before_rms=self.before,
            after_rms=self.after,
            noise_floor_rms=self.floor,
            held_out_sweeps=0,
            cross_validated=True,
            source="play",
            before_percent=100 * self.before / self.effort,
            after_percent=100 * self.after / self.effort,
            by_pose=(),
        )

    def sentence(self, joint: str, unit: str) -> str:
        """What was measured, in words."""
        length = "m" if unit == "N" else "rad"
        return (
            f"{joint}: play of {self.width:.3g} ± {self.std:.2g} {length}; between the flanks "
            f"{100 * self.ratio:.0f} ± {100 * self.ratio_std:.0f} % of the load's inertia are missing. "
            f"The best smooth law leaves {self.smooth:.3g} {unit}, play {self.after:.3g} {unit}. "
            "Other effects cannot be judged in sweeps in which the flank changes."
        )


@dataclass(frozen=True)
class _FlankRows:
    """Filtered rows (n, ...) of sweeps: `motor` has the columns of motor, friction and gravity; `load`, `flank` and
    `opened` those that J, J b / 2 and J multiply in each pose (e is part of `load`); `smooth` those of the rivals.
    """

    effort: Array
    motor: Array
    load: Array
    flank: Array
    opened: Array
    smooth: Array
    sweep: Indices
    repeat: Indices
    moment: Indices  # equal in the repeats of a pose

    def law(self, inertia: Array) -> Array:
        """Columns with play, for the inertia of the load in each pose."""
        return np.column_stack([self.motor, self.load, self.flank @ inertia, self.smooth[:, 0]])


@dataclass(frozen=True)
class _Assumed:
    """What is assumed to see where the gear touches: inertia, share of the viscous friction and dry friction, N m, of
    the motor; the least torque of a contact, in units of what is uncertain. And of the load between contacts: the play,
    and how dry friction slows it, rad/s2.
    """

    inertia: float
    share: float
    dry: float
    least: float
    width: float = 0.0
    slowing: float = 0.0


@dataclass(frozen=True, eq=False)
class _Reversals:
    robot: Robot
    joint: str
    sweeps: tuple[Sweep, ...]
    inertia: float  # of the motor, data sheet

    @cached_property
    def poses(self) -> Array:
        return np.unique([sweep.spec.pose for sweep in self.sweeps], axis=0)

    @cached_property
    def nominal(self) -> Array:
        """Inertia of the load in each pose, from CAD."""
        robot = self.robot
        return inertia_rows(robot.chain, robot.index(self.joint), self.poses) @ robot.chain.inertial.ravel()

    @cached_property
    def dry(self) -> float:
        """Dry friction of motor and load, N m (N): effort with the motion, on average."""
        viscous, records = self.robot.axis(self.joint).viscous_friction or 0.0, [s.recording for s in self.sweeps]
        means = [np.mean((one.effort - viscous * one.velocity) * np.sign(one.velocity)) for one in records]
        return max(float(np.median(means)), 0.0)

    @cached_property
    def presliding(self) -> list[Array]:
        """States (ways, t) of friction in each sweep."""
        return [bristles(sweep.recording.position[None], BRISTLES)[:, 0] for sweep in self.sweeps]


def measured_play(robot: Robot, joint: str, sweeps: Sequence[Sweep]) -> Play | None:
    """The play of `joint` from repeated sweeps about standstill; None if there is none, if they cannot show it, or if
    the motor's inertia is unknown.
    """
    reversing = (s for s in sweeps if s.spec.excitation == "multisine" and not s.spec.offset_velocity)
    own = tuple(map(robot.without_counterbalance, reversing))
    inertia = robot.axis(joint).reflected_motor_inertia
    if not inertia or len({sweep.spec.repeat for sweep in own}) < 2:
        return None
    axis = _Reversals(robot, joint, own, inertia)
    tried = [_Assumed(inertia, *one) for one in product((0.3, 0.7), (0.0, axis.dry), (2.0, 4.0, 7.0))]
    if axis.dry > 0.002 * robot.axis(joint).rated_effort:  # which may be on the load and stop it between the flanks
        slowing = axis.dry / float(axis.nominal.mean())
        tried += [_Assumed(inertia, 0.5, 0.0, 4.0, *one) for one in product(STARTS, (0.5 * slowing, slowing))]
    found: dict[float, _Assumed] = {}  # by what is left on held-out repeats
    for _ in range(4):
        found |= {one.left: one.next for assumed in tried if (one := _fitted(axis, assumed)) is not None}
        tried = [found[left] for left in sorted(found)[:3]]
    best_of = [found[left] for left in sorted(found)[:6]]
    plays = [(play, assumed) for assumed in best_of if (play := _play(axis, assumed)) is not None]
    if not plays:
        return None
    best, assumed = min(plays, key=lambda one: one[0].after)
    spread = float(np.std([play.width for play, _ in plays if play.after < 1.5 * best.after]))
    # 0.06: contacts are seen a few milliseconds late
    best = replace(best, std=float(np.sqrt(best.std**2 + spread**2 + (0.06 * best.width) ** 2)))
    if not best.is_certain:
        return None
    seen = _by_encoder(axis, assumed)
    return best if seen is None else replace(best, width=seen[0], std=seen[1])


@dataclass(frozen=True)
class _PlayFit:
    """A fit with play: its rows, columns, coefficients, inertia of the load in each pose, and what to assume next."""

    rows: _FlankRows
    law: Array
    values: Array
    inertia: Array
    left: float  # part of the rigid model's residual on held-out repeats
    next: _Assumed

    @property
    def rigid(self) -> Array:
        """Columns without play."""
        return np.column_stack([self.rows.motor, self.rows.load + self.rows.opened])


def _fitted(axis: _Reversals, assumed: _Assumed) -> _PlayFit | None:
    """None if too few sweeps touch both flanks."""
    parts = [part for number in range(len(axis.sweeps)) if (part := _rows(axis, assumed, number)) is not None]
    if len({int(part.repeat[0]) for part in parts}) < 2:
        return None
    rows = _FlankRows(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(_FlankRows)))
    inertia, at = axis.nominal, rows.motor.shape[1] + rows.load.shape[1]
    for _ in range(2):
        values = _fit(axis, rows.law(inertia), rows.effort)
        inertia = np.maximum(values[rows.motor.shape[1] : at], 0.1 * axis.nominal)
    law = rows.law(inertia)
    values = _fit(axis, law, rows.effort)
    motor, _, on_motor, on_load, *_ = values.tolist()
    most = 1.5 * axis.dry + 0.001 * axis.robot.axis(axis.joint).rated_effort
    following = replace(
        assumed,
        inertia=motor,
        dry=float(np.clip(on_motor, 0.0, most)),
        width=max(2 * float(values[at]), 0.0),
        slowing=float(np.clip(on_load, 0.0, most)) / float(inertia.mean()),
    )
    fitted = _PlayFit(rows, law, values, inertia, 1.0, following)
    before, after = _rms(_left_out(axis, fitted.rigid, rows)), _rms(_left_out(axis, law, rows))
    return replace(fitted, left=round(after / before, 6))


def _play(axis: _Reversals, assumed: _Assumed) -> Play | None:
    """The play as held-out repeats confirm it."""
    fitted = _fitted(axis, assumed)
    if fitted is None:
        return None
    rows, law = fitted.rows, fitted.law
    at = rows.motor.shape[1] + rows.load.shape[1]
    rigid = fitted.rigid
    before, smooth, after = (
        _left_out(axis, columns, rows) for columns in (rigid, np.column_stack([rigid, rows.smooth]), law)
    )
    values, std = _with_std(axis, law, rows)
    closed, closed_std = _with_std(axis, np.column_stack([law, rows.opened @ fitted.inertia]), rows)
    return Play(
        width=float(2 * values[at]),
        std=float(2 * std[at]),
        ratio=float(1 - closed[-1]),
        ratio_std=float(closed_std[-1]),
        before=_rms(before),
        smooth=_rms(smooth),
        after=_rms(after),
        floor=_between_repeats(rows.effort - law @ values, rows),
        effort=_rms(rows.effort),
        rows=len(rows.effort),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _fit(axis: _Reversals, columns: Array, effort: Array) -> Array:
    """Coefficients by least squares; the first is the motor's inertia, with its prior."""
    size = np.linalg.norm(columns, axis=0)
    size[size == 0] = 1.0
    free = np.asarray(np.linalg.lstsq(columns / size, effort, rcond=1e-9)[0], dtype=np.float64)
    prior = np.zeros(columns.shape[1])
    prior[0] = _rms(effort - columns / size @ free) / (axis.robot.prior.motor_inertia * axis.inertia)
    matrix, right = np.vstack([columns, prior]) / size, np.append(effort, prior[0] * axis.inertia)
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-9)[0], dtype=np.float64) / size


def _left_out(axis: _Reversals, columns: Array, rows: _FlankRows) -> Array:
    """Residual (n,) of each repeat by a fit to the others."""
    left = np.empty_like(rows.effort)
    for repeat in np.unique(rows.repeat):
        out = rows.repeat == repeat
        left[out] = rows.effort[out] - columns[out] @ _fit(axis, columns[~out], rows.effort[~out])
    return left


def _with_std(axis: _Reversals, columns: Array, rows: _FlankRows) -> tuple[Array, Array]:
    """Coefficients, and their std by the jackknife over sweeps."""
    numbers = np.unique(rows.sweep)
    kept = [rows.sweep != number for number in numbers]
    others = np.array([_fit(axis, columns[one], rows.effort[one]) for one in kept])
    values = _fit(axis, columns, rows.effort)
    return values, np.sqrt(len(numbers) - 1) * others.std(axis=0)


def _between_repeats(left: Array, rows: _FlankRows) -> float:
    """RMS of a residual (n,) minus its mean over repeats."""
    _, which, count = np.unique(rows.moment, return_inverse=True, return_counts=True)
    away = left - (np.bincount(which, left) / count)[which]
    return float(np.sqrt(np.sum(away**2) / max(int(np.sum(count - 1)), 1)))


def _contacts(axis: _Reversals, assumed: _Assumed, number: int) -> tuple[Array, Array, NDArray[np.intp]]:
    """Acceleration of the motor (t,) and torque through the gear (t,) of a sweep, and the samples at a flank."""
    record, rate = axis.sweeps[number].recording, axis.sweeps[number].spec.sample_rate
    viscous, brief = axis.robot.axis(axis.joint).viscous_friction or 0.0, max(1e-3 * rate, 0.7)
    acceleration = gaussian_filter1d(in_frequency(record.velocity[None], rate)[0], brief)
    through = gaussian_filter1d(record.effort, brief) - assumed.inertia * acceleration
    through -= assumed.share * viscous * record.velocity + assumed.dry * np.sign(record.velocity)
    unsure = (
        np.std(np.diff(record.effort, 2)) / np.sqrt(6.0),  # noise
        axis.robot.prior.motor_inertia * axis.inertia * 1.5 * np.median(np.abs(acceleration)),
        0.3 * viscous * np.std(record.velocity),  # of the share
    )
    return acceleration, through, np.flatnonzero(np.abs(through) > assumed.least * np.linalg.norm(unsure))


def _by_encoder(axis: _Reversals, assumed: _Assumed) -> tuple[float, float] | None:
    """Play and its std from the load's encoder where the gear touches: a step between the flanks, beside elasticity."""
    rows: list[Array] = []
    for number, sweep in enumerate(axis.sweeps):
        _, through, contacts = _contacts(axis, assumed, number)
        if sweep.recording.load_position is None or not len(contacts):
            continue
        torque, lag = through[contacts], (sweep.recording.position - sweep.recording.load_position)[contacts]
        columns = np.column_stack([np.sign(torque), torque, lag])
        rows.append(columns - columns.mean(axis=0))  # two encoders need not have one zero
    if len(rows) < 2:
        return None
    kept = [range(len(rows)), *([k for k in range(len(rows)) if k != out] for out in range(len(rows)))]
    whole = [np.concatenate([rows[k] for k in some]) for some in kept]
    widths = np.array([2 * np.linalg.lstsq(one[:, :2], one[:, 2])[0][0] for one in whole])
    # 0.02: elasticity of the flanks is not quite linear in their damped torque
    return float(widths[0]), float(np.hypot(np.sqrt(len(rows) - 1) * np.std(widths[1:]), 0.02 * widths[0]))


def _rows(axis: _Reversals, assumed: _Assumed, number: int) -> _FlankRows | None:
    """The rows of one sweep; None if it does not touch both flanks, or too briefly."""
    sweep, sheet = axis.sweeps[number], axis.robot.axis(axis.joint)
    record, rate = sweep.recording, sweep.spec.sample_rate
    position, viscous, times = record.position, sheet.viscous_friction or 0.0, np.arange(len(record.position))
    acceleration, through, contacts = _contacts(axis, assumed, number)
    sides, direction = np.sign(through[contacts]), np.sign(record.velocity)
    if len(contacts) < 10 or np.ptp(sides) < 2:
        return None
    width = rate / (2 * np.pi * IMPACTS)
    edge = int(4 * width)
    first, last = max(edge, contacts[0] + edge // 2), min(len(times) - edge, contacts[-1] - edge // 2)
    at = times[:: max(1, int(width))]
    at = at[(at >= first) & (at < last)]
    if len(at) < 10:
        return None

    # only these samples are filtered; where a kernel exceeds the record by its last sample, that of the record counts
    near = np.clip(at[:, None] + np.arange(len(_weights(width, 0))) - len(_weights(width, 0)) // 2, 0, times[-1])

    def low(signal: Array, order: int = 0) -> Array:
        return np.asarray(signal[near] @ _weights(width, order) * rate**order, dtype=np.float64)

    pose = int(np.argmax((axis.poses == np.array(sweep.spec.pose)).all(axis=1)))
    here = np.eye(len(axis.poses))[pose]
    nominal, on_load = float(axis.nominal[pose]), (1 - assumed.share) * viscous
    damping = on_load / nominal if assumed.width else 0.0  # of a way that is not known yet
    flank = np.interp(times, contacts, sides)
    path = _between(contacts, position[contacts] - sides * assumed.width / 2, times / rate, assumed.slowing, damping)
    beyond = position - flank * assumed.width / 2 - path
    moving = np.sign(np.gradient(path))
    away = position - sweep.spec.pose[axis.robot.index(axis.joint)]
    inertial, opened = low(acceleration), low(beyond, 2)
    weight = np.column_stack([np.ones(len(at)), low(away)])
    twist = [-(nominal * low(x, 2) + on_load * low(x, 1)) / sheet.rated_effort for x in (through, through**3)]
    presliding = [low(state) for state in axis.presliding[number]]
    friction = [inertial, low(record.velocity), low(direction), low(moving)]
    return _FlankRows(
        effort=low(record.effort) + on_load * low(beyond, 1),
        motor=np.column_stack([*friction, *(one * weight for one in here)]),
        load=(inertial - opened)[:, None] * here,
        flank=-(low(flank, 2) + on_load / nominal * low(flank, 1))[:, None] * here,
        opened=opened[:, None] * here,
        smooth=np.column_stack([*twist, *presliding]),
        sweep=np.full(len(at), number),
        repeat=np.full(len(at), sweep.spec.repeat),
        moment=at + len(times) * pose,
    )


@lru_cache(maxsize=8)
def _weights(width: float, order: int) -> Array:
    """Weights of the samples around one, for a derivative of a Gaussian."""
    reach = int(4 * width + 0.5)
    impulse = np.eye(1, 2 * reach + 1, reach)[0]
    return np.asarray(gaussian_filter1d(impulse, width, order=order, mode="constant")[::-1], dtype=np.float64)


def _between(contacts: NDArray[np.intp], places: Array, time: Array, slowing: float, damping: float) -> Array:
    """Position of the load at `time` (t,) from its `places` at the samples `contacts`: between two, friction slows it,
    rad/s2 and 1/s, until it stands.
    """
    last = np.clip(np.searchsorted(contacts, np.arange(len(time)), side="right") - 1, 0, len(contacts) - 2)
    begin, lasts = time[contacts[last]], time[contacts[last + 1]] - time[contacts[last]]
    way = places[last + 1] - places[last]
    length = np.abs(way)
    slows = slowing + damping * length / lasts + 1e-12
    whole = slows * lasts**2 / 2
    speed = np.where(length > whole, length / lasts + slows * lasts / 2, np.sqrt(2 * slows * length))
    since = np.minimum(np.clip(time - begin, 0.0, lasts), speed / slows)
    return places[last] + np.sign(way) * (speed * since - slows * since**2 / 2)
