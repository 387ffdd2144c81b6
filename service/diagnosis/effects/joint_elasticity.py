"""A drive train that twists: the load does not follow the motor at once."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named
from service.diagnosis.patch import Patch, positive
from service.diagnosis.signals import Tracks, bins

Array = NDArray[np.float64]


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    compliance, damping = shape
    s = 2j * np.pi * bins(tracks.velocity.shape[1], tracks.rate)[None]
    inertia = model.load_inertia
    spring = s * compliance / (1 + s * damping)
    away = 1 / (1 + spring * (s * inertia + model.viscous / 2)) - 1
    # at rest the load hangs by its twist away from where the motor is, where gravity is another
    sag = tracks.stiffness[:, None] * compliance * tracks.gravity
    return [inertia * tracks.accelerated(away) - sag]


def _shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    heaviest = float(model.load_inertia.max())
    locked = np.array([60.0, 40.0, 28.0, 22.0, 18.0, 15.0, 12.5, 10.5, 9.0, 7.5, 6.0, 5.0])
    grid = 1 / (heaviest * (2 * np.pi * locked) ** 2)
    return (
        ShapeParameter("compliance", "rad/(N m)", tuple(grid.tolist()), grid[0] / 4, grid[-1] * 2),
        ShapeParameter("damping_time", "s", (5e-4, 2e-3), 1e-5, 1e-2),
    )


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """A ratio other than 1 says that the load's share of the inertia is another: the rest is the motor's."""
    ratio = positive(parameters, "ratio")
    stiffness = ratio / positive(parameters, "compliance")
    moved = (1 - ratio) * float(model.load_inertia.mean()) / tracks.robot.axis(tracks.joint).gear_ratio ** 2
    spring = {"stiffness": stiffness, "damping": stiffness * parameters["damping_time"]}
    return {"train": {"spring": spring, "motor_inertia": moved}}


EFFECT = Effect(
    name="joint_elasticity",
    physics="tau = r J_l (a_l - a), a_l the load's acceleration behind a spring 1/c with damping h/c; r near 1",
    source="Spong, J. Dyn. Sys. Meas. Control 109 (1987); the two-mass form of `axis_inertia`",
    sentence="The gear twists: the load lags behind the motor and swings.",
    visible_in=("wide",),
    entry="spring",
    coefficients=named(("ratio", "")),
    columns=_columns,
    of_model=True,
    scenario=_scenario,
    shape=_shape,
    plausible=(0.6, 1.6),
)
