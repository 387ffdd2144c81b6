r"""Mass, centre and inertia of a payload on the last link, with their uncertainty.

The information (below) is linear in the body's ten parameters phi in the last joint's
frame, [m, m c, I at the origin]. A parameter that is not excited keeps a spread of 1e3 and is reported as not
excited: a standard deviation above half of the natural size (of m the mass itself, of c `LENGTH`, of I m LENGTH^2).
Mass, centre and inertia about it follow with the Jacobian's spread.

A wrong torque constant scales the values from its axis: `std_total` includes the uncertainty of its prior or calibrated
gain. The body is physical if its pseudo-inertia is positive definite (`physical_consistency`); else the most probable
physical one is given as well, with its distance in standard deviations.

Information on a payload from sweeps of single axes in the same poses before and after mounting it.

Its share of the axis inertias, pose by pose (`torque_gain`):      J_after - J_before = (row of the last link) phi
and, as friction at the same speed is the same, of the mean torque:  after - before = (gravity row) phi + change

with phi (10,) the body's inertial parameters in the last joint's frame. `change`, a constant per axis and direction of
motion, is the drift of friction between the two campaigns; the scatter about it is the noise. The springs of all
axes deflect under the body and rotate the links after them: 0.003 of the change, in each pose and in all of an axis.

Information on a payload from the same motions of all axes before and after mounting it on the last link.

    effort_after - effort_before = (rows of the last link) phi + sum_j c_j (S_j,after - S_j,before) + change of friction

at every instant, for every axis: the robot itself cancels, and with it the error of its model. Small differences of
the paths are corrected by the model from the motions before; viscous friction, dry friction and offset of each axis may
have changed between the runs. Without direct encoders the gears of unknown compliance c_j give way more under the body,
and the robot's own weight acts on other lever arms; S_j is the effort by a unit of it, and a fifth of its share
is uncertain. The band ends below the gears' resonance. Filter, whitening and covariance are those of `motion.fit`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service import BadInput
from service.identification.axis.nominal_priors import TorqueGain, uncalibrated
from service.identification.estimates.torque_gain import fit_pairs, pairs, place
from service.identification.model import (
    BaseParameters,
    Information,
    JointMotion,
    dynamic_base,
    dynamics_names,
    inertia_rows,
    link_rows,
    nominal_parameters,
    prior_information,
)
from service.identification.model.physical_consistency import SearchEnded, is_physical, nearest_physical
from service.identification.motion.choice import scales
from service.identification.motion.equations import AxisEquations, all_equations, whole_parameters
from service.identification.motion.fit import fit_equations
from service.identification.motion.free_motion import FreeMotion, MotionBand, calibrated, free_motions
from service.identification.spectra.frequency_response import Spectrum, spectrum, window
from service.model import INERTIAL_NAMES, Array, Mask, Robot, Sweep, SweepSpec, inertia_matrix, inertia_vector
from service.model.results import payload as results

BODY = 10  # parameters of a rigid body


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
    spectra = [[_true(spectrum(robot, s), gains) for s in part if _alone(s.spec)] for part in (before, after)]
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


def _alone(spec: SweepSpec) -> bool:
    """Whether the spectrum has lines and contains inertia, and no other axis moves."""
    return spec.periodic and spec.excitation == "multisine" and spec.shows_inertia


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
    # 2 mrad of sag change the lever arms of the robot's own weight
    rows, values, sag = (x - drift @ np.linalg.lstsq(drift, x, rcond=None)[0] for x in (rows, values, 0.003 * values))
    if np.abs(rows).max() < 1e-9:
        return None
    fitted = rows @ np.linalg.lstsq(rows, values, rcond=1e-9)[0]
    freedom = len(values) - drift.shape[1] - int(np.linalg.matrix_rank(rows, 1e-9 * float(np.abs(rows).max())))
    # of the rated effort: drift of friction without enough sweeps
    scatter = np.sqrt(float(np.sum((values - fitted) ** 2)) / freedom) if freedom >= 3 else 0.005 * rated
    noise = max(float(scatter), 2e-4 * rated)
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
    instants = 50  # of a window at which gravity is averaged
    first, count = window(sweep.spec, sweep.recording.time)
    poses = np.tile(sweep.spec.pose, (instants, 1))
    poses[:, number] = sweep.recording.position[np.linspace(first, first + count - 1, instants).astype(int)]
    rows = link_rows(robot.chain, robot.gravity, JointMotion(poses, 0 * poses, 0 * poses))
    return rows[:, number, last_link(robot)].mean(axis=0)


def motion_evidence(
    robot: Robot, before: Sequence[FreeMotion], after: Sequence[FreeMotion], gains: Mapping[str, float]
) -> list[BodyEvidence]:
    """Of all motions that were run both before and after; if there are several, also of each alone. Raises BadInput if
    there are motions, but none in both.
    """
    both = [match for loaded in after if (match := _match(before, loaded)) is not None]
    if not both:
        if before and after:
            raise BadInput("payload", "no motion was run both before and after: the same program, block and axes")
        return []
    slow = [[replace(calibrated(one, gains), highest=MotionBand.payload) for one in pair] for pair in both]
    empty, loaded = [one for one, _ in slow], [other for _, other in slow]
    base, count = dynamic_base(robot), len(robot.axes)
    # a rotor without data sheet may be far heavier than what it turns
    start, prior = base.combination @ nominal_parameters(robot), prior_information(robot, base, scales(empty))
    fit = fit_equations(robot, empty, all_equations(robot, base, empty), prior, start)
    known = whole_parameters(robot, base, fit.evidence.honest.plus(prior).solve(start).values)
    # rad (m) of a gear under its rated effort, one sigma
    twist, unknown = 0.02, np.zeros(BODY + count)
    springs = Information(np.diag([*BODY * [0.0], *((axis.rated_effort / twist) ** 2 for axis in robot.axes)]), unknown)
    bare = _whole_equations(robot, empty, known)
    everything, parts, heavier = range(len(both)), list[AxisEquations](), known.copy()

    def evidence(of: Sequence[int]) -> BodyEvidence:
        fit = fit_equations(robot, loaded, [each for each in parts if each.record in of], springs, unknown).evidence
        found, through = fit.honest.first(BODY, springs)
        by_gain = fit.gain_vector[:BODY] - through.T @ fit.gain_vector[BODY:]
        compliance = fit.honest.plus(springs).solve(unknown).values[BODY:]
        # one sigma: a fifth of what each gear gives way is hysteresis or grows otherwise than with the torque
        bent = 0.2 * np.linalg.lstsq(fit.honest.matrix[:BODY, :BODY], fit.honest.matrix[:BODY, BODY:] * compliance)[0]
        wide = np.hstack([np.eye(BODY), bent])
        with_bent = Information(wide.T @ found.matrix @ wide, wide.T @ found.vector, found.count)
        information, through = with_bent.first(BODY, Information(np.eye(BODY + count), unknown))
        source = ", ".join(f"{both[k][0].ids[0]} and {both[k][1].ids[0]}" for k in of)
        return BodyEvidence("all axes", information, by_gain - through.T @ bent.T @ by_gain, source)

    for _ in range(3):  # the gears give way according to the body
        parts = _differences(robot, known, bare, _whole_equations(robot, loaded, heavier))
        body = evidence(everything).information.solve(np.zeros(BODY)).values
        heavier[last_link(robot)] = known[last_link(robot)] + body
    return [evidence(everything), *(evidence([k]) for k in everything if len(both) > 1)]


def _match(before: Sequence[FreeMotion], loaded: FreeMotion) -> tuple[FreeMotion, FreeMotion] | None:
    """The first record of the same motion, both cut to their common part; None if there is none."""
    for one in before:
        if (one.joints, one.rate, one.block) == (loaded.joints, loaded.rate, loaded.block):
            pair = _aligned(one, loaded)
            # relative: a loaded axis has a larger following error
            if pair[0].same_motion(pair[1], 0.2, 0.02):
                return pair
    return None


def _aligned(one: FreeMotion, other: FreeMotion) -> tuple[FreeMotion, FreeMotion]:
    """Both without the part before the later start: the shift at which their paths differ least."""
    # s between the starts of two records
    most = min(round(2.0 * one.rate), len(one.position) // 4, len(other.position) // 4)
    shifts = range(-most, most + 1)
    apart = [_apart(one.position, other.position, shift, most) for shift in shifts]
    shift = shifts[int(np.argmin(apart))]
    first, second = _part(one, slice(max(shift, 0), None)), _part(other, slice(max(-shift, 0), None))
    length = min(len(first.position), len(second.position))
    return _part(first, slice(length)), _part(second, slice(length))


def _apart(one: Array, other: Array, shift: int, margin: int) -> float:
    length = min(len(one), len(other)) - margin
    a, b = one[max(shift, 0) :][:length:5], other[max(-shift, 0) :][:length:5]
    count = min(len(a), len(b))
    return float(np.mean((a[:count] - b[:count]) ** 2))


def _part(record: FreeMotion, part: slice) -> FreeMotion:
    return replace(
        record,
        effort=record.effort[part],
        position=record.position[part],
        load_position={joint: column[part] for joint, column in record.load_position.items()},
        load_velocity={joint: column[part] for joint, column in record.load_velocity.items()},
    )


def _whole_equations(robot: Robot, records: Sequence[FreeMotion], parameters: Array) -> list[AxisEquations]:
    """In all parameters (14 n,), with springs under a robot of these."""
    names = dynamics_names(robot.chain)
    everything = BaseParameters(names, tuple(range(len(names))), np.eye(len(names)))
    return all_equations(robot, everything, records, carried=parameters[: BODY * len(robot.axes)])


def _differences(
    robot: Robot, known: Array, bare: Sequence[AxisEquations], loaded: Sequence[AxisEquations]
) -> list[AxisEquations]:
    """Equations in the body's ten parameters and n compliances; friction of the axes may have changed."""
    count = len(robot.axes)
    without = {(each.joint, each.record): each for each in bare}
    found: list[AxisEquations] = []
    for each in loaded:
        other = without.get((each.joint, each.record))
        if other is None:
            continue
        friction = [part * count + robot.index(each.joint) for part in (11, 12, 13)]
        springs = each.springs - other.springs
        found.append(
            replace(
                each,
                rows=np.hstack([each.rows[:, last_link(robot)], springs]),
                springs=springs,
                values=each.values - other.values - (each.rows - other.rows) @ known,
                ripple=np.hstack([each.rows[:, friction], each.ripple, other.ripple]),
                sound=each.sound & other.sound,
            )
        )
    return found


