r"""Identifies the torque gain with a known test mass; this separates a wrong torque constant from an unknown payload.

The same slow sweeps with and without the mass differ only by the mass. If a drive indicates g times the true effort,
then in each sweep, for the mean over its samples,

    effort_after - effort_before = g (M(q) + D a) + change of the friction,

M is the gravity torque of the mass and D its inertia, both known. The differences between the motions are computed with
nominal values. The friction may have changed in between, and a part of it may increase with the load: each of these has
a column with a prior. In one direction alone, friction that increases with the load looks like a gain. Therefore the
gain is only accurate if both directions were measured. On an axis without gravity load, D determines the gain
(`torque_gains`).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service import BadInput
from service.diagnosis.fit.equations import nominal_right
from service.diagnosis.rows.rigid import load_rows
from service.diagnosis.rows.signals import Tracks, tracks
from service.identification.axis.nominal_priors import TorqueGain
from service.identification.estimates.torque_gain import KnownMass, torque_gains
from service.identification.model import finite
from service.identification.spectra.frequency_response import spectrum
from service.model import Array, Robot, Sweep, SweepSpec

Visit = tuple[int, tuple[int, ...]]


@dataclass(frozen=True)
class Weighed:
    """Slow sweeps repeated with a known mass on the last link, in poses and at speeds that were measured without."""

    mass: KnownMass
    sweeps: tuple[Sweep, ...]


@dataclass(frozen=True, slots=True)
class WeighedGain(TorqueGain):
    """A gain from sweeps with a test mass. `noise_change`: relative change of its noise in the last round of weighting.

    It is 0 for a gain from inertias (`torque_gains`), whose fit is refused unless it converges.
    """

    noise_change: float = 0.0


def weighed_gain(robot: Robot, joint: str, bare: Sequence[Sweep], weighed: Weighed, rounds: int = 2) -> WeighedGain:
    """Indicated effort over true effort; BadInput if no sweep of the axis was run both without and with the mass, or if
    the gain is not finite. `rounds`: number of fits, each weighted by the noise of the fit before.
    """
    if not weighed.mass.mass > 0:
        raise BadInput("mass", f"{weighed.mass.mass} kg is not above 0")
    turning = [[s for s in part if s.spec.axis == joint and s.spec.offset_velocity] for part in (bare, weighed.sweeps)]
    visits = sorted({_visit(s.spec) for s in turning[0]} & {_visit(s.spec) for s in turning[1]})
    if not visits:
        raise BadInput(joint, "has no sweep that was run both without and with the test mass")
    common = [[s for s in part if _visit(s.spec) in visits] for part in turning]
    light, heavy = (tracks(robot, joint, part) for part in common)
    pull, rated = _added(heavy, weighed.mass), robot.axis(joint).rated_effort
    # 0.01 of the rated effort: with less gravity torque, the gain cannot be determined
    if np.abs(pull).max() < 0.01 * rated:
        spectra = [[spectrum(robot, s) for s in part if s.spec.periodic] for part in common]
        gain = torque_gains(robot, spectra[0], spectra[1], weighed.mass)[joint].gain
        return WeighedGain(gain.gain, gain.std)
    more = _means(heavy, nominal_right(heavy), visits) - _means(light, nominal_right(light), visits)
    grown = _means(heavy, heavy.direction * (np.abs(heavy.gravity + pull) - np.abs(heavy.gravity)), visits)
    columns = [_means(heavy, pull, visits), _means(heavy, heavy.direction, visits), grown]
    # 0.005 of the rated effort: change of friction while a mass is mounted
    # 0.1 of the torque through the gear: friction that increases with it
    prior = np.array([np.inf, 0.005 * rated, 0.1])
    # 0.0003 of the rated effort: scatter of the mean of a sweep
    found = _solved(np.stack(columns, axis=-1), more, 0.0003 * rated, prior, rounds)
    finite(np.array([found.gain, found.std]), joint, "its torque gain with the standard deviation")
    return found


def is_wrong(gain: TorqueGain) -> bool:
    """Whether a gain differs significantly from 1."""
    # 3.0 standard deviations: above, the gain differs from 1
    return abs(gain.gain - 1) > 3.0 * gain.std


def is_decided(gain: TorqueGain) -> bool:
    """Whether a gain is accurate enough to separate a wrong torque constant from a correct one."""
    # 0.006 standard deviation of the gain: above, the test with the mass decides nothing
    return is_wrong(gain) or gain.std < 0.006


def corrected(sweeps: Iterable[Sweep], gain: TorqueGain) -> list[Sweep]:
    """The sweeps with the effort corrected by the gain."""
    return [replace(s, recording=replace(s.recording, effort=s.recording.effort / gain.gain)) for s in sweeps]


def _visit(spec: SweepSpec) -> Visit:
    """Speed and pose."""
    # 1e-3 rad (m): largest difference between positions of one pose
    # 1e-5 rad/s (m/s): largest difference between equal speeds
    return round(spec.offset_velocity / 1e-5), tuple(round(position / 1e-3) for position in spec.pose)


def _added(motion: Tracks, mass: KnownMass) -> Array:
    """Torque of the mass along the motion, N m (N), (n, t)."""
    robot, index = motion.robot, motion.robot.index(motion.joint)
    last = robot.chain.inertial.size
    rows = load_rows(robot, index, motion.poses)[:, last - len(mass.parameters) : last]
    return motion.along((rows @ mass.parameters).reshape(3, -1))


def _means(motion: Tracks, signal: Array, visits: Sequence[Visit]) -> Array:
    """Mean of a signal (n, t) over the usable rows in the sweeps of each visit, (visits,)."""
    means = [float(row[good].mean()) for row, good in zip(motion.rows(signal), motion.usable, strict=True)]
    where = [_visit(spec) for spec in motion.specs]
    of_visit = ([mean for mean, at in zip(means, where, strict=True) if at == visit] for visit in visits)
    return np.array([sum(some) / len(some) for some in of_visit])


def _solved(columns: Array, right: Array, scatter: float, prior: Array, rounds: int) -> WeighedGain:
    """The first coefficient; each has a zero-mean `prior` (k,). The scatter is increased to the residual of the fit."""
    held = np.diag(prior**-2.0)
    values, before = np.zeros(len(prior)), scatter
    for _ in range(rounds):
        before = scatter
        values = np.linalg.solve(columns.T @ columns / scatter**2 + held, columns.T @ right / scatter**2)
        left = right - columns @ values
        scatter = max(scatter, float(np.sqrt(left @ left / max(len(right) - 1, 1))))
    spread = float(np.linalg.inv(columns.T @ columns / scatter**2 + held)[0, 0])
    # 0.003 of the torque of the mass: accuracy of mass, position of the mass and axis angle
    std = float(np.sqrt(spread + (0.003 * values[0]) ** 2))
    return WeighedGain(float(values[0]), std, scatter / before - 1)
