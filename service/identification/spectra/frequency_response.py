"""From the samples of one sweep to its lines: DFT of effort, velocity and of all regressors of the effort.

A measured window of P whole periods has bins at multiples of 1/(P period). The excited bins contain the response; the
bins between them contain disturbances: the transient of the elastic load, gravity changing along the path, torque
ripple. So all bins between `LOW` and the last line plus `MARGIN` are kept, and for each candidate regressor x(t) its
DFT over the same window (not a formula for it): no signal has to be periodic for the equation

    effort = sum theta_j x_j     =>     DFT[effort] = sum theta_j DFT[x_j]

to hold bin by bin. X = 1/N sum_n x_n exp(-2 pi i f n / rate): a sine of amplitude a gives |X| = a/2, white noise of
standard deviation s gives real and imaginary parts of variance s^2 / (2 N).

A direct encoder measures the position q of the load. It is differentiated in the frequency domain, after the straight
line through both ends of the window is subtracted:  DFT[dq/dt] = i omega DFT[q - ramp]  at bins above 0 Hz. (Difference
quotients would act like elasticity.) Its noise is noise of a regressor, 10^-4 of the motion and less.

Records without lines (a plain trajectory) use the trapezoidal rule, which approximates the integral over the record to
second order also if its ends differ, and keep the bins from 0 Hz to 20.0. At those bins the first and the last
sample have the same phase factor, so it is the DFT without the last sample and with their mean as first sample.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import ceil

import numpy as np
from numpy.polynomial.legendre import legvander

from service import BadInput
from service.model import Array, Axis, Complex, Indices, Mask, Recording, Robot, Sweep, SweepSpec, link_frames
from service.model.results.spectrum import Pairs, SpectrumDocument


def pairs(values: Complex) -> Pairs:
    """(n,) -> n pairs."""
    return [[value.real, value.imag] for value in values.tolist()]


def from_pairs(values: Pairs) -> Complex:
    """The inverse: (n,)."""
    return np.array([complex(re, im) for re, im in values], dtype=np.complex128)


Bins = Indices


@dataclass(frozen=True)
class Band:
    """Bins and samples that are used."""

    low: float = 1.0  # Hz: below, load- and position-dependent friction dominates
    margin: float = 3.0  # Hz above the last line
    below_nyquist: float = 0.4  # of the sample rate: above, filters against aliasing distort
    whole: float = 1e-6  # relative, by which a number of samples or of periods may differ from a whole one
    rest: float = 0.1  # s; of the highest velocity: longer and slower, an axis of a free record rests
    at_rest: float = 0.005


@dataclass(frozen=True)
class Spectrum:
    """Data of one sweep used by the identification: b bins of the window's DFT; SI on the joint side.

    `regressors` (r, b): DFTs of the signals named by `names`: "gravity_torque" cos d and "gravity_stiffness" sin d
    of the travel d since the start pose (revolute), "ripple" cos and sin of each cogging and transmission order of
    the motor angle, "coulomb" sign of the velocity if it reverses, "rest" any torque while friction holds the axis
    (free record: a step and a slope). A free record also has "acceleration", "offset" and "drag", the velocity times
    its magnitude; it has no gravity about a vertical axis. `load_velocity` (b,) is that of the direct encoder, None
    without one.
    """

    spec: SweepSpec
    samples: int
    frequency: Array  # (b,) Hz
    line: Mask  # (b,) excited
    effort: Complex  # (b,)
    velocity: Complex  # (b,)
    names: tuple[str, ...]
    regressors: Complex  # (r, b)
    load_velocity: Complex | None = None  # (b,)

    def named(self, name: str) -> Complex:
        """All regressors with one name, (r', b)."""
        return self.regressors[[k for k, own in enumerate(self.names) if own == name]]

    def to_document(self) -> SpectrumDocument:
        """For a file; floats are stored without loss."""
        return {
            "spec": self.spec.model_dump(mode="json"),
            "samples": self.samples,
            "frequency": self.frequency.tolist(),
            "line": self.line.tolist(),
            "effort": pairs(self.effort),
            "velocity": pairs(self.velocity),
            "names": list(self.names),
            "regressors": [pairs(row) for row in self.regressors],
            "load_velocity": None if self.load_velocity is None else pairs(self.load_velocity),
        }

    @classmethod
    def from_document(cls, document: SpectrumDocument) -> "Spectrum":
        """The inverse of `to_document`."""
        bins = len(document["frequency"])
        load = document["load_velocity"]
        return cls(
            spec=SweepSpec.model_validate(document["spec"]),
            samples=document["samples"],
            frequency=np.array(document["frequency"]),
            line=np.array(document["line"], dtype=bool),
            effort=from_pairs(document["effort"]),
            velocity=from_pairs(document["velocity"]),
            names=tuple(document["names"]),
            regressors=np.array([from_pairs(row) for row in document["regressors"]]).reshape(-1, bins),
            load_velocity=None if load is None else from_pairs(load),
        )


def spectrum(robot: Robot, sweep: Sweep) -> Spectrum:
    """The spectrum of one sweep of an axis of `robot`, without the effort of its counterbalance. Raises BadInput if the
    record is too short or invalid.
    """
    spec, record = sweep.spec, robot.without_counterbalance(sweep).recording
    index = robot.index(spec.axis)
    check_numbers(spec, record)
    return (_periodic if spec.periodic else _free)(robot, index, spec, record)


def check_numbers(spec: SweepSpec, record: Recording) -> None:
    """BadInput for a NaN or an infinite sample: one would be in every bin."""
    for name in ("effort", "velocity", "position", "load_velocity", "load_position", "excitation_effort"):
        column: Array | None = getattr(record, name)
        if column is not None and not np.isfinite(column).all():
            sample = int(np.flatnonzero(~np.isfinite(column))[0])
            raise BadInput(f"sweep {spec.id} of {spec.axis}", f"{name} is not a number at sample {sample}")


def _periodic(robot: Robot, index: int, spec: SweepSpec, record: Recording) -> Spectrum:
    first, count = window(spec, record.time)
    bins, line = _bins(spec, count)
    part = slice(first, first + count)
    names, signals = _signals(robot, index, spec, record, part)
    rests = held(record.position[part], spec.sample_rate, spec.offset_velocity)
    if rests:
        torques = torques_within(rests, count, float(bins[-1] / count))
        names, signals = (*names, *["rest"] * len(torques)), np.vstack([signals, torques])
    return Spectrum(
        spec=spec,
        samples=count,
        frequency=np.asarray(bins * (spec.sample_rate / count), dtype=float),
        line=line,
        effort=_dft(record.effort[part], bins),
        velocity=_dft(record.velocity[part], bins),
        names=names,
        regressors=_dft(signals, bins),
        load_velocity=_load_velocity(spec, record, first, count, bins),
    )


def _load_velocity(spec: SweepSpec, record: Recording, first: int, count: int, bins: Bins) -> Complex | None:
    """Velocity of the direct encoder at `bins`. BadInput if its travel differs from that of the motor."""
    same_way = 0.5  # allowed relative difference of load and motor travel over the window
    if record.load_position is None:
        return None if record.load_velocity is None else _dft(record.load_velocity[first : first + count], bins)
    way, motor = way_of(record.load_position, first, count), way_of(record.position, first, count)
    if spec.offset_velocity and not abs(way[-1] / motor[-1] - 1) < same_way:
        raise BadInput(
            f"sweep {spec.id} load_position",
            f"moves {way[-1] / motor[-1]:.3g} times as far as position, limit 1 +- {same_way:g}",
        )
    ramp = way[-1] * np.arange(count) / count
    omega = 2 * np.pi * bins * (spec.sample_rate / count)
    return np.asarray(1j * omega * _dft(way[:-1] - ramp, bins), dtype=np.complex128)


def way_of(position: Array, first: int, count: int) -> Array:
    """Travel (count + 1,) since the window's start, including the sample after it, which is extrapolated if missing."""
    way = position[first : first + count + 1] - position[first]
    return way if len(way) > count else np.append(way, 2 * way[-1] - way[-2])


def _free(robot: Robot, index: int, spec: SweepSpec, record: Recording) -> Spectrum:
    first = int(np.searchsorted(record.time, spec.measure_from - 0.5 / spec.sample_rate))
    time = record.time[first:] - record.time[first]
    if len(time) < 8:
        raise BadInput(f"sweep {spec.id}", f"only {len(time)} samples after measure_from {spec.measure_from} s")
    length = float(time[-1])
    bins = np.arange(int(min(20.0, Band.below_nyquist * spec.sample_rate) * length) + 1)  # Hz
    frequency = bins / length
    part = slice(first, None)
    names, signals = _signals(robot, index, spec, record, part)
    if _vertical(robot, index, spec):
        kept = [not name.startswith("gravity") for name in names]
        names, signals = tuple(name for name, keep in zip(names, kept, strict=True) if keep), signals[kept]
    speed = record.velocity[part]
    rests = _rests(speed, spec.sample_rate)
    names, signals = (*names, *["rest"] * len(rests)), np.vstack([signals, rests]) if len(rests) else signals
    velocity = _trapezoidal_dft(speed, bins)
    # by parts: DFT[dv/dt] = [v e^(-iwt)]/T + iw DFT[v]; at the bins e^(-iwT) = 1. No differentiation, no noise gain
    acceleration = 2j * np.pi * frequency * velocity + (speed[-1] - speed[0]) / length
    offset = (bins == 0).astype(complex)
    return Spectrum(
        spec=spec,
        samples=len(time),
        frequency=frequency,
        line=np.zeros(len(frequency), dtype=bool),
        effort=_trapezoidal_dft(record.effort[part], bins),
        velocity=velocity,
        names=("acceleration", "offset", "drag", *names),
        regressors=np.vstack(
            [acceleration, offset, _trapezoidal_dft(speed * np.abs(speed), bins), _trapezoidal_dft(signals, bins)]
        ),
    )


def window(spec: SweepSpec, time: Array) -> tuple[int, int]:
    """First sample and number of samples of the measured window. BadInput if the record is too short for it."""
    if spec.period is None or spec.periods is None:
        raise BadInput(f"sweep {spec.id}", "has no whole periods")
    wanted = spec.period * spec.periods * spec.sample_rate
    count = round(wanted)
    if abs(wanted - count) > Band.whole * wanted:
        raise BadInput(
            f"sweep {spec.id}",
            f"{spec.periods} periods of {spec.period} s are not whole samples at {spec.sample_rate} Hz",
        )
    first = int(np.searchsorted(time, spec.measure_from - 0.5 / spec.sample_rate))
    if first + count > len(time):
        raise BadInput(
            f"sweep {spec.id}",
            f"window of {count} samples from {spec.measure_from} s leaves the record of {len(time)} samples",
        )
    return first, count


def _dft(signals: Array, bins: Bins) -> Complex:
    """X at some bins (..., b) of signals (..., n) over a whole window."""
    transform: Complex = np.fft.rfft(signals)
    return transform[..., bins] / signals.shape[-1]


def _trapezoidal_dft(signals: Array, bins: Bins) -> Complex:
    """The same by the trapezoidal rule, over a record (..., n) including both ends."""
    if signals.ndim > 1:  # one after the other: a record of hours is large
        rows = [_trapezoidal_dft(row, bins) for row in signals]
        return np.array(rows, dtype=np.complex128).reshape(*signals.shape[:-1], len(bins))
    folded = signals[..., :-1].copy()
    folded[..., 0] = (signals[..., 0] + signals[..., -1]) / 2
    return _dft(folded, bins)


def _bins(spec: SweepSpec, count: int) -> tuple[Bins, Mask]:
    """Numbers of the bins in use and which of them are excited. BadInput for a line between two bins."""
    step = spec.sample_rate / count
    number = np.array([sine.frequency for sine in spec.sines]) / step
    if np.any(np.abs(number - np.round(number)) > Band.whole * number):
        raise BadInput(f"sweep {spec.id}", f"a sine is not a whole multiple of {step:.6g} Hz, the window's resolution")
    lines = np.round(number).astype(int)
    highest = int(lines.max())
    last = max(highest, min(highest + round(Band.margin / step), int(Band.below_nyquist * count)))
    first = max(1, min(round(Band.low / step), int(lines.min())))
    bins = np.arange(first, last + 1)
    return bins, np.isin(bins, lines)


def _vertical(robot: Robot, index: int, spec: SweepSpec) -> bool:
    """Whether gravity has no torque about the axis in the pose of a sweep."""
    rotations, _ = link_frames(robot.chain, np.array([spec.pose]))
    axis = rotations[0, index] @ robot.chain.joints[index].axis
    # rad between both
    return float(np.linalg.norm(np.cross(axis, robot.gravity))) < 1e-3 * float(np.linalg.norm(robot.gravity))


def _rests(velocity: Array, rate: float) -> Array:
    """(2 k, n): a step and a slope over every stretch in which the axis rests: friction then balances any torque."""
    still = np.abs(velocity) < Band.at_rest * np.abs(velocity).max()
    return torques_within([one for one in stretches(still) if one.stop - one.start > Band.rest * rate], len(velocity))


def stretches(samples: Mask) -> list[slice]:
    """The intervals of consecutive `samples` (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], samples, [False]])))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def held(position: Array, rate: float, offset: float) -> list[slice]:
    """Samples over which friction holds an axis that should turn at `offset`: a twentieth of its way in 0.1 s."""
    short, slow = max(round(Band.rest * rate), 1), 0.05
    rests = np.abs(position[short:] - position[:-short]) < slow * abs(offset) * short / rate
    return stretches(np.convolve(rests, np.ones(short + 1)) > 0.5)


def torques_within(intervals: Sequence[slice], count: int, highest: float = 0.0) -> Array:
    """(k, `count`): two rows for each interval, 1 and from -1 to 1; 0 outside of it. As many more Legendre polynomials
    as a torque of up to `highest` cycles a sample may need there.
    """
    rows = [np.zeros((0, count))]
    for one in intervals:
        length = one.stop - one.start
        own = np.zeros((2 + ceil(2 * highest * length), count))
        own[:, one] = legvander(np.linspace(-1.0, 1.0, length), len(own) - 1).T
        rows.append(own)
    return np.vstack(rows)


def _signals(
    robot: Robot, index: int, spec: SweepSpec, record: Recording, part: slice
) -> tuple[tuple[str, ...], Array]:
    axis, joint = robot.axes[index], robot.chain.joints[index]
    position, velocity = record.position[part], record.velocity[part]
    names: list[str] = []
    rows: list[Array] = []
    if joint.kind == "revolute" and np.any(robot.gravity):
        way = position - spec.pose[index]
        names += ["gravity_torque", "gravity_stiffness"]
        rows += [np.cos(way), np.sin(way)]
    for order in ripple_orders(axis):
        angle = order * axis.gear_ratio * position
        names += ["ripple", "ripple"]
        rows += [np.cos(angle), np.sin(angle)]
    if velocity.min() < 0 < velocity.max():
        names.append("coulomb")
        rows.append(np.sign(velocity))
    return tuple(names), np.array(rows).reshape(len(rows), len(position))


def ripple_orders(axis: Axis) -> tuple[float, ...]:
    return tuple(sorted({*axis.cogging_orders, *axis.transmission_orders}))


def check_moved_alone(spectra: Sequence[Spectrum]) -> None:
    """BadInput with the sweep if a trajectory ran together with another axis.

    Together are trajectories of several axes that began in the same pose and overlap in time, and those whose block
    states several axes.
    """
    trajectories = [each for each in spectra if each.spec.excitation == "trajectory"]
    for each in trajectories:
        if each.spec.axes_at_once > 1:
            raise BadInput(
                f"sweep {each.spec.id}",
                f"its block {each.spec.block!r} moved several axes at once: the equations of {each.spec.axis} alone do "
                "not hold for it; identify it with the sweeps of the other axes as one trajectory",
            )
    for first, second in combinations(trajectories, 2):
        if _together(first, second):
            raise BadInput(
                f"sweep {second.spec.id}",
                f"{second.spec.axis} moved while {first.spec.axis} did in sweep {first.spec.id} (same pose, "
                f"started_at {second.spec.started_at:g} and {first.spec.started_at:g} s): the equations of one axis do "
                "not hold; identify them as one trajectory of several axes, or correct started_at if they ran one "
                "after the other",
            )


def _together(first: Spectrum, second: Spectrum) -> bool:
    one, other = first.spec, second.spec
    if one.axis == other.axis or one.pose != other.pose:
        return False
    return one.started_at < _end(second) and other.started_at < _end(first)


def _end(spectrum: Spectrum) -> float:
    """End of the record, s on the campaign's clock."""
    return spectrum.spec.started_at + spectrum.spec.measure_from + spectrum.samples / spectrum.spec.sample_rate
