"""All sweeps of one axis as arrays (sweeps, samples), and the one filter for all signals.

The filter is a Gaussian of `BAND`. It is symmetric, so there is no delay. Effort and all columns pass the same filter,
so linear relations between them are preserved. Samples are first averaged down to about
`RATE`. The acceleration is the derivative of velocity in the frequency domain; a difference quotient
would look like a delay or a spring.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import next_fast_len

from service import BadInput
from service.identification.model import finite, gravity_rows
from service.identification.motion.trajectory_record import runs_at_once
from service.model import Array, Complex, Indices, Mask, Recording, Robot, Sweep, SweepSpec

ENDING = 0.05  # s, in which the slope at the end of a record decreases to zero


@dataclass(frozen=True)
class PaddedSpectrum:
    """Signals (n, t) in the frequency domain: their first values (n, 1), and the transform (n, bins) of the rest.

    A signal is assumed constant before its first sample, so a start from standstill is exact. After its last sample it
    returns to the first value, so smoothly and slowly that the response to the end does not reach the start. All of
    that is linear: the spectrum of a sum is the sum of the spectra.
    """

    first: Array
    away: Complex

    def __add__(self, other: "PaddedSpectrum") -> "PaddedSpectrum":
        return PaddedSpectrum(self.first + other.first, self.away + other.away)

    def __mul__(self, response: Complex | Array | float) -> "PaddedSpectrum":
        """Filtered by a response (n or 1, bins) of `bins(t, rate)`, or multiplied by a number."""
        constant = response[:, :1].real if isinstance(response, np.ndarray) else response
        return PaddedSpectrum(self.first * constant, np.multiply(self.away, response, dtype=np.complex128))

    def signal(self, count: int) -> Array:
        """The signals (n, count)."""
        return np.asarray(back(count, self.away) + self.first)


def spectrum(signal: Array, rate: float) -> PaddedSpectrum:
    """The spectrum of signals (n, t)."""
    count = signal.shape[1]
    first, last = signal[:, :1], signal[:, -1:]
    turning, fading = _return(count, rate)
    extended = np.zeros((len(signal), _padded(count)))
    np.subtract(signal, first, out=extended[:, :count])
    np.multiply(last - first, turning, out=extended[:, count : 2 * count])
    extended[:, count : 2 * count] += (last - signal[:, -2:-1]) * ENDING * rate * fading
    return PaddedSpectrum(first, np.asarray(np.fft.rfft(extended), dtype=np.complex128))


@lru_cache(maxsize=8)
def _return(count: int, rate: float) -> tuple[Array, Array]:
    """How a signal returns to its first value after its end: by position, and by slope."""
    after = np.arange(1.0, count + 1) / (ENDING * rate)
    return (1 + np.cos(np.arange(1.0, count + 1) * (np.pi / (count + 1)))) / 2, after * np.exp(-after)


def in_frequency(signal: Array, rate: float) -> Array:
    """Derivative of signals (n, t)."""
    return back(signal.shape[1], derivative_spectrum(signal, rate))


def through(signal: Array, rate: float, response: Complex) -> Array:
    """Signals (n, t) filtered by a response (n or 1, bins) of `bins(t, rate)`; constant before their first sample."""
    return (spectrum(signal, rate) * response).signal(signal.shape[1])


def derivative_spectrum(signal: Array, rate: float) -> Complex:
    """Transform (n, bins) of the derivative of signals (n, t), see `PaddedSpectrum`."""
    frequencies = 2j * np.pi * bins(signal.shape[1], rate)
    return np.multiply(spectrum(signal, rate).away, frequencies, dtype=np.complex128)


def back(count: int, transform: Complex) -> Array:
    """The signals (n, count) of a transform (n, bins)."""
    return np.fft.irfft(transform, _padded(count))[:, :count].astype(np.float64, copy=False)


def bins(samples: int, rate: float) -> Array:
    """Frequencies, Hz, of `in_frequency`."""
    return np.fft.rfftfreq(_padded(samples), 1 / rate).astype(np.float64)


def _padded(samples: int) -> int:
    # 3 times the record: padding, so that the response after the end does not wrap around to the start
    return next_fast_len(3 * samples, real=True)


RATE = 250.0  # Hz, of the columns
BAND = 20.0  # Hz, of the Gaussian
BLOCK = 32  # rows filtered in one operation
EVERY = 2  # samples per row of the equations
STUCK_TIME = 0.016  # s below the speed limit that count as standstill; a zero crossing is shorter
COARSE = 400.0  # Hz: below this rate, friction may reverse within a sample, invisible in the positions
PARTS = 8  # parts into which such a sample is divided
SHORTEST = 2.5e-8  # rad (m): the same for slow recordings, where a sample is much longer


@dataclass(frozen=True)
class Tracks:
    """n sweeps of one axis, t samples at `rate`, padded with standstill; SI units on the joint side.

    `inside`: recorded samples. `usable` (n, rows): rows of the equations that count (recorded, axis not sticking).
    `pose_index` (n,): number of the pose of each sweep; `poses` (m, all joints): the poses. `gravity`: torque along the
    motion from CAD, with the counterbalance. `direction` (n, t): direction of dry friction (sign of the velocity); it
    reverses within the distance `sticking`, rad (m), which is as short as the encoder noise permits.
    """

    robot: Robot
    joint: str
    specs: tuple[SweepSpec, ...]
    rate: float
    pose_index: Indices
    poses: Array
    time: Array
    effort: Array
    velocity: Array
    position: Array
    acceleration: Array
    gravity: Array
    inside: Mask
    usable: Mask
    direction: Array
    sticking: float
    temperature: Array | None

    @property
    def prismatic(self) -> bool:
        return self.robot.chain.joints[self.robot.index(self.joint)].kind == "prismatic"

    @cached_property
    def away(self) -> Array:
        """(n, t): position from that of the pose, rad (m)."""
        return self.position - self.poses[self.pose_index, self.robot.index(self.joint)][:, None]

    @cached_property
    def _turned(self) -> tuple[Array, Array]:
        """Cosine and sine of `away`; 1 and 0 for a prismatic axis, whose gravity force is constant."""
        if self.prismatic:
            return np.ones_like(self.position), np.zeros_like(self.position)
        return np.cos(self.away), np.sin(self.away)

    @cached_property
    def parts(self) -> Array:
        """(3, n, t): the signals along the motion that multiply inertia, torque and slope of a load."""
        return np.stack([self.acceleration, *self._turned])

    def along(self, load: Array) -> Array:
        """Torque (n, t) of a load (3, m), [inertia; torque; its slope] in each pose, along the motion."""
        return self.summed(load, self.parts)

    def summed(self, load: Array, parts: Array) -> Array:
        """The same with other signals (3, n, t)."""
        return np.einsum("kn,knt->nt", load[:, self.pose_index], parts)

    @cached_property
    def balance(self) -> Array:
        """Effort (n, t) against the counterbalance of the robot file along the motion; 0 without one."""
        return self.robot.counterbalance_effort(self.robot.index(self.joint), self.position)

    @cached_property
    def sizes(self) -> Array:
        """(3,): RMS of the signals that multiply inertia, torque and slope."""
        return np.sqrt(np.mean(np.square(self.parts[:, self.inside]), axis=1))

    @cached_property
    def turning(self) -> float:
        """Distance, rad (m), within `STUCK_TIME` after a reversal: friction that reverses within it sticks."""
        low, high = self.velocity.min(axis=1), self.velocity.max(axis=1)
        # 0.3 of the peak speed: speed in the other direction from which a sweep counts as reversing
        reverses = np.minimum(-low, high) > 0.3 * np.maximum(-low, high)
        if not reverses.any():
            return 0.0
        moved = self.acceleration[reverses][self.inside[reverses]]
        return float(np.sqrt(np.mean(moved**2)) * STUCK_TIME**2 / 2)

    @cached_property
    def one_way(self) -> bool:
        """Whether all usable rows were measured in one direction."""
        moving = self.rows(self.direction)[self.usable]
        return not ((moving > 0.5).any() and (moving < -0.5).any())

    @property
    def clock(self) -> Array:
        """(n, t): time in s since the start of the campaign."""
        return self.time + np.array([spec.started_at for spec in self.specs])[:, None]

    @property
    def speed(self) -> float:
        """Peak speed of the slowest sweep that moves, rad/s (m/s)."""
        return slowest(self.velocity)

    def faded(self, rate: Array) -> Array:
        """Attenuation (n, t) of a wave with phase speed `rate`, rad/s, by averaging down to the tracks' rate."""
        block = round(self.specs[0].sample_rate / self.rate)
        half = rate / (2 * self.specs[0].sample_rate)
        small = np.abs(np.sin(half)) < 1e-6
        return np.where(small, 1.0, np.sin(block * half) / (block * np.where(small, 1.0, np.sin(half))))

    @cached_property
    def laplace(self) -> Complex:
        """(1, bins): s = j omega, rad/s, of the bins of filters."""
        return np.asarray(2j * np.pi * bins(self.velocity.shape[1], self.rate)[None], dtype=np.complex128)

    @cached_property
    def turned_over(self) -> Complex:
        """Transform (n, bins) of the acceleration as the derivative of the velocity."""
        return derivative_spectrum(self.velocity, self.rate)

    @cached_property
    def spectra(self) -> dict[str, PaddedSpectrum]:
        """Spectra of the signals that filters of effects use again and again, by the names of their fields."""
        return {name: spectrum(getattr(self, name), self.rate) for name in ("effort", "velocity", "acceleration")}

    @cached_property
    def remembered(self) -> dict[tuple[float, ...], Array]:
        """The latest results of `remember`."""
        return {}

    def remember(self, key: tuple[float, ...], make: Callable[[], Array]) -> Array:
        """A signal that depends on these numbers and on the tracks alone; of some, it is computed only once."""
        if key not in self.remembered:
            # 8 signals of `Tracks.remember`
            while len(self.remembered) >= 8:
                del self.remembered[next(iter(self.remembered))]
            self.remembered[key] = make()
        return self.remembered[key]

    def rows(self, signal: Array) -> Array:
        """A signal (n, t) after the filter: (n, rows)."""
        return lowpass(signal, self.rate)

    def whitened(self, signal: Array, taps: Array) -> Array:
        """The same, then whitened with weights `taps`, oldest first; the first rows, which have no past, are 0."""
        kernel = _kernel(self.rate)
        spread = np.zeros((len(taps) - 1) * EVERY + 1)
        spread[::EVERY] = taps
        result = _filtered(signal, np.convolve(spread, kernel))
        return np.pad(result, ((0, 0), (len(taps) - 1, 0)))