LENGTH = 0.3  # m, of a payload


@dataclass(frozen=True)
class PayloadFit:
    """phi (10,) with its covariance (10, 10), conditional on the torque constants and in total; the same of [m, c, I
    about c].

    `excited` (10,) of the latter. `nearest` (10,): phi of the most probable physical body, `deviation` its distance in
    standard deviations, `ended` how its search ended. `evidence` by axis.
    """

    parameters: Array
    covariance: Array
    covariance_total: Array
    body: Array
    body_std: Array
    body_std_total: Array
    excited: Mask
    physical: bool
    nearest: Array
    deviation: float
    ended: SearchEnded
    evidence: tuple[BodyEvidence, ...]
    repeats: tuple[float, ...] = ()  # kg, by each motion alone, if there are several


def payload(
    robot: Robot, before: Sequence[Sweep], after: Sequence[Sweep], gains: Mapping[str, TorqueGain] | None = None
) -> PayloadFit:
    """The body that is mounted in `after` and not in `before`; `gains` calibrated by joint. BadInput without common
    motions, and where no effort differs.
    """
    known = gains or {}
    values = {joint: one.gain for joint, one in known.items()}
    empty, loaded = (free_motions(robot, [_as_free(sweep) for sweep in part]) for part in (before, after))
    motions = motion_evidence(robot, empty, loaded, values)
    evidence = [*sweep_evidence(robot, before, after, values), *motions[:1]]
    if not evidence:
        raise BadInput("payload", "no sweep in the same pose and no motion of several axes is in both bundles")
    spread = [one.std / one.gain for one in (known.get(joint) or uncalibrated(robot) for joint in robot.joints)]
    found, *alone = (_solve(robot, part, np.array(spread)) for part in (evidence, *([one] for one in motions[1:])))
    return replace(found, repeats=tuple(float(one.body[0]) for one in alone if one.excited[0]))


