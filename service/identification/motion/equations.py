r"""The equations of a free motion: at every instant and for every axis that moves,

    L[effort] = sum_j x_j L[regressor_j] + L[ripple] + noise                                 (`inverse_dynamics`)

with the same low-pass L for both sides (`free_motion`), which therefore causes no bias, decimated according to its
cut-off. Regressors are computed from the smoothed motion at the full rate: links from the load's if a direct encoder
measures it, drives from the motor's. An axis at rest gives no equation: dry friction balances any torque by the others'
motion. Cogging of the known orders is eliminated by a cosine and a sine each, before `least_squares`.

One axis at a time along a motion of all axes: the effort of the rigid robot, split as for a sweep of one axis.

    effort_k = J_k(t) a_k + gravity_k(t) + coupling_k(t) + friction + other torques on the axis

    J_k = M_kk(q) + Jm_k,    gravity_k = g_k(q),    coupling_k = sum_(j != k) M_kj a_j + (C(q, v) v)_k

so that methods for a single axis (a diagnosis, a fit of its friction) can use  effort - coupling.  a_k is the
motor's: if a direct encoder measures how the load differs from it, M_kk times the difference is in the coupling.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.model.base_parameters import BaseParameters
from service.identification.model.inverse_dynamics import Motion, link_rows
from service.identification.model.regressor import inertia_rows
from service.identification.motion.free_motion import FreeMotion, low_pass, memory
from service.model.robot import Robot

Array = NDArray[np.float64]

STILL = 0.01  # of the largest velocity: below, an axis counts as at rest
LINK_RATE = 200.0  # Hz, at which the links' rows are computed: products of a few smoothed motions
LOW_SPEEDS = (0.05, 0.1, 0.2)  # of the largest velocity: where friction at low speed has fallen to 37 %
ANGLES = (1.0, 2.0, 3.0)  # periods per revolution (per 2 pi m)
OF_SPEED, OF_ANGLE = "friction of the speed", "a torque of the angle"
LACKS = (*[OF_SPEED for _ in LOW_SPEEDS], OF_SPEED, OF_SPEED, *[OF_ANGLE for _ in (*ANGLES, *ANGLES)])
CHUNK = 4000  # instants whose rows are computed together, to limit memory


@dataclass(frozen=True)
class AxisEquations:
    """Rows (m, r) and values (m,) of one axis along one record, N m (N), every `step` seconds; `sound` (m,): equations
    that are used. `ripple` (m, 2 orders): columns eliminated by least squares. `lacks` (m, t): what the model of the
    axis may lack, `friction_laws` first.
    """

    joint: str
    record: int
    rows: Array
    values: Array
    ripple: Array
    lacks: Array
    sound: NDArray[np.bool_]
    time: Array  # (m,) s since the record's start


def load_and_motor(robot: Robot, record: FreeMotion) -> tuple[Motion, Motion]:
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
    return Motion(*load), Motion(*motor)


def all_equations(
    robot: Robot, base: BaseParameters, records: Sequence[FreeMotion], fastest: Mapping[str, float] | None = None
) -> list[AxisEquations]:
    """Of every axis that moves in one of the records; `fastest`: as for `equations`."""
    return [each for number, record in enumerate(records) for each in equations(robot, base, record, number, fastest)]


def equations(
    robot: Robot, base: BaseParameters, record: FreeMotion, number: int, fastest: Mapping[str, float] | None = None
) -> list[AxisEquations]:
    """Equations of every axis that moves in record `number`. `fastest`: highest speed of an axis in all records, rad/s
    (m/s); None: in this one.
    """
    load, motor = load_and_motor(robot, record)
    rate, band = record.rate, record.band
    coarse = max(1, int(rate / LINK_RATE))
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
                ripple=low_pass(_ripple(robot, index, motor.position[:, index]), rate, band)[kept],
                lacks=low_pass(_lacks(motor, index, (fastest or {}).get(joint, highest)), rate, band)[kept],
                sound=inside & ~_at_rest(velocity, rate, band)[kept],
                time=time,
            )
        )
    return found


def links_along(robot: Robot, load: Motion) -> Array:
    """`link_rows` (m, n, 10 n) in pieces, for records of any length."""
    starts = range(0, len(load.position), CHUNK)
    parts = [link_rows(robot.chain, robot.gravity, _part(load, slice(k, k + CHUNK))) for k in starts]
    return np.concatenate(parts)


def drive_along(motor: Motion, index: int) -> Array:
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
    return np.stack([mean_sign(velocity) * np.exp(-np.square(speed / width)) for width in LOW_SPEEDS], -1)


def _lacks(motor: Motion, index: int, reference: float) -> Array:
    """(m, t), in the order of `LACKS`: friction at low speed; friction that grows with the square of the speed, or with
    it in one direction more than in the other; what a cable, an eccentric wheel or a spring does over the angle.
    """
    speed, angle = motor.velocity[:, index] / reference, np.outer(motor.position[:, index], ANGLES)
    low, turns = friction_laws(motor.velocity[:, index], reference), (np.cos(angle), np.sin(angle))
    return np.hstack([low, np.stack([speed * np.abs(speed), np.abs(speed)], -1), *turns])


def _part(motion: Motion, part: slice) -> Motion:
    return Motion(motion.position[part], motion.velocity[part], motion.acceleration[part])


def _smooth(record: FreeMotion, position: Array, order: int) -> Array:
    return low_pass(position, record.rate, record.motion_cut, order)


def _at_rest(velocity: Array, rate: float, band: float) -> NDArray[np.bool_]:
    """Where the low-pass covers samples at rest, (m,)."""
    still = np.abs(velocity) < STILL * np.abs(velocity).max()
    # of the filter's weight
    return low_pass(still.astype(float), rate, band) > 0.1


def _ripple(robot: Robot, index: int, position: Array) -> Array:
    """(m, 2 orders): cosine and sine of the motor angle at every cogging order."""
    axis = robot.axes[index]
    angle = np.outer(position, np.array(axis.cogging_orders) * axis.gear_ratio)
    return np.hstack([np.cos(angle), np.sin(angle)])


@dataclass(frozen=True)
class AlongAxis:
    """One axis along a record, all (m,) at the record's samples, SI on the joint side.

    `velocity`, `acceleration` of the motor, smoothed; `inertia` including the motor; `gravity` and `coupling` N m
    (N). `sound`: False near the ends of the record, where the acceleration is unknown unless the axis rested.
    """

    joint: str
    velocity: Array
    acceleration: Array
    inertia: Array
    gravity: Array
    coupling: Array
    sound: NDArray[np.bool_]

    @property
    def rigid(self) -> Array:
        """Effort of links and motor, (m,) N m (N)."""
        return self.inertia * self.acceleration + self.gravity + self.coupling


def whole_parameters(robot: Robot, base: BaseParameters, values: Array) -> Array:
    """Parameters (14 n,) with the same efforts as base parameters (r,); all that are not in the base are 0."""
    parameters = np.zeros(14 * len(robot.axes))
    parameters[list(base.columns)] = values
    return parameters


def rigid_along(robot: Robot, parameters: Array, records: Sequence[FreeMotion]) -> tuple[Mapping[str, AlongAxis], ...]:
    """For every record, by joint. `parameters` (14 n,) as in `inverse_dynamics`; friction is not included."""
    return tuple(_along(robot, parameters, record) for record in records)


def _along(robot: Robot, parameters: Array, record: FreeMotion) -> dict[str, AlongAxis]:
    count = len(robot.axes)
    links, motors = parameters[: 10 * count], parameters[10 * count : 11 * count]
    load, motor = load_and_motor(robot, record)
    samples = len(load.position)
    efforts, gravity = np.zeros((2, samples, count))
    for first in range(0, samples, CHUNK):
        part = slice(first, first + CHUNK)
        there = load.position[part]
        moved = Motion(there, load.velocity[part], load.acceleration[part])
        efforts[part] = link_rows(robot.chain, robot.gravity, moved) @ links
        gravity[part] = link_rows(robot.chain, robot.gravity, Motion(there, 0 * there, 0 * there)) @ links
    time = np.arange(samples) / record.rate
    sound = (time > memory(record.motion_cut)) & (time < time[-1] - memory(record.motion_cut))
    found: dict[str, AlongAxis] = {}
    for joint in record.joints:
        k = robot.index(joint)
        own = inertia_rows(robot.chain, k, load.position) @ links
        found[joint] = AlongAxis(
            joint=joint,
            velocity=motor.velocity[:, k],
            acceleration=motor.acceleration[:, k],
            inertia=own + motors[k],
            gravity=gravity[:, k],
            coupling=efforts[:, k] - gravity[:, k] - own * motor.acceleration[:, k],
            sound=sound,
        )
    return found