def lowpass(signal: Array, rate: float) -> Array:
    """The Gaussian filter, one row per `EVERY` samples; only complete kernels, no padding: (n, rows)."""
    return _filtered(signal, _kernel(rate))


def _filtered(signal: Array, taps: Array) -> Array:
    """Sums of `taps` times the samples from 0, `EVERY`, ... on; `BLOCK` rows as one product with a band matrix."""
    n, samples = signal.shape
    count = (samples - len(taps)) // EVERY + 1
    blocks = -(-count // BLOCK)
    width = (BLOCK - 1) * EVERY + len(taps)
    padded = np.zeros((n, BLOCK * EVERY * blocks + width))
    padded[:, :samples] = signal
    band = np.zeros((width, BLOCK))
    for k in range(BLOCK):
        band[k * EVERY : k * EVERY + len(taps), k] = taps
    windows = sliding_window_view(padded, width, axis=1)[:, : BLOCK * EVERY * blocks : BLOCK * EVERY]
    return (windows.reshape(-1, width) @ band).reshape(n, -1)[:, :count]


def white_covariance(signal: Array, inside: Mask, rate: float, lags: int) -> Array:
    """Autocovariance (lags + 1,) of filtered rows, assuming that the noise (n, t) is as white as in its top band."""
    powers: list[float] = []
    for row, good in zip(signal, inside, strict=True):
        part = np.diff(row[good], 2)  # removes drift, so that no edge leaks into the top band; gain 16 at the top
        transform = np.abs(np.fft.rfft(part)) ** 2 / len(part)
        frequency = np.fft.rfftfreq(len(part))
        # 0.36 of the rate: above this frequency there is only noise
        top = frequency > 0.36
        powers.append(float(np.median(transform[top] / (2 * np.sin(np.pi * frequency[top])) ** 4)) / np.log(2))
    kernel = _kernel(rate)
    every = np.pad(kernel, (0, lags * EVERY))
    return float(np.median(powers)) * np.array([kernel @ every[k * EVERY :][: len(kernel)] for k in range(lags + 1)])


def row_samples(samples: int, rate: float) -> Indices:
    """Sample numbers of the rows."""
    reach = len(_kernel(rate)) // 2
    return np.arange(reach, samples - reach, EVERY)


def slowest(velocity: Array) -> float:
    """Peak of the slowest row that moves, rad/s (m/s)."""
    peaks = np.abs(velocity).max(axis=1)
    return float(peaks[peaks > 0.05 * peaks.max()].min())


def is_evidence(spec: SweepSpec) -> bool:
    """Whether a diagnosis can use a sweep: its axis follows a motion, and no other axis moves at the same time."""
    return spec.moves and not runs_at_once(spec)


def finite_samples(sweeps: Iterable[Sweep]) -> None:
    """BadInput with sweep, axis and channel if a sample is NaN or infinite."""
    for sweep in sweeps:
        for channel in fields(Recording):
            values: Array | None = getattr(sweep.recording, channel.name)
            if values is not None:
                finite(values, f"sweep {sweep.spec.id} of {sweep.spec.axis}", channel.name)


def tracks(robot: Robot, joint: str, sweeps: Sequence[Sweep]) -> Tracks:
    """The sweeps of `joint` that are evidence; BadInput if there is none, or if a sample is not finite."""
    index = robot.index(joint)
    own = [s for s in sweeps if s.spec.axis == joint and is_evidence(s.spec)]
    if not own:
        raise BadInput(joint, "has no sweep that moves")
    finite_samples(own)
    rates = {s.spec.sample_rate for s in own}
    if len(rates) > 1:
        raise BadInput(joint, f"sweeps have several sample rates: {sorted(rates)} Hz")
    block = max(1, round(rates.pop() / RATE))
    rate = own[0].spec.sample_rate / block
    lengths = [len(s.recording.time) // block for s in own]
    if min(lengths) < 4 * len(_kernel(rate)):
        raise BadInput(f"sweep {own[int(np.argmin(lengths))].spec.id}", f"{min(lengths) / rate:.2f} s are too short")
    most = max(lengths)

    def stacked(column: str) -> Array:
        parts = [_averaged(getattr(s.recording, column), block) for s in own]
        return np.stack([np.pad(part, (0, most - len(part)), mode="edge") for part in parts])

    inside = np.arange(most)[None] < np.array(lengths)[:, None]
    velocity = stacked("velocity") * inside
    position = stacked("position")
    poses, pose_index = _poses(own)
    coarse = own[0].spec.sample_rate < COARSE
    # 2e-6 rad (m): reversal distance for friction without presliding
    # 3.0 times the encoder noise, which must not reverse the friction
    sticking = max(SHORTEST if coarse else 2e-6, 3.0 * _jitter(own))
    found = Tracks(
        robot=robot,
        joint=joint,
        specs=tuple(s.spec for s in own),
        rate=rate,
        pose_index=pose_index,
        poses=poses,
        time=np.broadcast_to(np.arange(most) / rate, velocity.shape),
        effort=stacked("effort"),
        velocity=velocity,
        position=position,
        acceleration=in_frequency(velocity, rate),
        gravity=np.zeros_like(position),
        inside=inside,
        usable=_usable(velocity, position, inside, rate),
        direction=_directions(own, sticking, block, most),
        sticking=sticking,
        temperature=stacked("temperature") if all(s.recording.temperature is not None for s in own) else None,
    )
    terms = gravity_rows(robot.chain, robot.gravity, index, poses) @ robot.chain.inertial.ravel()
    return replace(found, gravity=found.along(np.vstack([np.zeros(len(poses)), terms.T])) + found.balance)


def bristle(position: Array, way: float) -> Array:
    """State of Dahl's model (n, t), -1 to 1: dz/dx = (1 - z sign(v)) / way, exact for each step of positions (n, t)."""
    return bristles(position, [way])[0]


def bristles(position: Array, ways: Sequence[float]) -> Array:
    """States (ways, n, t) of Dahl's model for several ways, see `bristle`."""
    steps = np.ascontiguousarray(np.diff(position, axis=1, prepend=position[:, :1]).T)
    keep = np.exp(-np.abs(steps)[:, None] / np.array(ways)[:, None])
    gained = np.sign(steps)[:, None] * (1 - keep)
    state = np.zeros_like(keep)
    for before, now, kept, more in zip(state[:-1], state[1:], keep[1:], gained[1:], strict=True):
        np.multiply(before, kept, out=now)
        now += more
    return np.moveaxis(state, 0, -1)


def _directions(sweeps: Sequence[Sweep], way: float, block: int, most: int) -> Array:
    """Direction of dry friction (n, t), at the recordings' rate: a reversal may be between samples of the tracks."""
    length = max(len(sweep.recording.position) for sweep in sweeps)
    stacked = np.stack(
        [np.pad(s.recording.position, (0, length - len(s.recording.position)), mode="edge") for s in sweeps]
    )
    rate, parts = sweeps[0].spec.sample_rate, 1
    if rate < COARSE:
        speeds = [s.recording.velocity for s in sweeps]
        stacked = _between(np.stack([np.pad(v, (0, length - len(v))) for v in speeds]), rate)
        parts = PARTS
    state = bristle(stacked, way)[:, ::parts][:, : length // block * block]
    return state.reshape(len(state), -1, block).mean(axis=-1)[:, :most]


def _between(velocity: Array, rate: float) -> Array:
    """Positions (n, PARTS t) within each sample, with the speed interpolated linearly between samples."""
    share = np.arange(PARTS) / PARTS
    start, change = velocity[:, :-1, None], np.diff(velocity, axis=1)[..., None]
    speed = np.concatenate([(start + share * change).reshape(len(velocity), -1), velocity[:, -1:]], axis=1)
    steps = (speed[:, 1:] + speed[:, :-1]) / (2 * PARTS * rate)
    return np.concatenate([np.zeros((len(velocity), 1)), np.cumsum(steps, axis=1)], axis=1)


def sticking_within(tracks: Tracks, sweeps: Sequence[Sweep], way: float) -> Tracks:
    """The same tracks with another reversal distance of dry friction; `sweeps` are those of the tracks."""
    block = round(tracks.specs[0].sample_rate / tracks.rate)
    return replace(tracks, direction=_directions(sweeps, way, block, tracks.effort.shape[1]), sticking=way)


def _jitter(sweeps: Sequence[Sweep]) -> float:
    """Standard deviation of encoder noise, rad (m), from eighth differences; these suppress motion below 20 Hz even at
    250 samples per second; white noise is amplified by sqrt(16 over 8).
    """
    return float(np.median([np.std(np.diff(sweep.recording.position, 8)) for sweep in sweeps])) / np.sqrt(12870)


def _poses(sweeps: Sequence[Sweep]) -> tuple[Array, Indices]:
    """The poses (m, all joints), and for each sweep the number of its pose (n,)."""
    commanded = np.array([sweep.spec.pose for sweep in sweeps])
    # 1e-3 rad (m): largest difference of the joints within one pose
    _, first, pose_index = np.unique(np.round(commanded / 1e-3), axis=0, return_index=True, return_inverse=True)
    return commanded[first], pose_index.reshape(-1)


def laid_out(tracks: Tracks, signals: Sequence[Array]) -> Array:
    """Signals at the samples of each recording in the layout of the tracks, (n, t)."""
    block, most = round(tracks.specs[0].sample_rate / tracks.rate), tracks.effort.shape[1]
    parts = [_averaged(signal, block) for signal in signals]
    return np.stack([np.pad(part, (0, most - len(part)), mode="edge") for part in parts])


def _usable(velocity: Array, position: Array, inside: Mask, rate: float) -> Mask:
    """Rows (n, rows) whose kernel is inside the record and contains no standstill, nor the first distance after one."""
    away = np.maximum.accumulate(np.abs(position - position[:, :1]), axis=1)
    # 3e-4 rad (m) from the start: within it, dry friction depends on the previous motion
    # 0.05 of the travel at most
    early = away < np.minimum(3e-4, 0.05 * away[:, -1:])
    # 0.03 of the peak speed of the slowest sweep: below, friction may have any value (sticking)
    stuck = _long(np.abs(velocity) < 0.03 * slowest(velocity), round(STUCK_TIME * rate))
    spoilt = (stuck | early | ~inside).astype(float)
    return lowpass(spoilt, rate) < 1e-9


def _long(flags: Mask, least: int) -> Mask:
    """Only the runs of True along the rows with at least `least` samples."""
    result = np.zeros_like(flags)
    for row, out in zip(flags, result, strict=True):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(int)))
        for start, end in edges.reshape(-1, 2).tolist():
            out[start:end] = end - start >= least
    return result


def _averaged(signal: Array, block: int) -> Array:
    count = len(signal) // block
    return signal[: count * block].reshape(count, block).mean(axis=1)


def _kernel(rate: float) -> Array:
    width = rate / (2 * np.pi * BAND)
    # 4.0 standard deviations: half width of the Gaussian
    reach = int(np.ceil(4.0 * width))
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    return kernel / kernel.sum()
