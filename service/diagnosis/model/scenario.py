"""The axis in the format of a scenario: the data of the robot file, with the patches of its effects."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any

import numpy as np

from service.diagnosis.effects.patch import Inexpressible, Patch, merged
from service.model.robot import Robot

UNKNOWN_MOTOR = 0.1  # of the axis' inertia: assumed motor inertia if the robot file has none
NOT_NEGATIVE = (
    "motor_friction.viscous", "motor_friction.backward_viscous", "motor_friction.coulomb",
    "motor_friction.backward_coulomb", "warming.viscous_loss", "lugre.damping", "spring.damping", "spring.backlash",
)  # fmt: skip
TORQUES = (
    "motor_inertia", "motor_friction.viscous", "motor_friction.backward_viscous", "motor_friction.coulomb",
    "motor_friction.backward_coulomb", "motor_friction.stribeck.extra", "motor_friction.power.coefficient",
    "warming.heat_capacity", "lugre.stiffness", "lugre.damping", "lugre.coulomb", "lugre.breakaway",
    "spring.stiffness", "spring.damping", "spring.hardening", "hose.stiffness",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class AxisEntry:
    """`train`, `measurement` and `links` of a scenario for one axis; `held`: descriptions of limited values."""

    train: Patch
    measurement: Patch
    links: Patch
    held: tuple[str, ...]
    scale: float  # of the torques and inertias used here, over the true ones


def axis_entry(
    robot: Robot, joint: str, inertia: float, viscous: float, patches: Sequence[Patch], *, true: bool = False
) -> AxisEntry:
    """An axis of about `inertia`, kg m^2, with its effects; Inexpressible if no drive train can represent them.

    Inertia and torques are as recorded by a drive, perhaps with a wrong torque constant, or `true` values.
    """
    axis = robot.axis(joint)
    motor = axis.motor_inertia or UNKNOWN_MOTOR * inertia / axis.gear_ratio**2
    friction = {"viscous": viscous, "backward_viscous": viscous, "coulomb": 0.0, "backward_coulomb": 0.0}
    bare = {"motor_inertia": motor, "motor_friction": friction, "effort_gain": 1.0, "effort_offset": 0.0}
    whole = reduce(merged, patches, {"train": bare, "measurement": {}, "links": {}})
    train = whole["train"]
    if train["effort_gain"] <= 0:
        raise Inexpressible(f"effort_gain = {train['effort_gain']:.3g} is not above 0")
    # 0.1 of the value in the robot file
    held = _held(train, 0.1 * motor)
    scale = 1.0 if true else train["effort_gain"]
    for path in TORQUES:
        _scale(train, path.split("."), 1 / scale)
    if "cogging" in train:
        train["cogging"] = [ripple | {"amplitude": ripple["amplitude"] / scale} for ripple in train["cogging"]]
    if "gear_error" in train or "spring" in train:
        _sprung(train, inertia / scale, axis.gear_ratio)
    _tidied(train)
    return AxisEntry(train, whole["measurement"], whole["links"], held, scale)


def stiffened(entry: AxisEntry, inertia: float, ratio: float) -> AxisEntry:
    """The entry with a stiff spring if it has none: in a scenario either all axes have springs or none has."""
    train = merged(entry.train, {})
    _sprung(train, inertia / entry.scale, ratio)
    return replace(entry, train=train)


def _held(train: Patch, least_motor: float) -> tuple[str, ...]:
    """Set values beyond the limits of the scenario to the limit, and describe each change."""
    held: list[str] = []
    for path in NOT_NEGATIVE:
        *way, last = path.split(".")
        there: Any = reduce(lambda part, key: part.get(key, {}), way, train)
        if there.get(last, 0.0) < 0:
            held.append(f"{path} = {there[last]:.3g} is held at 0")
            there[last] = 0.0
    if train["motor_inertia"] < least_motor:
        held.append(f"motor_inertia = {train['motor_inertia']:.3g} is held at {least_motor:.3g}")
        train["motor_inertia"] = least_motor
    return tuple(held)


def _scale(part: Patch, path: Sequence[str], factor: float) -> None:
    if path[0] not in part:
        return
    if len(path) > 1:
        _scale(part[path[0]], path[1:], factor)
    else:
        part[path[0]] *= factor


def _sprung(train: Patch, inertia: float, ratio: float) -> None:
    """Add a stiff spring to a gear that has none."""
    spring = train.setdefault("spring", {})
    if "stiffness" in spring:
        return
    motor = train["motor_inertia"] * ratio**2
    load = max(inertia - motor, UNKNOWN_MOTOR * inertia)
    swing = motor * load / (motor + load)
    # Hz, locked rotor, for a gear with backlash or transmission error but no known elasticity
    # Hz, resonance of motor against load: limit of the time step of the simulator
    spring["stiffness"] = min(load * (2 * np.pi * 350.0) ** 2, swing * (2 * np.pi * 1000.0) ** 2)
    # 0.3 damping ratio of such a gear
    spring["damping"] = 0.3 * float(np.sqrt(spring["stiffness"] * load))


def _tidied(train: Patch) -> None:
    """Remove backward values equal to the forward ones; with bristles, dry friction moves to the load side."""
    friction = train["motor_friction"]
    if "lugre" in train:
        moved = {key: friction.pop(key) for key in ("coulomb", "backward_coulomb")}
        if any(moved.values()):
            train["load_friction"] = moved
    for part in (friction, train.get("load_friction", {})):
        for key in ("viscous", "coulomb"):
            if f"backward_{key}" in part and np.isclose(part[f"backward_{key}"], part[key], rtol=1e-12, atol=0.0):
                del part[f"backward_{key}"]