def _as_free(sweep: Sweep) -> Sweep:
    """A trajectory with periods as a free motion."""
    if sweep.spec.excitation != "trajectory":
        return sweep
    return replace(sweep, spec=sweep.spec.model_copy(update={"sines": ()}))


def planned_mass_std(robot: Robot, position: Array, rate: float) -> float:
    """Standard deviation of a payload's mass, kg, from one pair of runs along `position` (m, n), by Cramer and Rao.

    Torque noise of 0.5 % of the rated effort, white below the band of free motions; friction may change between runs.
    """
    velocity = np.gradient(position, 1 / rate, axis=0)
    motion = JointMotion(position, velocity, np.gradient(velocity, 1 / rate, axis=0))
    rows = link_rows(robot.chain, robot.gravity, motion)[:, :, last_link(robot)]
    information = Information.empty(BODY).add(np.eye(BODY), np.zeros(BODY), 1e6 * np.eye(BODY))
    for k, axis in enumerate(robot.axes):
        drive = np.stack([velocity[:, k], np.sign(velocity[:, k]), np.ones(len(velocity))], -1)
        own = rows[:, k] - drive @ np.linalg.lstsq(drive, rows[:, k], rcond=None)[0]
        # both runs have noise; so many samples are one independent value
        variance = 2 * (0.005 * axis.rated_effort) ** 2 * max(rate / (2 * MotionBand.payload), 1.0)
        information = information.plus(Information(own.T @ own / variance, np.zeros(BODY), len(own)))
    return float(information.solve(np.zeros(BODY)).std[0])


