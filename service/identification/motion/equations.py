r"""The equations of a free motion: at every instant and for every axis that moves,

    L[effort] = sum_j x_j L[regressor_j] + L[ripple] + noise                                 (`inverse_dynamics`)

with the same low-pass L for both sides (`free_motion`), which therefore causes no bias, decimated according to its
cut-off. Regressors are computed from the smoothed motion at the full rate: links from the load's if a direct encoder
measures it, drives from the motor's. An axis at rest gives no equation: dry friction balances any torque by the others'
motion. Cogging of the known orders is eliminated by a cosine and a sine each, before `least_squares`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from service.identification.model import BaseParameters, JointMotion, link_rows
from service.identification.motion.free_motion import FreeMotion, low_pass, memory
from service.model import Array, Mask, Robot


@dataclass(frozen=True)
class Sampling:
    """Speeds and angles at which terms are tried."""

    still: float = 0.01  # of the largest velocity: below, an axis counts as at rest
    creeping: float = 0.02  # the same of free motions: elastic axes creep, and dry friction has not yielded
    link_rate: float = 200.0  # Hz, at which the links' rows are computed: products of a few smoothed motions
    low_speeds: tuple[float, ...] = (0.05, 0.1, 0.2)  # of the largest: where friction has fallen to 37 %
    angles: tuple[float, ...] = (1.0, 2.0, 3.0)  # periods per revolution (per 2 pi m)


OF_SPEED, OF_ANGLE = "friction of the speed", "a torque of the angle"
LACKS = [OF_SPEED] * (len(Sampling.low_speeds) + 2) + [OF_ANGLE] * (2 * len(Sampling.angles))


@dataclass(frozen=True)
class AxisEquations:
    """Rows (m, r) and values (m,) of one axis along one record, N m (N), every `step` seconds; `sound` (m,): equations
    that are used. `ripple` (m, 2 orders): columns eliminated by least squares. `lacks` (m, t): what the model of the
    axis may lack, `friction_laws` first. `springs` (m, n): effort by what the gear of each axis gives way, nominally.
    """

    joint: str
    record: int
    rows: Array
    values: Array
    ripple: Array
    lacks: Array
    springs: Array
    sound: Mask
    time: Array  # (m,) s since the record's start


def load_and_motor(robot: Robot, record: FreeMotion) -> tuple[JointMotion, JointMotion]:
    """Smoothed motion (m, n) of all loads (of the motors where they are not measured) and of all motors."""
    columns = [robot.index(joint) for joint in record.joints]
    shape = (len(record.effort), len(robot.axes))
    motor = np.zeros((3, *shape))
    motor[0] = record.pose
    motor[:, :, columns] = [_smooth(record, record.position, order) for order in range(3)]
    load = motor.copy()
    for joint, position in record.load_position.items():
        load[:, :, robot.index(joint)] = [_smooth(record, position, order) for order in range(3)]
    for joint, velocity in record.load_velocity.items():
        load[1:, :, robot.index(joint)] = [_smooth(record, velocity, order) for order in range(2)]
    return JointMotion(*load), JointMotion(*motor)


def told_apart(records: Sequence[FreeMotion]) -> frozenset[str]:
    """Joints whose motors swing against their loads, seen by direct encoders: more than 0.5 % of the acceleration, and
    five times what the noise of both encoders, white, makes of it. Only there the rotor is told from its link.
    """
    found: set[str] = set()
    for record in records:
        impulse = np.zeros(len(record.effort))
        impulse[len(impulse) // 2] = 1.0
        gain = np.linalg.norm(low_pass(impulse, record.rate, record.band, 2))
        for joint, load in record.load_position.items():
            motor = record.position[:, record.joints.index(joint)]
            # fourth differences: motion is smooth, and the variance of white noise is 70 times as large in them
            noise = gain * np.median(np.abs(np.diff(motor - load, 4))) / 0.6745 / np.sqrt(70)
            swing, whole = (low_pass(x, record.rate, record.band, 2) for x in (motor - load, motor))
            if np.std(swing) > max(5 * noise, 0.005 * np.std(whole)):
                found.add(joint)
    return frozenset(found)


def all_equations(
    robot: Robot,
    base: BaseParameters,
    records: Sequence[FreeMotion],
    fastest: Mapping[str, float] | None = None,
    carried: Array | None = None,
) -> list[AxisEquations]:
    """Of every axis that moves in one of the records; `fastest` and `carried`: as for `equations`."""
    return [each for k, record in enumerate(records) for each in equations(robot, base, record, k, fastest, carried)]


def equations(
    robot: Robot,
    base: BaseParameters,
    record: FreeMotion,
    number: int,
    fastest: Mapping[str, float] | None = None,
    carried: Array | None = None,
) -> list[AxisEquations]:
    """Equations of every axis that moves in record `number`. `fastest`: highest speed of an axis in all records, rad/s
    (m/s); None: in this one. `carried` (10 n,): parameters of the links on the springs; None: of CAD.
    """
    load, motor = load_and_motor(robot, record)
    rate, band = record.rate, record.band
    coarse = max(1, int(rate / Sampling.link_rate))
    fine = max(1, int(rate / coarse / (2 * band)))
    kept = slice(0, None, coarse * fine)
    time = np.arange(len(load.position))[kept] / rate
    inside = (time > memory(band)) & (time < time[-1] - memory(band))
    columns = np.array(base.columns)
    of_links = columns[columns < 10 * len(robot.axes)]
    links = low_pass(links_along(robot, _part(load, slice(None, None, coarse)))[:, :, of_links], rate / coarse, band)[
        ::fine
    ]
    effort = low_pass(record.effort, rate, band)[kept]
    on_springs = robot.chain.inertial.ravel() if carried is None else carried
    springs = _springs(robot, record, _part(load, slice(None, None, coarse)), rate / coarse, on_springs)[::fine]
    found: list[AxisEquations] = []
    for k, joint in enumerate(record.joints):
        index = robot.index(joint)
        if np.ptp(motor.position[:, index]) < 1e-3:  # rad (m)
            continue
        velocity = motor.velocity[:, index]
        highest = float(np.abs(velocity).max())
        drives = low_pass(drive_along(motor, index), rate, band)[kept]
        rows = np.hstack([links[:, index], drives[:, columns[len(of_links) :] - 10 * len(robot.axes)]])
        found.append(
            AxisEquations(
                joint=joint,
                record=number,
                rows=rows,
                values=effort[:, k],
                ripple=low_pass(cogging(robot, index, motor.position[:, index]), rate, band)[kept],
                lacks=low_pass(_lacks(motor, index, (fastest or {}).get(joint, highest)), rate, band)[kept],
                springs=springs[:, index],
                sound=inside & ~at_rest(velocity, rate, band)[kept],
                time=time,
            )
        )
    return found


def links_along(robot: Robot, load: JointMotion) -> Array:
    """`link_rows` (m, n, 10 n) in pieces, for records of any length."""
    chunk = 4000  # instants whose rows are computed together, to limit memory
    starts = range(0, len(load.position), chunk)
    parts = [link_rows(robot.chain, robot.gravity, _part(load, slice(k, k + chunk))) for k in starts]
    return np.concatenate(parts)


def drive_along(motor: JointMotion, index: int) -> Array:
    """Rows (m, 4 n) of the drives' parameters in the effort of axis `index`; all but its own are zero."""
    count = motor.velocity.shape[1]
    velocity = motor.velocity[:, index]
    own = (motor.acceleration[:, index], velocity, mean_sign(velocity), np.ones_like(velocity))
    rows = np.zeros((len(velocity), 4 * count))
    for part, signal in enumerate(own):
        rows[:, part * count + index] = signal
    return rows


