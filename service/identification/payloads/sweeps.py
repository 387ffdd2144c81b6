r"""Information on a payload from sweeps of single axes in the same poses before and after mounting it.

Its share of the axis inertias, pose by pose (`paired_sweeps`):      J_after - J_before = (row of the last link) phi
and, as friction at the same speed is the same, of the mean torque:  after - before = (gravity row) phi + change

with phi (10,) the body's inertial parameters in the last joint's frame. `change`, a constant per axis and direction of
motion, is the drift of friction between the two campaigns; the scatter about it is the noise. The springs of all
axes deflect under the body and rotate the links after them: `SAG` of the change, in each pose and in all of an axis.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.identification.estimates.paired_sweeps import fit_pairs, pairs, place
from service.identification.model.inverse_dynamics import Motion, link_rows
from service.identification.model.least_squares import Information
from service.identification.model.regressor import inertia_rows
from service.identification.spectra.frequency_response import Spectrum, spectrum, window
from service.model.recording import Sweep
from service.model.robot import Robot

Array = NDArray[np.float64]

BODY = 10  # parameters of a rigid body
DRIFT, DRIFT_LEAST = 0.005, 2e-4  # of the rated effort: drift of friction without enough sweeps; least drift
SAG = 0.003  # of the torque added by the body: effect of 2 mrad of sag on the lever arms of the robot's own weight
SCATTER_FREEDOM = 3  # degrees of freedom from which the scatter of the mean torques is used
INSTANTS = 50  # of a window at which gravity is averaged


@dataclass(frozen=True)
class BodyEvidence:
    """Information on phi (10,) from axis `joint`, and its source: poses of sweeps, or ids of free motions."""

    joint: str
    information: Information
    gain_vector: Array  # (10, n): contribution of the efforts of each axis of the robot to information.vector
    source: str


def sweep_evidence(
    robot: Robot, before: Sequence[Sweep], after: Sequence[Sweep], gains: Mapping[str, float]
) -> list[BodyEvidence]:
    """For every axis swept with lines in the same poses before and after; efforts are divided by `gains`."""
    spectra = [[_true(spectrum(robot, s), gains) for s in part if s.spec.periodic] for part in _lines(before, after)]
    found: list[BodyEvidence] = []
    for number, joint in enumerate(robot.joints):
        both = pairs(joint, *spectra)
        if both is None:
            continue
        inertia = _inertia(robot, number, *both)
        torque = _mean_torque(robot, number, before, after, gains.get(joint, 1.0))
        information = inertia if torque is None else inertia.plus(torque)
        by_gain = np.zeros((BODY, len(robot.axes)))
        by_gain[:, number] = information.vector
        source = f"{len({place(one.spec) for one in both[0]})} poses"
        found.append(BodyEvidence(joint, information, by_gain, source))
    return found


def last_link(robot: Robot) -> slice:
    """The last link's ten parameters among those of all links."""
    return slice(BODY * (len(robot.axes) - 1), BODY * len(robot.axes))


def _lines(before: Sequence[Sweep], after: Sequence[Sweep]) -> tuple[list[Sweep], list[Sweep]]:
    """Sweeps whose spectrum has lines and contains inertia, without trajectories of several axes."""
    kept = [[s for s in part if s.spec.excitation == "multisine" and s.spec.shows_inertia] for part in (before, after)]
    return kept[0], kept[1]


def _true(one: Spectrum, gains: Mapping[str, float]) -> Spectrum:
    return replace(one, effort=one.effort / gains.get(one.spec.axis, 1.0))


def _inertia(robot: Robot, number: int, before: Sequence[Spectrum], after: Sequence[Spectrum]) -> Information:
    """From the axis inertias; those without the body are eliminated."""
    paired = fit_pairs(robot, number, before, after, np.zeros(BODY))
    added = paired.carried[:, None] * inertia_rows(robot.chain, number, paired.poses)[:, last_link(robot)]
    information, worse = paired.solve(added)
    places = paired.place.shape[1]
    matrix, vector = information.matrix / worse, information.vector / worse
    share = np.asarray(np.linalg.solve(matrix[:places, :places], matrix[:places, places:]), dtype=float)
    return Information(
        matrix[places:, places:] - matrix[places:, :places] @ share,
        vector[places:] - share.T @ vector[:places],
        information.count - places,
    )


def _mean_torque(
    robot: Robot, number: int, before: Sequence[Sweep], after: Sequence[Sweep], gain: float
) -> Information | None:
    """From the mean efforts of equal sweeps; None if there are none, or if gravity does not act on the axis."""
    joint, rated = robot.joints[number], robot.axes[number].rated_effort
    earlier = {_motion(s): s for s in before if s.spec.axis == joint and _turns(s)}
    matched = [(earlier[_motion(s)], s) for s in after if s.spec.axis == joint and _turns(s) and _motion(s) in earlier]
    if not matched:
        return None
    rows = np.array([_gravity_row(robot, number, s) for _, s in matched])
    values = np.array([_mean(s) - _mean(one) for one, s in matched]) / gain
    forward = np.array([s.spec.offset_velocity > 0 for _, s in matched])
    drift = np.stack([forward, ~forward], -1).astype(float)
    drift = drift[:, drift.any(axis=0)]
    rows, values, sag = (x - drift @ np.linalg.lstsq(drift, x, rcond=None)[0] for x in (rows, values, SAG * values))
    if np.abs(rows).max() < 1e-9:
        return None
    fitted = rows @ np.linalg.lstsq(rows, values, rcond=1e-9)[0]
    freedom = len(values) - drift.shape[1] - int(np.linalg.matrix_rank(rows, 1e-9 * float(np.abs(rows).max())))
    scatter = np.sqrt(float(np.sum((values - fitted) ** 2)) / freedom) if freedom >= SCATTER_FREEDOM else DRIFT * rated
    noise = max(float(scatter), DRIFT_LEAST * rated)
    covariance = np.diag(noise**2 + sag**2) + np.outer(sag, sag)
    return Information.empty(BODY).add(rows, values, covariance)


def _turns(sweep: Sweep) -> bool:
    return sweep.spec.periodic and sweep.spec.excitation == "multisine" and sweep.spec.offset_velocity != 0


def _motion(sweep: Sweep) -> tuple[object, ...]:
    spec = sweep.spec
    return (place(spec), spec.offset_velocity, spec.sines, spec.periods, spec.measure_from, spec.repeat)


def _mean(sweep: Sweep) -> float:
    first, count = window(sweep.spec, sweep.recording.time)
    return float(np.mean(sweep.recording.effort[first : first + count]))


def _gravity_row(robot: Robot, number: int, sweep: Sweep) -> Array:
    """(10,) mean torque of gravity on a body on the last link, along the sweep."""
    first, count = window(sweep.spec, sweep.recording.time)
    poses = np.tile(sweep.spec.pose, (INSTANTS, 1))
    poses[:, number] = sweep.recording.position[np.linspace(first, first + count - 1, INSTANTS).astype(int)]
    rows = link_rows(robot.chain, robot.gravity, Motion(poses, 0 * poses, 0 * poses))
    return rows[:, number, last_link(robot)].mean(axis=0)
