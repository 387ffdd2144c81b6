"""Joint elasticity: the load does not follow the motor exactly."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named
from service.diagnosis.effects.patch import Patch, positive
from service.diagnosis.rows.responses import Complex, back, spectrum, through
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]

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


def _two_masses(tracks: Tracks, model: Model, shape: Shape) -> _TwoMasses:
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
        through_gear = known["effort"] + known["acceleration"] * -motor + known["velocity"] * -on_motor
        return (through_gear * spring).signal(tracks.velocity.shape[1])

    torque = tracks.remember((damping, motor, on_motor), transmitted)
    linear = twist = compliance * torque
    if hardening > 0:
        rated = tracks.robot.axis(tracks.joint).rated_effort

        def damped() -> Array:
            """The damping also acts on the smaller twist."""
            stiffer = torque - rated * softened(torque / rated, hardening)
            return torque + damping * through(stiffer, tracks.rate, s * spring)

        more = tracks.remember((damping, motor, on_motor, hardening), damped)
        twist = compliance * rated * softened(more / rated, hardening)
    return _TwoMasses(impedance, 1 / (1 + compliance * spring * impedance), load_inertia, viscous, linear, twist)


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    two = _two_masses(tracks, model, shape)
    weight = model.gravity
    if not tracks.prismatic:
        away = tracks.away - two.twist
        weight = model.torque[:, None] * np.cos(away) + model.slope[:, None] * np.sin(away)
        weight = weight + model.slope[:, None] * two.twist  # the gravity stiffness is in the impedance
    moved = tracks.spectra["velocity"] * two.viscous + spectrum(weight, tracks.rate)
    if shape[3] > 0:
        moved += spectrum(two.linear_twist - two.twist, tracks.rate) * two.impedance
    moved *= two.follows
    shaken = replace(moved, away=moved.away + two.load_inertia * tracks.turned_over * (two.follows - 1))
    return [shaken.signal(tracks.velocity.shape[1]) - model.gravity - two.viscous * tracks.velocity]


def _parts(tracks: Tracks, model: Model, shape: Shape) -> Array:
    two, count = _two_masses(tracks, model, shape), tracks.velocity.shape[1]
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


def _motors(tracks: Tracks, model: Model) -> tuple[float, float, float]:
    """Reflected inertia of the motor, kg m^2 (kg): value of the data sheet, lower and upper limit from its prior."""
    axis = tracks.robot.axis(tracks.joint)
    sheet = axis.reflected_motor_inertia
    if not sheet:
        # 0.02 of the axis' inertia, for a motor that the robot file does not contain
        return model.motor_inertia, 0.02 * float(model.inertia.min()), float(model.inertia.min()) / 2
    # 3.0 standard deviations of the prior: limit of the difference between motor inertia and data sheet
    reach = 3.0 * tracks.robot.prior.motor_inertia
    return sheet, sheet * max(1 - reach, 0.1), sheet * (1 + reach)


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    heaviest = float(model.load_inertia.max())
    locked = np.array([60.0, 40.0, 28.0, 22.0, 18.0, 15.0, 12.5, 10.5, 9.0, 7.5, 6.0, 5.0, 4.0, 3.2])
    grid = 1 / (heaviest * (2 * np.pi * locked) ** 2)
    motor, lightest, largest = _motors(tracks, model)
    # 20.0 ratio: added stiffness at the twist of the rated effort over the linear stiffness
    return (
        ShapeParameter("compliance", "rad/(N m)", tuple(grid.tolist()), grid[0] / 4, grid[-1] * 2),
        ShapeParameter("damping_time", "s", (5e-4, 2e-3), 1e-5, 1e-2),
        ShapeParameter("load_friction_share", "", (0.5,), 0.0, 1.0),
        ShapeParameter("hardening", "", (0.0,), 0.0, 20.0),
        ShapeParameter("motor_inertia", "kg m^2", (motor,), lightest, largest),
    )


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
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


EFFECT = Effect(
    name="joint_elasticity",
    physics="tau = Jm a + J_l a_l, the load behind a spring 1/c with damping h/c; x + e x^3 / (c T0)^2 = c Ts",
    source="Spong, J. Dyn. Sys. Meas. Control 109 (1987); the two-mass form of `axis_inertia`; e: hardening, "
    "T0: rated effort",
    sentence="The gear twists: the load lags behind the motor and swings.",
    visible_in=("wide",),
    entry="spring",
    coefficients=named(("ratio", "")),
    columns=_columns,
    parts=_parts,
    of_model=True,
    scenario=_scenario,
    shape=_shape,
    possible=lambda parameters, tracks, model: RATIO[0] <= parameters["ratio"] <= RATIO[1],
)