def mean_sign(velocity: Array) -> Array:
    """Mean of sign(v) over the time between two samples, (m,), so that a reversal between samples has its exact
    time.
    """
    change = np.abs(np.gradient(velocity))
    crossing = 2 * np.abs(velocity) < change
    return np.where(crossing, 2 * velocity / np.where(crossing, change, 1.0), np.sign(velocity))


def friction_laws(velocity: Array, reference: float) -> Array:
    """(m, len(`LOW_SPEEDS`)) at `velocity` (m,), 1 or below: friction that falls with the speed."""
    speed = velocity / reference
    return np.stack([mean_sign(velocity) * np.exp(-np.square(speed / width)) for width in Sampling.low_speeds], -1)


def _lacks(motor: JointMotion, index: int, reference: float) -> Array:
    """(m, t), in the order of `LACKS`: friction at low speed; friction that grows with the square of the speed, or with
    it in one direction more than in the other; what a cable, an eccentric wheel or a spring does over the angle.
    """
    speed, angle = motor.velocity[:, index] / reference, np.outer(motor.position[:, index], Sampling.angles)
    low, turns = friction_laws(motor.velocity[:, index], reference), (np.cos(angle), np.sin(angle))
    return np.hstack([low, np.stack([speed * np.abs(speed), np.abs(speed)], -1), *turns])


def _springs(robot: Robot, record: FreeMotion, load: JointMotion, rate: float, links: Array) -> Array:
    """(m, n, n): efforts of all axes by a unit compliance of each gear whose load is not measured, to first order, with
    `links` (10 n,): the load is behind its motor by compliance times torque.
    """
    torque = links_along(robot, load) @ links
    behind = [low_pass(torque, rate, record.band, order) for order in range(3)]
    found = np.zeros((*torque.shape, len(robot.axes)))
    for joint in set(record.joints) - set(record.load_position) - set(record.load_velocity):
        index = robot.index(joint)
        small = 1e-3 / max(float(np.abs(behind[0][:, index]).max()), 1e-9)  # that gives way by 1e-3 rad (m)
        unit = np.eye(len(robot.axes))[index] * small
        moved = (x - y * unit for x, y in zip((load.position, load.velocity, load.acceleration), behind, strict=True))
        found[..., index] = (links_along(robot, JointMotion(*moved)) @ links - torque) / small
    return found


def _part(motion: JointMotion, part: slice) -> JointMotion:
    return JointMotion(motion.position[part], motion.velocity[part], motion.acceleration[part])


def _smooth(record: FreeMotion, position: Array, order: int) -> Array:
    return low_pass(position, record.rate, record.motion_cut, order)


def at_rest(velocity: Array, rate: float, band: float) -> Mask:
    """Where the low-pass covers samples at rest, (m,)."""
    still = np.abs(velocity) < Sampling.creeping * np.abs(velocity).max()
    # of the filter's weight
    return low_pass(still.astype(float), rate, band) > 0.3


def cogging(robot: Robot, index: int, position: Array) -> Array:
    """(m, 2 orders): cosine and sine of the motor angle at every cogging order."""
    axis = robot.axes[index]
    angle = np.outer(position, np.array(axis.cogging_orders) * axis.gear_ratio)
    return np.hstack([np.cos(angle), np.sin(angle)])


def whole_parameters(robot: Robot, base: BaseParameters, values: Array) -> Array:
    """Parameters (14 n,) with the same efforts as base parameters (r,); all that are not in the base are 0."""
    parameters = np.zeros(14 * len(robot.axes))
    parameters[list(base.columns)] = values
    return parameters
