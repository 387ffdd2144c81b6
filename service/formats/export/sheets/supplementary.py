r"""The difference between estimate and CAD as bodies on the first three links: supplementary loads of a KUKA.

The control contains a model of the bare robot, and takes one additional body each on A1, A2 and A3. With x_k the ten
parameters of a body on link k, A their contribution to the base parameters, beta the identified and beta_0 CAD's, C the
covariance:

    min over P_k >= 0:   |C^-1/2 (A x(P) - (beta - beta_0))|^2 + sum_k (m_k + tr(Sigma_k) / R^2) / M

P_k = [Sigma_k, m c; (m c)^T, m] is the pseudo-inertia (`physical_consistency`), so the bodies are physical. M is the
mass and R the length of the robot; their term, at most some standard deviations, determines unobservable parts.
With P_k = L_k L_k^T of full rank, each local minimum is the global one (Burer and Monteiro 2005).
"""

import math
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import chi2

from service.formats.export.sheets.inertias import Inertias
from service.formats.export.sheets.load import zyx
from service.identification.model.least_squares import converged
from service.identification.model.physical_consistency import pseudo_inertia
from service.identification.model.regressor import fold
from service.model.results.estimate import StandardParameters
from service.model.results.sheet import Supplementary, SupplementaryLoad
from service.model.robot import Robot, link_frames
from service.model.urdf import inertia_vector, transform_inertial

Array = NDArray[np.float64]

LINKS = 3  # A1, A2, A3
UPRIGHT = -90.0  # deg: position of the second axis that defines the frame of its load
INSIGNIFICANT = 0.0455  # two standard deviations: a less significant difference from CAD is ignored
WORTH = 4.0  # of chi-squared: a body that explains less is omitted
MISFIT = 3.0  # standard deviations, RMS, largest residual with the bodies
THINNEST = 0.01  # m: least radius of gyration about each axis of a physical body
TOLERANCE = 1e-6  # of the sum of squares: far below one standard deviation
EVALUATIONS = 5000  # at most; usually some hundred
NEGLIGIBLE = 1e-12  # of the largest eigenvalue of the covariance, scaled

_AXES: tuple[Literal["A1", "A2", "A3"], ...] = ("A1", "A2", "A3")
# FLANGE of the load of A3: Beckhoff TF5120, function block KRC_LDDconfig (M_A3, X_A3 ...). ROBROOT of those of A1 and
# A2, and moments about the centre of mass: KUKA's class CRobot, setLoadA1 to setLoadA3. No public source gives the axis
# positions at which a frame is fixed to its link: the sheet says that they must be checked.
_FRAMES = (
    "ROBROOT (base frame of the URDF) with A1 = 0 deg",
    "ROBROOT (base frame of the URDF) with A1 = 0 deg and A2 = -90 deg",
    "FLANGE (in the URDF: frame of {last}) with A4 = A5 = A6 = 0 deg",
)


def supplementary(
    robot: Robot, known: Inertias, standard: StandardParameters, gain: float, upright: float
) -> Supplementary:
    """The loads of A1, A2 and A3, or the reason why there are none.

    `gain`: relative standard deviation of the torque constants, which scale the whole estimate. `upright`: rad,
    position of the second joint in the URDF at which the control displays A2 = -90 deg.
    """
    kinds = [joint.kind for joint in robot.chain.joints[:LINKS]]
    if len(kinds) < LINKS or "prismatic" in kinds:
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
    white = _whitening(covariance)
    before = float(np.sum((white @ difference) ** 2))
    if chi2.sf(before, len(difference)) > INSIGNIFICANT:
        reason = "the estimate does not differ from CAD by more than its uncertainty"
        return Supplementary(loads=(), left_out=reason, before=_per_parameter(before, difference), after=0.0)
    parts = white @ combination[shown][:, : 10 * LINKS]
    size = _Size(float(robot.chain.inertial[:, 0].sum()) or 1.0, _reach(robot))
    used = list(range(LINKS))
    # each body that explains too little is removed
    bodies, after = _fit(parts, white @ difference, used, size)
    for link in range(LINKS):
        fewer = [k for k in used if k != link]
        without, left = _fit(parts, white @ difference, fewer, size)
        if left - after < WORTH:
            used, bodies, after = fewer, without, left
    loads = tuple(_load(robot, link, bodies[link], upright) for link in used)
    reason = "" if loads else "no body on A1 to A3 reduces the difference from CAD: the robot has less inertia than CAD"
    left = _per_parameter(after, difference)
    if loads and left > MISFIT:  # a motor or a lighter link, for example
        loads, reason = (
            (),
            f"no bodies on A1 to A3 explain the difference from CAD: {left:.1f} standard deviations remain",
        )
    return Supplementary(loads=loads, left_out=reason, before=_per_parameter(before, difference), after=left)


