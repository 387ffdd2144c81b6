r"""What robots of a type that were measured tell of the next one, before it is measured.

The base parameters of robot i of a type scatter about those of the type; their estimate has its own error:

    beta_i ~ N(mu, S),    y_i = beta_i + e_i,    e_i ~ N(0, C_i),    S = sum_l tau_l^2 K_l

K_l is the covariance that the robot file's own uncertainty of link l and its motor gives the base parameters: nine
robots do not show a whole S, but how much of that each link really scatters. The tau are those of greatest restricted
likelihood (Patterson and Thompson 1971), in which mu is eliminated:

    -2 log L = sum_i ( log|V_i| + r_i' V_i^-1 r_i ) + log|sum_i V_i^-1|,    V_i = S + C_i,    r_i = y_i - mu

The next robot then is N(mu, S + cov mu), with the covariance enlarged as Student's distribution of so few robots asks.
Friction, drive train and torque constant change from robot to robot and day by day: nothing of them is shared.

Every robot is compared with the type by all others (leave one out). The one that fits least is no robot of this type if
its distance is beyond chance; then the others are compared without it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.special import fdtrc

from service import BadInput
from service.identification.axis.nominal_priors import link_spread
from service.identification.model import SAME_POSITION, Information, jackknife_factor, lock
from service.identification.model.base_parameters import base_parameters
from service.model import Array, Robot
from service.model.results.estimate import Estimate, TypeMember, TypePrior

LEAST_ROBOTS = 4  # each is compared with the others, of which mean and common change take two
WORTH = 2.0  # robots that count as much as the scatter by links
CHANCE = 0.01  # probability that any of correct robots is called a stranger


@dataclass(frozen=True)
class RobotType:
    """The next robot of a type: base parameters (r,) with their covariance (r, r), by `names`.

    `locked`: positions of the joints that never moved, rad (m). `freedom`: degrees of freedom of the covariance.
    `members`: the robots, in the order given.
    """

    names: tuple[str, ...]
    locked: Mapping[str, float]
    mean: Array
    covariance: Array
    freedom: float
    members: tuple[TypeMember, ...]

    @property
    def information(self) -> Information:
        """What they tell, as a measurement of the base parameters."""
        inverse = np.asarray(np.linalg.inv(self.covariance), dtype=np.float64)
        return Information(inverse, inverse @ self.mean)

    def check(self, names: Sequence[str], locked: Mapping[str, float]) -> None:
        """BadInput unless these are its base parameters."""
        if tuple(names) != self.names or not _close(locked, self.locked):
            raise BadInput(
                "prior",
                f"the earlier robots have the base parameters {', '.join(self.names)}{_at(self.locked)}, this one "
                f"{', '.join(names)}{_at(locked)}: measure the same axes with the other joints in the same positions",
            )

    def compared(self, rows: Array, values: Array, covariance: Array) -> TypePrior:
        """Whether a robot with these inertias (n,) is of the type; rows (n, r), own covariance (n, n) of the values."""
        error, spread = values - rows @ self.mean, covariance + rows @ self.covariance @ rows.T
        probability = _by_chance(error, spread, self.freedom)
        return TypePrior(members=self.members, probability=probability, used=probability > CHANCE)


def robot_type(robot: Robot, estimates: Mapping[str, Estimate]) -> RobotType:
    """The type of measured robots with one robot file, by name. BadInput if they are fewer than four, if one lacks a
    base parameter or has others than the first, or if fewer than four belong together.
    """
    if len(estimates) < LEAST_ROBOTS:
        raise BadInput("prior", f"{len(estimates)} earlier robots; the scatter of a type needs {LEAST_ROBOTS} or more")
    first = next(iter(estimates.values()))
    names, locked = tuple(one.name for one in first.base_parameters), first.base.locked
    for name, one in estimates.items():
        _check(name, one, names, locked)
    values = np.array([[one.value for one in estimate.base_parameters] for estimate in estimates.values()])
    own = np.array([estimate.base.covariance for estimate in estimates.values()])
    shapes = _shapes(robot, tuple(first.axes), names, locked)
    scale = np.sqrt(np.diagonal(shapes.sum(axis=0)))
    values, own, shapes = values / scale, own / np.outer(scale, scale), shapes / np.outer(scale, scale)
    belongs = np.ones(len(values), dtype=bool)
    # values by which each size of the scatter is known: those of links and motors, and the common change
    freedom = (len(values) - 1) * len(names) / (len(shapes) + 1)
    probability = np.ones(len(values))
    common = np.zeros_like(values)  # change of the others, without each
    while True:
        for k in range(len(values)):
            others = belongs & (np.arange(len(values)) != k)
            mean, covariance, common[k] = _next_robot(values[others], own[others], shapes)
            probability[k] = _by_chance(values[k] - mean, covariance + own[k], freedom)
        worst = int(np.argmin(np.where(belongs, probability, 1.0)))
        if probability[worst] > CHANCE / len(values):
            break
        belongs[worst] = False
        if belongs.sum() < LEAST_ROBOTS:
            raise BadInput(
                "prior", f"of {len(values)} earlier robots fewer than {LEAST_ROBOTS} are alike: none is a type"
            )
    mean, covariance, of_all = _next_robot(values[belongs], own[belongs], shapes)
    turned = common[belongs] * np.sign(common[belongs] @ of_all)[:, None] - of_all
    covariance = covariance + (1 - 1 / len(turned)) * turned.T @ turned  # jackknife of the common change
    members = tuple(
        TypeMember(name=name, probability=float(chance), belongs=bool(own))
        for name, chance, own in zip(estimates, probability, belongs, strict=True)
    )
    return RobotType(names, locked, mean * scale, covariance * np.outer(scale, scale), freedom, members)


def _by_chance(error: Array, covariance: Array, freedom: float) -> float:
    """Probability of an error (n,) at least as large, with a covariance of so many degrees of freedom (Fisher)."""
    distance = float(error @ np.linalg.solve(covariance, error))
    return float(fdtrc(len(error), freedom, distance / len(error)))


def _next_robot(values: Array, own: Array, shapes: Array) -> tuple[Array, Array, Array]:
    """Mean (r,) and covariance (r, r) of a further robot, and the common change v (r,), from values (n, r) with their
    covariances (n, r, r).
    """

    def scatter(values: Array) -> Array:
        common = values[len(shapes) :]
        return np.tensordot(np.exp(2 * values[: len(shapes)]), shapes, 1) + np.outer(common, common)

    def cost(parameters: Array) -> tuple[float, Array]:
        """-2 log L, and its gradient by that in S:  sum_i ( V_i^-1 - V_i^-1 (r_i r_i' + cov mu) V_i^-1 )."""
        mean, about, inverse = _mean(scatter(parameters), values, own)
        apart = inverse @ (values - mean)[..., None]
        squares = float(np.sum((values - mean)[..., None] * apart))
        in_scatter = (inverse - apart @ apart.swapaxes(1, 2) - inverse @ about @ inverse).sum(axis=0)
        in_links = 2 * np.exp(2 * parameters[: len(shapes)]) * np.tensordot(shapes, in_scatter, 2)
        gradient = np.concatenate([in_links, 2 * in_scatter @ parameters[len(shapes) :]])
        volume = float(np.linalg.slogdet(inverse)[1].sum() + np.linalg.slogdet(about)[1])
        return squares - volume, np.asarray(gradient, dtype=np.float64)

    # from a thousandth of the robot file's own uncertainty to ten times it
    left = values - values.mean(axis=0)
    size, directions = np.linalg.eigh(left.T @ left / len(left))
    start = np.concatenate([np.full(len(shapes), np.log(0.03)), directions[:, -1] * np.sqrt(size[-1])])
    bounds = [(np.log(1e-3), np.log(10.0))] * len(shapes) + [(None, None)] * len(size)
    found = minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds)
    parameters = np.asarray(found.x, dtype=float)
    spread = scatter(parameters)
    mean, about, _ = _mean(spread, values, own)
    # Student: mean and common change take two of so few robots
    return mean, (spread + about) * jackknife_factor(len(values) - 1) ** 2, parameters[len(shapes) :]


def _mean(scatter: Array, values: Array, own: Array) -> tuple[Array, Array, Array]:
    """Mean (r,) of the type with its covariance, and the inverse covariances (n, r, r) of the values."""
    inverse = np.asarray(np.linalg.inv(scatter + own), dtype=float)
    about = np.asarray(np.linalg.inv(inverse.sum(axis=0)), dtype=float)
    return about @ (inverse @ values[..., None]).sum(axis=0)[:, 0], about, inverse


def _shapes(robot: Robot, axes: Sequence[str], names: tuple[str, ...], locked: Mapping[str, float]) -> Array:
    """Covariance (l, r, r) of the base parameters by the robot file's uncertainty of each link, and of each motor.

    BadInput if its base parameters are not these.
    """
    chain = lock(robot.chain, {robot.index(joint): position for joint, position in locked.items()})
    unlocked = [k for k, joint in enumerate(robot.joints) if joint not in locked]
    base = base_parameters(chain, tuple(sorted(unlocked.index(robot.index(joint)) for joint in axes)))
    if base.names != names:
        raise BadInput(
            "prior",
            f"the earlier robots have the base parameters {', '.join(names)}, this robot file {', '.join(base.names)}: "
            "take the robot file that they were identified with",
        )
    count = len(unlocked)
    links = link_spread(chain.inertial, robot.prior.inertia)
    # an unknown motor is as uncertain as its link
    of_link = links.reshape(count, 10)[:, 4:].max(axis=1)
    motors = [(robot.axes[k].reflected_motor_inertia or 0.0) * robot.prior.motor_inertia for k in unlocked]
    spread = np.concatenate([links, [own or other for own, other in zip(motors, of_link, strict=True)]])
    parts = [np.arange(10 * k, 10 * k + 10) for k in range(count)] + [np.array([10 * count + k]) for k in range(count)]
    columns = [base.combination[:, part] * spread[part] for part in parts]
    return np.array([own @ own.T for own in columns if np.abs(own).max() > 0])


def _check(name: str, estimate: Estimate, names: tuple[str, ...], locked: Mapping[str, float]) -> None:
    """BadInput unless an estimate has all these base parameters, determined."""
    found = tuple(one.name for one in estimate.base_parameters)
    if not found or found != names or not _close(estimate.base.locked, locked):
        raise BadInput(
            name,
            f"its base parameters {', '.join(found) or '(none)'}{_at(estimate.base.locked)} are not those of the first "
            f"robot, {', '.join(names)}{_at(locked)}: take campaigns of the same axes, varied joints and robot file",
        )
    unknown = [one.name for one in estimate.base_parameters if one.std is None]
    if unknown:
        raise BadInput(name, f"does not determine {', '.join(unknown)}: take a campaign with more poses")


def _close(one: Mapping[str, float], other: Mapping[str, float]) -> bool:
    return one.keys() == other.keys() and all(abs(one[joint] - other[joint]) < SAME_POSITION for joint in one)


def _at(locked: Mapping[str, float]) -> str:
    return f" (with {', '.join(f'{joint} at {position:.4g}' for joint, position in locked.items())})" if locked else ""