def body_of(parameters: Array) -> Array:
    """[m, mc, I at the origin] -> [m, c, I about c], (10,) each."""
    mass = parameters[0]
    centre = parameters[1:4] / mass
    about = inertia_matrix(parameters) - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return np.concatenate([[mass], centre, inertia_vector(about)])


def _solve(robot: Robot, evidence: Sequence[BodyEvidence], gain_spread: Array) -> PayloadFit:
    wide = np.array([1e3, *3 * [1e3], *6 * [1e3]])  # kg, kg m, kg m^2: one sigma of unknown parameters
    information = Information.empty(BODY).add(np.eye(BODY), np.zeros(BODY), np.diag(wide**2))
    for each in evidence:
        information = information.plus(each.information)
    solution = information.solve(np.zeros(BODY))
    if not solution.values[0]:
        raise BadInput("payload", "no effort differs between the bundles: name one without the payload and one with it")
    by_gain = solution.covariance @ sum((each.gain_vector for each in evidence), np.zeros((BODY, len(robot.axes))))
    total = solution.covariance + (by_gain * gain_spread**2) @ by_gain.T
    jacobian = _jacobian(solution.values)
    body, (std, std_total) = body_of(solution.values), (_std(jacobian, c) for c in (solution.covariance, total))
    # for natural sizes
    mass = max(abs(solution.values[0]), 0.02 * float(robot.chain.inertial[:, 0].max()))
    size = np.array([mass, *3 * [LENGTH], *6 * [mass * LENGTH**2]])
    nearest, deviation, ended = _physical(solution.values, solution.covariance, mass)
    return PayloadFit(
        parameters=solution.values,
        covariance=solution.covariance,
        covariance_total=total,
        body=body,
        body_std=std,
        body_std_total=std_total,
        excited=std < size / 2,
        physical=bool(is_physical(solution.values)),
        nearest=nearest,
        deviation=deviation,
        ended=ended,
        evidence=tuple(evidence),
    )


