"""Effects between motor and load: elasticity, backlash, transmission error, cogging."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.diagnosis.effects.effect import (
    CatalogueEffect,
    Model,
    Patch,
    Shape,
    ShapeParameter,
    named,
    positive,
    ripples,
    spread,
)
from service.diagnosis.rows.signals import Complex, Tracks, back, spectrum, through
from service.model import Array, Indices

RATIO = (0.8, 1.25)  # limits, relative to the value for two masses


@dataclass(frozen=True)
class _TwoMasses:
    """Two masses. Z: impedance of the load, with gravity as a spring. Ts: transfer of load torque to motor torque.

        Ts (1 + c Z / (1 + h s)) = J a + b v + gravity,    Z = J s^2 + b s + k_g

    `twist` (n, t) is computed from the measured torque. The nonlinear part must not depend on a predicted torque, which
    would require a correct model of each resonance.
    """

    impedance: Complex  # (n, bins)
    follows: Complex
    load_inertia: Array  # (n, 1)
    viscous: float
    linear_twist: Array
    twist: Array


def _elastic_two_masses(tracks: Tracks, model: Model, shape: Shape) -> _TwoMasses:
    compliance, damping, on_load, hardening, motor = shape
    s = tracks.laplace
    # 0.1 of the axis' inertia
    load_inertia = np.maximum(model.inertia - motor, 0.1 * model.inertia)[:, None]
    viscous = on_load * model.viscous
    spring = np.asarray(1 / (1 + s * damping), dtype=np.complex128)
    impedance = ((s * s).real * load_inertia + model.slope[:, None]) + s * viscous
    on_motor = model.viscous - viscous

    def transmitted() -> Array:
        known = tracks.spectra
        through_gear = known["effort"] + spectrum(-model.beside, tracks.rate)
        through_gear += known["acceleration"] * -motor + known["velocity"] * -on_motor
        return (through_gear * spring).signal(tracks.velocity.shape[1])

    torque = tracks.remember((damping, motor, on_motor, model.key), transmitted)
    linear = twist = compliance * torque
    if hardening > 0:
        rated = tracks.robot.axis(tracks.joint).rated_effort

        def damped() -> Array:
            """The damping also acts on the smaller twist."""
            stiffer = torque - rated * softened(torque / rated, hardening)
            return torque + damping * through(stiffer, tracks.rate, s * spring)

        more = tracks.remember((damping, motor, on_motor, model.key, hardening), damped)
        twist = compliance * rated * softened(more / rated, hardening)
    return _TwoMasses(impedance, 1 / (1 + compliance * spring * impedance), load_inertia, viscous, linear, twist)


def _elastic_columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    two = _elastic_two_masses(tracks, model, shape)
    weight = model.gravity
    if not tracks.prismatic:
        away = tracks.away - two.twist
        weight = model.torque[:, None] * np.cos(away) + model.slope[:, None] * np.sin(away)
        weight = weight + model.slope[:, None] * two.twist  # the gravity stiffness is in the impedance
        weight = weight + tracks.robot.counterbalance_effort(
            tracks.robot.index(tracks.joint), tracks.position - two.twist
        )
    moved = tracks.spectra["velocity"] * two.viscous + spectrum(weight, tracks.rate)
    if shape[3] > 0:
        moved += spectrum(two.linear_twist - two.twist, tracks.rate) * two.impedance
    moved *= two.follows
    shaken = replace(moved, away=moved.away + two.load_inertia * tracks.turned_over * (two.follows - 1))
    return [shaken.signal(tracks.velocity.shape[1]) - model.gravity - two.viscous * tracks.velocity]


def _elastic_parts(tracks: Tracks, model: Model, shape: Shape) -> Array:
    two, count = _elastic_two_masses(tracks, model, shape), tracks.velocity.shape[1]
    s = tracks.laplace
    twisted = spectrum(two.twist, tracks.rate).away * (s * s)  # of zero at frequency 0
    shaken = back(count, (tracks.turned_over - twisted) * two.follows)
    if tracks.prismatic:
        return np.stack([shaken, *tracks.parts[1:]])
    away = tracks.away - two.twist
    pulled = [through(part, tracks.rate, two.follows) for part in (np.cos(away), np.sin(away))]
    return np.stack([shaken, *pulled])


def softened(torque: Array, hardening: float) -> Array:
    """Twist u that solves u + e u^3 = torque; units: rated effort, and the linear twist at rated effort."""
    scale = np.sqrt(3 * hardening)
    return np.asarray(2 / scale * np.sinh(np.arcsinh(1.5 * scale * torque) / 3), dtype=np.float64)


def _elastic_motors(tracks: Tracks, model: Model) -> tuple[float, float, float]:
    """Reflected inertia of the motor, kg m^2 (kg): value of the data sheet, lower and upper limit from its prior."""
    axis = tracks.robot.axis(tracks.joint)
    sheet = axis.reflected_motor_inertia
    if not sheet:
        # 0.02 of the axis' inertia, for a motor that the robot file does not contain
        return model.motor_inertia, 0.02 * float(model.inertia.min()), float(model.inertia.min()) / 2
    # 3.0 standard deviations of the prior: limit of the difference between motor inertia and data sheet
    reach = 3.0 * tracks.robot.prior.motor_inertia
    return sheet, sheet * max(1 - reach, 0.1), sheet * (1 + reach)


def _elastic_shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    heaviest = float(model.load_inertia.max())
    locked = np.array([60.0, 40.0, 28.0, 22.0, 18.0, 15.0, 12.5, 10.5, 9.0, 7.5, 6.0, 5.0, 4.0, 3.2])
    grid = 1 / (heaviest * (2 * np.pi * locked) ** 2)
    motor, lightest, largest = _elastic_motors(tracks, model)
    # 20.0 ratio: added stiffness at the twist of the rated effort over the linear stiffness
    return (
        ShapeParameter("compliance", "rad/(N m)", tuple(grid.tolist()), grid[0] / 4, grid[-1] * 2),
        ShapeParameter("damping_time", "s", (5e-4, 2e-3), 1e-5, 1e-2),
        ShapeParameter("load_friction_share", "", (0.5,), 0.0, 1.0),
        ShapeParameter("hardening", "", (0.0,), 0.0, 20.0),
        ShapeParameter("motor_inertia", "kg m^2", (motor,), lightest, largest),
    )


def _elastic_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    stiffness = 1 / positive(parameters, "compliance")
    axis = tracks.robot.axis(tracks.joint)
    heavier = parameters["motor_inertia"] / axis.gear_ratio**2 - (axis.motor_inertia or 0.0)
    on_load = parameters["load_friction_share"] * model.viscous
    friction = {"viscous": -on_load, "backward_viscous": -on_load}
    spring = {"stiffness": stiffness, "damping": stiffness * parameters["damping_time"]}
    if parameters["hardening"]:
        spring["hardening"] = parameters["hardening"] * stiffness**3 / axis.rated_effort**2
    return {
        "train": {
            "spring": spring,
            "motor_inertia": heavier if axis.motor_inertia else 0.0,
            "motor_friction": friction,
            "load_friction": {"viscous": on_load},
        }
    }


JOINT_ELASTICITY = CatalogueEffect(
    name="joint_elasticity",
    physics="tau = Jm a + J_l a_l, the load behind a spring 1/c with damping h/c; x + e x^3 / (c T0)^2 = c Ts",
    source="Spong, J. Dyn. Sys. Meas. Control 109 (1987); the two-mass form of `axis_inertia`; e: hardening, "
    "T0: rated effort",
    sentence="The gear twists: the load lags behind the motor and swings.",
    visible_in=("wide",),
    entry="spring",
    coefficients=named(("ratio", "")),
    columns=_elastic_columns,
    on_load=(True,),
    parts=_elastic_parts,
    of_model=True,
    scenario=_elastic_scenario,
    shape=_elastic_shape,
    possible=lambda parameters, tracks, model: RATIO[0] <= parameters["ratio"] <= RATIO[1],
)


def _backlash_columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    return _backlash_scan(tracks, model, [shape])[0]


def _backlash_scan(tracks: Tracks, model: Model, shapes: Sequence[Shape]) -> Sequence[Sequence[Array]]:
    """Difference of the motor torque with and without backlash, in sweeps where the contact flank may change."""
    result: Array = np.zeros((len(shapes), *tracks.position.shape))
    shaken = np.abs(model.load_inertia * tracks.acceleration).max(axis=1)
    # 2.0 times the largest inertia torque: with more gravity, the contact flank never changes
    rows = np.flatnonzero(np.abs(model.gravity).min(axis=1) < 2.0 * shaken)
    if rows.size:
        plays, shares = np.array(shapes).T
        result[:, rows] = missing(
            tracks, model.gravity, rows, model.load_inertia[rows, 0], model.viscous * shares, plays
        )
    return [[result[k]] for k in range(len(shapes))]


def missing(tracks: Tracks, gravity: Array, rows: Indices, inertia: Array, viscous: Array, plays: Array) -> Array:
    """Torque difference (plays, rows, t) for backlash `plays` (rad): no load torque between the flanks, and impacts.

    In the frame of the motor: r is the motor angle minus the load angle; r'' = a + (gravity + b v_l) / J while |r|
    is less than half the play. At a flank the load takes the speed of the motor within one time step.
    """
    step, half, damping = 1 / tracks.rate, plays[:, None] / 2, viscous[:, None] / inertia
    # midpoints between samples, because the load moves from one sample to the next
    velocity = _backlash_between(tracks.velocity[rows])
    coasting = _backlash_between(tracks.acceleration[rows]) + _backlash_between(gravity[rows]) / inertia
    ahead = np.sign(gravity[rows, 0]) * half
    rate = np.zeros_like(ahead)
    lost = np.zeros((len(velocity) + 2, *ahead.shape))
    for n in range(len(velocity)):
        taken = step * (coasting[n] + damping * velocity[n])
        free = rate + taken - step * damping * rate
        moved = ahead + step / 2 * (rate + free)
        ahead = np.minimum(np.maximum(moved, -half), half)
        rate = np.where(moved == ahead, free, 0.0)
        lost[n + 1] = free - rate - taken
    return np.moveaxis((lost[1:] + lost[:-1]) / 2 * (inertia / step), 0, -1)


def _backlash_between(signal: Array) -> Array:
    """Mean of each two neighbouring samples of (rows, t): (t - 1, rows)."""
    return np.ascontiguousarray((signal[:, 1:] + signal[:, :-1]).T) / 2


def _backlash_shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    return (
        ShapeParameter("play", "rad", spread(5e-6, 5e-4, 16), 5e-7, 5e-3, richer=0.05),
        ShapeParameter("load_friction_share", "", (0.5,), 0.0, 1.0),
    )


def _backlash_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """Contact is soft and well damped: with rebound, measurement errors change the time of the next impact too much.

    The play is a shape parameter of its own, so there is no ratio.
    """
    # Hz, resonance of the load on the contact stiffness in the twin
    load, swing = float(model.load_inertia.mean()), 2 * np.pi * 60.0
    # 0.7 of critical damping
    flanks = {"stiffness": load * swing**2, "damping": 2 * 0.7 * load * swing, "backlash": parameters["play"]}
    on_load = parameters["load_friction_share"] * model.viscous
    friction = {"viscous": -on_load, "backward_viscous": -on_load}
    return {"train": {"spring": flanks, "motor_friction": friction, "load_friction": {"viscous": on_load}}}


BACKLASH = CatalogueEffect(
    name="backlash",
    physics="Ts = 0 while |q - q_l| < b/2, at the flanks q_l follows q: impacts without rebound",
    source="Nordin and Gutman, Automatica 38 (2002), Controlling mechanical systems with backlash: a survey",
    sentence="The gear has play: when the torque changes its sign, the motor runs free for a moment.",
    visible_in=("reversal", "forward_slow"),
    entry="spring.backlash",
    coefficients=named(("ratio", "")),
    columns=_backlash_columns,
    on_load=(True,),
    scan=_backlash_scan,
    scenario=_backlash_scenario,
    shape=_backlash_shape,
    of_model=True,
    possible=lambda parameters, tracks, model: 0.5 <= parameters["ratio"] <= 2.0,
)


def _transmission_columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    """The load moves along q + g(q). Its inertia acts on g''; the motor torque is the load torque times 1 + dg/dq."""
    axis = tracks.robot.axis(tracks.joint)
    inertia, load = model.load_inertia, model.transmitted(tracks.acceleration)
    result: list[Array] = []
    for order in axis.transmission_orders:
        turn = order * axis.gear_ratio
        left = tracks.faded(turn * tracks.velocity)
        sine, cosine = left * np.sin(turn * tracks.position), left * np.cos(turn * tracks.position)
        rate, change = turn * tracks.velocity, turn * tracks.acceleration
        stiffness = model.slope[:, None]
        result.append(inertia * (cosine * change - sine * rate**2) + stiffness * sine + turn * cosine * load)
        result.append(inertia * (-sine * change - cosine * rate**2) + stiffness * cosine - turn * sine * load)
        grows = np.abs(load) / axis.rated_effort
        result += [sine, cosine, grows * sine, grows * cosine]
    return result


def _transmission_coefficients(tracks: Tracks) -> Sequence[tuple[str, str]]:
    orders = tracks.robot.axis(tracks.joint).transmission_orders
    return [
        (f"{kind}{wave}_{order:g}", unit)
        for order in orders
        for kind, unit in (("", "rad"), ("torque_", "N m"), ("load_torque_", "N m"))
        for wave in ("sine", "cosine")
    ]


def _transmission_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """The column is of first order in the error, the scenario is exact; its gear gets a stiff spring if needed."""
    orders = tracks.robot.axis(tracks.joint).transmission_orders
    torque = {name.removeprefix("torque_"): value for name, value in parameters.items() if name.startswith("torque_")}
    return {"train": {"gear_error": ripples(parameters, orders), "cogging": ripples(torque, orders)}}


TRANSMISSION_ERROR = CatalogueEffect(
    name="transmission_error",
    physics="q_l = q + g(q), g = sum over orders of A sin(o theta) + B cos(o theta); "
    "tau = J_l g'' + (dg/dq) Ts + (C + c |Ts|) sin + (D + d |Ts|) cos",
    source="Tuttle and Seering, IEEE Trans. Robotics and Automation 12 (1996), harmonic drive kinematic error",
    sentence="The gear turns unevenly: the load runs ahead and behind with the motor's angle.",
    visible_in=("forward_fast", "backward_fast", "wide"),
    entry="gear_error",
    coefficients=_transmission_coefficients,
    columns=_transmission_columns,
    on_load=(True, True, False, False, False, False),  # the mesh acts on the motor
    of_model=True,
    scenario=_transmission_scenario,
    applies=lambda tracks: bool(tracks.robot.axis(tracks.joint).transmission_orders),
)


def _cogging_columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    axis = tracks.robot.axis(tracks.joint)
    result: list[Array] = []
    for order in _cogging_orders(tracks):
        turn = order * axis.gear_ratio
        left = tracks.faded(turn * tracks.velocity)
        result += [left * np.sin(turn * tracks.position), left * np.cos(turn * tracks.position)]
    return result


def _cogging_orders(tracks: Tracks) -> list[float]:
    """The orders of the robot file and, for each, order - 1 and order + 1 (modulation by an eccentric rotor)."""
    own = tracks.robot.axis(tracks.joint).cogging_orders
    sides = {order + side for order in own for side in (-1.0, 1.0)}
    return sorted({*own, *(side for side in sides if side > 1)})


def _cogging_coefficients(tracks: Tracks) -> Sequence[tuple[str, str]]:
    return [(f"{wave}_{order:g}", "N m") for order in _cogging_orders(tracks) for wave in ("sine", "cosine")]


def _cogging_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    return {"train": {"cogging": ripples(parameters, _cogging_orders(tracks))}}


COGGING_TORQUE = CatalogueEffect(
    name="cogging_torque",
    physics="tau = sum over orders o, o - 1, o + 1 of A sin(o theta) + B cos(o theta), theta the motor's angle",
    source="Hanselman, Brushless Permanent Magnet Motor Design (2006), ch. 9",
    sentence="The motor's torque ripples with its angle.",
    visible_in=("forward_slow", "backward_slow"),
    entry="cogging",
    coefficients=_cogging_coefficients,
    columns=_cogging_columns,
    scenario=_cogging_scenario,
    applies=lambda tracks: bool(tracks.robot.axis(tracks.joint).cogging_orders),
)