class _Size:
    """Units for parameters of a body of the order of one: mass, kg, and length, m."""

    def __init__(self, mass: float, length: float) -> None:
        self.mass = mass
        self.scale = np.array([length, length, length, 1.0])


def _fit(parts: Array, wanted: Array, links: list[int], size: _Size) -> tuple[dict[int, Array], float]:
    """Bodies (10,) by link that best explain the whitened difference, and the remaining chi-squared."""
    if not links:
        return {}, float(wanted @ wanted)
    lower = np.tril_indices(4)

    def bodies(unknowns: Array) -> Array:
        factors = np.zeros((len(links), 4, 4))
        factors[:, lower[0], lower[1]] = unknowns.reshape(len(links), 10)
        factors = size.scale[:, None] * factors * math.sqrt(size.mass)
        return np.array([_parameters(factor @ factor.T) for factor in factors])

    columns = np.hstack([parts[:, 10 * link : 10 * link + 10] for link in links])

    def misfit(unknowns: Array) -> Array:
        return columns @ bodies(unknowns).ravel() - wanted

    start = np.tile(0.1 * np.eye(4)[lower], len(links))
    found = least_squares(lambda x: np.concatenate([misfit(x), x]), start, ftol=TOLERANCE, max_nfev=EVALUATIONS)
    converged(found, "supplementary loads", "bodies on A1 to A3")
    result = bodies(found.x)
    return dict(zip(links, result, strict=True)), float(np.sum(misfit(found.x) ** 2))


def _load(robot: Robot, link: int, parameters: Array, upright: float) -> SupplementaryLoad:
    """A body in the frame that the control requires."""
    pose = np.zeros(len(robot.joints))
    pose[1] = upright if link == 1 else 0.0
    rotations, origins = (part[0] for part in link_frames(robot.chain, pose[None]))
    rotation, translation = rotations[link], origins[link]
    if link == LINKS - 1:  # in the flange's frame
        rotation = rotations[-1].T @ rotations[link]
        translation = rotations[-1].T @ (origins[link] - origins[-1])
    moved = transform_inertial(parameters, rotation, translation)
    mass = float(moved[0])
    centre = moved[1:4] / mass
    second = pseudo_inertia(moved)[:3, :3] - mass * np.outer(centre, centre)
    values, axes = np.linalg.eigh(second)
    values = np.maximum(values, mass * THINNEST**2)
    moments = values.sum() - values
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    return SupplementaryLoad(
        axis=_AXES[link],
        link=robot.chain.joints[link].link,
        frame=_FRAMES[link].format(last=robot.joints[-1]),
        mass=mass,
        centre=(float(centre[0]), float(centre[1]), float(centre[2])),
        orientation=zyx(axes),
        moments=(float(moments[0]), float(moments[1]), float(moments[2])),
    )


def _parameters(pseudo: Array) -> Array:
    """(10,) of a pseudo-inertia (4, 4)."""
    second = pseudo[:3, :3]
    tensor = np.trace(second) * np.eye(3) - second
    return np.concatenate([[pseudo[3, 3]], pseudo[:3, 3], inertia_vector(tensor)])


def _whitening(covariance: Array) -> Array:
    scale = np.sqrt(np.diag(covariance))
    moments, directions = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray((directions / np.sqrt(np.maximum(moments, NEGLIGIBLE * moments[-1]))).T / scale, dtype=float)


def _per_parameter(distance: float, difference: Array) -> float:
    return math.sqrt(distance / len(difference))


def _reach(robot: Robot) -> float:
    """Sum of the distances between the joints, m."""
    return float(sum(np.linalg.norm(joint.translation) for joint in robot.chain.joints)) or 1.0
