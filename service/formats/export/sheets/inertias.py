"""The inertia about an axis from base parameters, anywhere in the workspace.

With base parameters beta, their covariance C and the rows W of the poses (`service.identification.model`)

    J = W beta,   cov J = W C W^T

Supplementary loads of a KUKA are the difference between estimate and CAD as bodies on the first three links: the
control contains a model of the bare robot, and takes one additional body each on A1, A2 and A3. They are the most
probable ones (`physical_consistency`, second problem), given that difference and, of each link, a nominal body of 1 %
of the robot's mass around the middle of the link. The nominal bodies decide what the estimate leaves open: 400 %
standard deviation, so that ten times the mass costs about one unit of chi-squared.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import chdtrc

from service import BadInput
from service.identification.model import BaseParameters, fold, lock
from service.identification.model.base_parameters import base_parameters
from service.identification.model.physical_consistency import nearest_physical, pseudo_inertia
from service.model import INERTIAL_NAMES, Array, Chain, Robot, inertia_vector, link_frames, transform_inertial
from service.model.results.estimate import Base, BaseParameter, Estimate, StandardParameters
from service.model.results.payload import DETECTED, Payload
from service.model.results.sheet import Sheet, SheetParameter, Supplementary, SupplementaryLoad
from service.model.urdf import LARGEST

UPRIGHT = -90.0  # deg: position of the second axis that defines the frame of its load


@dataclass(frozen=True)
class Inertias:
    """Base parameters (r,) of a robot with their covariance (r, r), from an estimate or a sheet.

    `fixed`: positions, rad (m), of the joints that never moved, by index. `place`: prefix of every message.
    """

    still = 2e-3  # rad (m): smaller differences count as no motion

    robot: Robot
    joints: tuple[str, ...]
    values: Array
    covariance: Array
    opened: tuple[bool, ...]
    fixed: dict[int, float]
    base: BaseParameters
    chain: Chain
    place: str

    def rows(self, joint: str, poses: Array) -> Array:
        """Rows (m, r) of the inertia about `joint` at poses (m, n), rad (m).

        BadInput if the axis was not measured or its inertia is unknown at a pose.
        """
        if joint not in self.joints:
            raise BadInput(self.place, f"did not measure {joint}; it measured {', '.join(self.joints)}")
        for k, position in self.fixed.items():
            if np.abs(poses[:, k] - position).max() > Inertias.still:
                raise BadInput(self.place, f"was measured only with {self.robot.joints[k]} at {position:.4g} rad (m)")
        rows, opened = self._rows(joint, poses)
        if opened:
            raise BadInput(self.place, f"gives no inertia of {joint} in this pose: {opened} is not identified")
        return rows

    def knows(self, joint: str, poses: Array) -> bool:
        """Whether all parameters of the inertia about a measured `joint` at poses (m, n) are identified."""
        return not self._rows(joint, poses)[1]

    def _rows(self, joint: str, poses: Array) -> tuple[Array, str]:
        """Rows (m, r), and the first of their parameters that is not identified, or ""."""
        free = [k for k in range(len(self.robot.joints)) if k not in self.fixed]
        rows = self.base.rows(self.chain, free.index(self.robot.index(joint)), poses[:, free])
        share = np.abs(rows).max(axis=0) > 1e-9 * np.abs(rows).max()  # below, a parameter does not affect the inertia
        left = (name for name, used, opened in zip(self.base.names, share, self.opened, strict=True) if used and opened)
        return rows, next(left, "")


def of_estimate(robot: Robot, estimate: Estimate, place: str) -> Inertias:
    """BadInput if the estimate is of another robot."""
    return _inertias(robot, tuple(estimate.axes), estimate.base_parameters, estimate.base, place)


def of_sheet(robot: Robot, sheet: Sheet, place: str) -> Inertias:
    """BadInput if the sheet is of another robot, or of an old version without covariance."""
    if sheet.base is None:
        raise BadInput(place, "has no covariance of its base parameters: make it again with this version of sweepid")
    joints = tuple(axis.joint for axis in sheet.axes)
    return _inertias(robot, joints, sheet.base_parameters, sheet.base, place)


def _inertias(
    robot: Robot, joints: tuple[str, ...], parameters: Sequence[BaseParameter | SheetParameter], found: Base, place: str
) -> Inertias:
    fixed = {robot.index(name): position for name, position in found.locked.items()}
    free = [k for k in range(len(robot.joints)) if k not in fixed]
    measured = sorted(robot.index(name) for name in joints)
    if not set(measured) <= set(free):
        raise BadInput(f"{place} base.locked", "contains a measured axis")
    chain = lock(robot.chain, fixed)
    base = base_parameters(chain, tuple(free.index(k) for k in measured))
    if tuple(one.name for one in parameters) != base.names:
        raise BadInput(place, f"has other base parameters than robot {robot.name}: its kinematics differ")
    count = len(base.names)
    square = [len(row) for row in found.covariance] == [count] * count  # a file may have rows of any length
    if not square or not np.isfinite(np.array(found.covariance)).all():
        raise BadInput(f"{place} base.covariance", f"must be {count} x {count} finite numbers")
    covariance = np.array(found.covariance, dtype=float).reshape(count, count)
    values = np.array([one.value for one in parameters])
    opened = tuple(one.std is None for one in parameters)
    return Inertias(robot, joints, values, covariance, opened, fixed, base, chain, place)


@dataclass(frozen=True)
class LoadData:
    """A physical body, in the frame of a joint: kg, m, kg m^2; the columns of `axes` (3, 3) are principal axes.

    `tensor` (3, 3) about the centre, along the axes of the frame.
    """

    frame: str
    mass: float
    mass_std: float
    centre: tuple[float, float, float]
    moments: tuple[float, float, float]
    axes: Array
    tensor: Array


def load_of(found: Payload, place: str = "--payload") -> LoadData:
    """BadInput if a value that a control needs is missing, or no body can have these values."""
    figures = {"mass": found.mass, **found.center, **found.inertia}
    open_ = [name for name, part in figures.items() if part.value is None]
    if open_:
        raise BadInput(place, f"lacks {', '.join(open_)}: its motions did not excite them")
    if found.mass.std_total is None:
        raise BadInput(f"{place} mass.std_total", "is missing")
    if found.mass.value is not None and found.mass.std is not None and found.mass.value < DETECTED * found.mass.std:
        told = f"is {found.mass.value:.3g} kg, standard deviation {found.mass.std:.2g} kg: no mass detected"
        raise BadInput(f"{place} mass", told)
    near = found.physical.nearest
    if set(near.inertia) != set(INERTIAL_NAMES[4:]):
        raise BadInput(f"{place} physical.nearest.inertia", f"lacks {', '.join(INERTIAL_NAMES[4:])}")
    for value in (found.mass.std_total, near.mass, *near.center, *near.inertia.values()):
        if not abs(value) <= LARGEST:
            raise BadInput(place, f"has {value}, must be a number of at most {LARGEST:g}")
    of = near.inertia
    tensor = np.array(
        [[of["Ixx"], of["Ixy"], of["Ixz"]], [of["Ixy"], of["Iyy"], of["Iyz"]], [of["Ixz"], of["Iyz"], of["Izz"]]]
    )
    moments, axes = np.linalg.eigh(tensor)
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    if not moments[0] > 0 or moments[2] > moments[0] + moments[1] + 1e-9:
        raise BadInput(place, "has moments of inertia that are not physically possible")
    least, middle, most = moments.tolist()
    return LoadData(found.frame, near.mass, found.mass.std_total, near.center, (least, middle, most), axes, tensor)


def zyx(rotation: Array) -> tuple[float, float, float]:
    """A, B, C of a KUKA, deg: about Z, then the new Y, then the new X."""
    b = math.atan2(-rotation[2, 0], math.hypot(rotation[0, 0], rotation[1, 0]))
    a = math.atan2(rotation[1, 0], rotation[0, 0])
    c = math.atan2(rotation[2, 1], rotation[2, 2])
    return math.degrees(a), math.degrees(b), math.degrees(c)


def supplementary(
    robot: Robot, known: Inertias, standard: StandardParameters, gain: float, upright: float
) -> Supplementary:
    """The loads of A1, A2 and A3, or the reason why there are none.

    `gain`: relative standard deviation of the torque constants, which scale the whole estimate. `upright`: rad,
    position of the second joint in the URDF at which the control displays A2 = -90 deg.
    """
    kinds = [joint.kind for joint in robot.chain.joints[:3]]
    if len(kinds) < 3 or "prismatic" in kinds:
        return Supplementary(loads=(), left_out="the first three joints must be revolute", before=0.0, after=0.0)
    combination = known.base.combination @ fold(robot.chain, known.fixed)
    motors = [
        axis.reflected_motor_inertia or standard.motor_inertias.get(f"Jm({axis.joint})", 0.0) for axis in robot.axes
    ]
    cad = np.concatenate([robot.chain.inertial.ravel(), motors])
    shown = np.array([not opened for opened in known.opened])
    difference = (known.values - combination @ cad)[shown]
    scaled = gain * known.values[shown]
    covariance = known.covariance[np.ix_(shown, shown)] + np.outer(scaled, scaled)
    if not covariance.size or not np.isfinite(covariance).all() or not (np.diag(covariance) > 0).all():
        reason = "the estimate has no base parameters with a standard deviation above 0"
        return Supplementary(loads=(), left_out=reason, before=0.0, after=0.0)
    rows = combination[shown]
    _, before = _bodies(robot.chain, [], rows, difference, covariance)
    if chdtrc(len(difference), before) > 0.0455:  # two standard deviations
        reason = "the estimate does not differ from CAD by more than its uncertainty"
        return Supplementary(loads=(), left_out=reason, before=_per_parameter(before, difference), after=0.0)
    used = [0, 1, 2]
    # each body that explains too little is removed; last A1, which affects one base parameter only
    bodies, after = _bodies(robot.chain, used, rows, difference, covariance)
    for link in (2, 1, 0):
        fewer = [k for k in used if k != link]
        without, left = _bodies(robot.chain, fewer, rows, difference, covariance)
        if left - after < 4.0:  # of chi-squared
            used, bodies, after = fewer, without, left
    loads = tuple(_load(robot, link, bodies[link], upright) for link in used)
    reason = "" if loads else "no body on A1 to A3 reduces the difference from CAD: the robot has less inertia than CAD"
    left = _per_parameter(after, difference)
    if loads and left > 3.0:  # standard deviations, RMS: a motor or a lighter link, for example
        reason = f"no bodies on A1 to A3 explain the difference from CAD: {left:.1f} standard deviations remain"
        loads = ()
    return Supplementary(loads=loads, left_out=reason, before=_per_parameter(before, difference), after=left)


def _bodies(
    chain: Chain, links: list[int], rows: Array, difference: Array, covariance: Array
) -> tuple[dict[int, Array], float]:
    """Parameters (10,) by link of the most probable bodies, and the remaining chi-squared."""
    nominal = np.zeros((len(links), 10))
    nominal[:, 0] = 0.01 * (float(chain.inertial[:, 0].sum()) or 1.0)
    gyration = 0.1 * (float(sum(np.linalg.norm(joint.translation) for joint in chain.joints)) or 1.0)  # m
    ball = inertia_vector(2 * gyration**2 * np.eye(3))
    for body, link in zip(nominal, links, strict=True):
        body[4:] = body[0] * ball
        middle = chain.joints[link + 1].translation / 2 if link + 1 < len(chain.joints) else np.zeros(3)
        body[:] = transform_inertial(body, np.eye(3), middle)
    columns = [rows[:, 10 * link : 10 * link + 10] for link in links]
    motors = np.zeros(len(links))
    found = nearest_physical(
        np.concatenate([nominal.ravel(), motors]),
        (4.0, motors),
        np.hstack([*columns, np.zeros((len(rows), len(links)))]),
        difference,
        covariance,
        exactly=False,
    )
    bodies = found.parameters[: nominal.size].reshape(len(links), 10)
    return dict(zip(links, bodies, strict=True)), found.deviation**2


def _load(robot: Robot, link: int, parameters: Array, upright: float) -> SupplementaryLoad:
    """A body in the frame that the control requires."""
    # FLANGE of the load of A3: Beckhoff TF5120, function block KRC_LDDconfig (M_A3, X_A3 ...). ROBROOT of those of A1
    # and A2, and moments about the centre of mass: KUKA's class CRobot, setLoadA1 to setLoadA3. No public source gives
    # the axis positions at which a frame is fixed to its link: the sheet says that they must be checked.
    frames: tuple[tuple[Literal["A1", "A2", "A3"], str], ...] = (
        ("A1", "ROBROOT (base frame of the URDF) with A1 = 0 deg"),
        ("A2", "ROBROOT (base frame of the URDF) with A1 = 0 deg and A2 = -90 deg"),
        ("A3", "FLANGE (in the URDF: frame of {last}) with A4 = A5 = A6 = 0 deg"),
    )
    pose = np.zeros(len(robot.joints))
    pose[1] = upright if link == 1 else 0.0
    rotations, origins = (part[0] for part in link_frames(robot.chain, pose[None]))
    rotation, translation = rotations[link], origins[link]
    if link == 2:  # in the flange's frame
        rotation = rotations[-1].T @ rotations[link]
        translation = rotations[-1].T @ (origins[link] - origins[-1])
    moved = transform_inertial(parameters, rotation, translation)
    mass = float(moved[0])
    centre = moved[1:4] / mass
    second = pseudo_inertia(moved)[:3, :3] - mass * np.outer(centre, centre)
    values, axes = np.linalg.eigh(second)
    values = np.maximum(values, mass * 0.01**2)  # least radius of gyration, m
    moments = values.sum() - values
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    return SupplementaryLoad(
        axis=frames[link][0],
        link=robot.chain.joints[link].link,
        frame=frames[link][1].format(last=robot.joints[-1]),
        mass=mass,
        centre=(float(centre[0]), float(centre[1]), float(centre[2])),
        orientation=zyx(axes),
        moments=(float(moments[0]), float(moments[1]), float(moments[2])),
    )


def _per_parameter(distance: float, difference: Array) -> float:
    return math.sqrt(distance / len(difference))
