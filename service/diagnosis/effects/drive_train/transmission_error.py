"""Transmission error of the gear: the load position deviates periodically with the motor angle."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape
from service.diagnosis.effects.patch import Patch, ripples
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
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


def _coefficients(tracks: Tracks) -> Sequence[tuple[str, str]]:
    orders = tracks.robot.axis(tracks.joint).transmission_orders
    return [
        (f"{kind}{wave}_{order:g}", unit)
        for order in orders
        for kind, unit in (("", "rad"), ("torque_", "N m"), ("load_torque_", "N m"))
        for wave in ("sine", "cosine")
    ]


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """The column is of first order in the error, the scenario is exact; its gear gets a stiff spring if needed."""
    orders = tracks.robot.axis(tracks.joint).transmission_orders
    torque = {name.removeprefix("torque_"): value for name, value in parameters.items() if name.startswith("torque_")}
    return {"train": {"gear_error": ripples(parameters, orders), "cogging": ripples(torque, orders)}}


EFFECT = Effect(
    name="transmission_error",
    physics="q_l = q + g(q), g = sum over orders of A sin(o theta) + B cos(o theta); "
    "tau = J_l g'' + (dg/dq) Ts + (C + c |Ts|) sin + (D + d |Ts|) cos",
    source="Tuttle and Seering, IEEE Trans. Robotics and Automation 12 (1996), harmonic drive kinematic error",
    sentence="The gear turns unevenly: the load runs ahead and behind with the motor's angle.",
    visible_in=("forward_fast", "backward_fast", "wide"),
    entry="gear_error",
    coefficients=_coefficients,
    columns=_columns,
    of_model=True,
    scenario=_scenario,
    applies=lambda tracks: bool(tracks.robot.axis(tracks.joint).transmission_orders),
)
