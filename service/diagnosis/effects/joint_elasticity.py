"""A drive train that twists: the load does not follow the motor at once."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named
from service.diagnosis.patch import Patch, positive
from service.diagnosis.signals import Tracks, bins, in_frequency

Array = NDArray[np.float64]

SHARES = 3.0  # standard deviations of the prior, by which the motor's inertia may differ from its data sheet
LEAST_MOTOR = 0.02  # of the axis' inertia: of a motor that the robot file does not know
RATIO = (0.8, 1.25)  # of what the two masses say


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    compliance, damping, on_load = shape
    s = 2j * np.pi * bins(tracks.velocity.shape[1], tracks.rate)[None]
    inertia = model.load_inertia
    slope, viscous = model.slope[:, None], on_load * model.viscous
    # the load's impedance, with gravity as its spring: v_l = v / (1 + c s Z / (1 + h s)), s Z = J s^2 + b s + k_g
    spring = compliance / (1 + s * damping)
    follows = 1 / (1 + spring * (s * s * inertia + s * viscous + slope))
    shaken = inertia * tracks.accelerated(follows - 1)
    shaken += viscous * (in_frequency(tracks.position, tracks.rate, follows) - tracks.velocity)
    torque = model.gravity + inertia * tracks.acceleration + shaken
    rated = tracks.robot.axis(tracks.joint).rated_effort
    softer = compliance * torque * (torque / rated) ** 2
    harder = inertia * in_frequency(softer, tracks.rate, s * follows) + slope * softer
    return [shaken - slope * compliance * torque, harder]


def _motor(tracks: Tracks, model: Model, ratio: float) -> float:
    """Reflected motor inertia, kg m^2, that makes the ratio 1: what the load is heavier, the motor is lighter; within
    its prior.
    """
    axis = tracks.robot.axis(tracks.joint)
    sheet = axis.reflected_motor_inertia
    found = model.motor_inertia + (1 - ratio) * float(model.load_inertia.mean())
    if not sheet:
        return float(np.clip(found, LEAST_MOTOR * model.inertia.min(), model.inertia.min() / 2))
    reach = SHARES * tracks.robot.prior.motor_inertia
    return float(np.clip(found, sheet * max(1 - reach, 0.1), sheet * (1 + reach)))


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    heaviest = float(model.load_inertia.max())
    locked = np.array([60.0, 40.0, 28.0, 22.0, 18.0, 15.0, 12.5, 10.5, 9.0, 7.5, 6.0, 5.0, 4.0, 3.2])
    grid = 1 / (heaviest * (2 * np.pi * locked) ** 2)
    return (
        ShapeParameter("compliance", "rad/(N m)", tuple(grid.tolist()), grid[0] / 4, grid[-1] * 2),
        ShapeParameter("damping_time", "s", (5e-4, 2e-3), 1e-5, 1e-2),
        ShapeParameter("load_friction_share", "", (0.5,), 0.0, 1.0),
    )


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    stiffness = 1 / positive(parameters, "compliance")
    axis = tracks.robot.axis(tracks.joint)
    heavier = model.motor_inertia / axis.gear_ratio**2 - (axis.motor_inertia or 0.0)
    on_load = parameters["load_friction_share"] * model.viscous
    friction = {"viscous": -on_load, "backward_viscous": -on_load}
    return {
        "train": {
            "spring": {"stiffness": stiffness, "damping": stiffness * parameters["damping_time"]},
            "motor_inertia": heavier if axis.motor_inertia else 0.0,
            "motor_friction": friction,
            "load_friction": {"viscous": on_load},
        }
    }


EFFECT = Effect(
    name="joint_elasticity",
    physics="tau = Jm a + J_l a_l, the load behind a spring 1/c with damping h/c; twist = c Ts (1 - e (Ts / T0)^2)",
    source="Spong, J. Dyn. Sys. Meas. Control 109 (1987); the two-mass form of `axis_inertia`; e: hardening, "
    "T0: rated effort",
    sentence="The gear twists: the load lags behind the motor and swings.",
    visible_in=("wide",),
    entry="spring",
    coefficients=named(("ratio", ""), ("hardening", "")),
    columns=_columns,
    of_model=True,
    scenario=_scenario,
    shape=_shape,
    motor=_motor,
    possible=lambda parameters, tracks, model: RATIO[0] <= parameters["ratio"] <= RATIO[1],
)