def _physical(values: Array, covariance: Array, mass: float) -> tuple[Array, float, SearchEnded]:
    """The physical body that agrees best, near a compact one where nothing was excited; its distance, how it ended."""
    centre = np.clip(values[1:4] / mass, -LENGTH, LENGTH)
    compact = mass * (LENGTH / 2) ** 2 * np.eye(3) + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    nominal = np.concatenate([[mass], mass * centre, inertia_vector(compact), [0.0]])
    rows = np.hstack([np.eye(BODY), np.zeros((BODY, 1))])
    # relative spread 1 of a compact body
    found = nearest_physical(nominal, (1.0, np.ones(1)), rows, values, covariance)
    return found.parameters[:BODY], found.deviation, found.ended


def _std(jacobian: Array, covariance: Array) -> Array:
    return np.sqrt(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian))


def _jacobian(at: Array) -> Array:
    """Of `body_of` by central differences, (10, 10)."""
    # relative, and of a least size
    steps = 1e-6 * np.maximum(np.abs(at), 1e-3)
    columns = [(body_of(at + h) - body_of(at - h)) / (2 * s) for s, h in zip(steps, np.diag(steps), strict=True)]
    return np.stack(columns, -1)


CENTER = ("x", "y", "z")
TENSOR = INERTIAL_NAMES[4:]


def payload_document(robot: Robot, found: PayloadFit) -> results.Payload:
    """SI, in the frame of the last joint; `inertia` about the centre of mass. Parameters that were not excited are
    None.
    """
    figures = tuple(
        results.BodyFigure(
            value=float(value) if excited else None,
            std=float(std) if excited else None,
            std_total=float(total) if excited else None,
            excited=bool(excited),
        )
        for value, std, total, excited in zip(
            found.body, found.body_std, found.body_std_total, found.excited, strict=True
        )
    )
    mass, x, y, z, *tensor = body_of(found.nearest).tolist()
    return results.Payload(
        link=robot.chain.joints[-1].link,
        frame=robot.joints[-1],
        mass=figures[0],
        center=dict(zip(CENTER, figures[1:4], strict=True)),
        inertia=dict(zip(TENSOR, figures[4:], strict=True)),
        parameters=results.BodyParameters(
            names=tuple(INERTIAL_NAMES),
            values=tuple(found.parameters.tolist()),
            covariance=tuple(map(tuple, found.covariance.tolist())),
            covariance_total=tuple(map(tuple, found.covariance_total.tolist())),
        ),
        physical=results.PhysicalBody(
            consistent=found.physical,
            deviation_in_std=found.deviation,
            nearest=results.PayloadBody(mass=mass, center=(x, y, z), inertia=dict(zip(TENSOR, tensor, strict=True))),
        ),
        evidence=tuple(results.Evidence(axis=each.joint, source=each.source) for each in found.evidence),
        sentences=tuple(sentences(found)),
    )


def sentences(found: PayloadFit) -> list[str]:
    """Notes for the user in addition to the values."""
    notes: list[str] = []
    least = results.DETECTED * np.sqrt(found.covariance[0, 0])
    if not abs(found.parameters[0]) > least and found.excited[0]:
        notes.append(
            f"No mass detected: {found.body[0]:.3g} kg, standard deviation {found.body_std[0]:.2g} kg. If the torques "
            "differ, it is not a load but friction or the torque constants: warm up and record both again."
        )
    if found.parameters[0] < -least:
        notes.append(
            "The mass is negative: exchange the bundles before and after, or check the signs of the efforts. If it is "
            "small, it is friction: warm up and record both again."
        )
    if len(found.repeats) > 1:
        low, high = min(found.repeats), max(found.repeats)
        notes.append(
            f"Repeatability: {len(found.repeats)} motions, each alone, give {low:.4g} to {high:.4g} kg, a range of "
            f"{100 * (high - low) / abs(found.body[0]):.2g} %."
        )
    missing = [name for name, seen in zip(("mass", *CENTER, *TENSOR), found.excited, strict=True) if not seen]
    if missing:
        notes.append(f"The motions do not excite {', '.join(missing)}: these remain unknown.")
    if not found.physical:
        away = f"{found.deviation:.1f} standard deviations away"
        notes.append(f"These ten parameters are not physical; the nearest physical body is {away}.")
    if found.ended is SearchEnded.UNFINISHED:
        notes.append("The search of the nearest physical body did not converge: do not use it; check mass and motions.")
    return notes
