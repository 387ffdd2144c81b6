"""`sweepid drive --hide SEED`: one effect, chosen and sized by the seed, that is added to a scenario and not disclosed.

Only effects that sweeps alone can identify are hidden: no payload and no torque constant (they need a test mass), no
warming (it takes hours), no backlash. The axis carries weight, so that every effect is visible. Sizes are 2 to 5 % of
the rated effort.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.rigid_body import RigidBody
from simulator.scenario import Scenario, ScenarioError

SLOW = 0.0105
"""rad/s: 0.1 rev/min."""


@dataclass(frozen=True)
class HiddenEffect:
    """The hidden effect: parameters with the names used by a diagnosis, SI on the joint side."""

    joint: str
    effect: str
    parameters: dict[str, float]


@dataclass
class _ScenarioDraft:
    """A scenario as nested data that can be changed; `size` in N m."""

    random: np.random.Generator
    scenario: Scenario
    joint: str
    size: float
    data: dict[str, Any]

    @property
    def train(self) -> dict[str, Any]:
        return self.data["axes"][self.joint]["train"]

    def rub(self, **parts: object) -> None:
        self.train["motor_friction"] |= parts

    def weight(self) -> float:
        """Largest gravity torque about the axis over its revolution, N m, with the other joints at zero."""
        return _weight(self.scenario, self.joint)


def hide(scenario: Scenario, seed: int) -> tuple[Scenario, HiddenEffect]:
    """The scenario with one additional effect, and the effect. Raises ScenarioError if no axis carries weight."""
    random = np.random.default_rng(seed)
    joints = [  # whose gravity torque is above a tenth of the rated effort
        joint for joint in scenario.axes if _weight(scenario, joint) > 0.1 * scenario.nominal(joint).rated_effort
    ]
    if not joints:
        raise ScenarioError(f"scenario {scenario.name}: nothing can be hidden, as no axis carries weight")
    joint = joints[random.integers(len(joints))]
    effect = list(EFFECTS)[random.integers(len(EFFECTS))]
    size = float(random.uniform(0.02, 0.05)) * scenario.nominal(joint).rated_effort
    machine = _ScenarioDraft(random, scenario, joint, size, scenario.model_dump())
    parameters = EFFECTS[effect](machine)
    return Scenario.model_validate(machine.data), HiddenEffect(joint, effect, parameters)


def _coulomb_friction(machine: _ScenarioDraft) -> dict[str, float]:
    machine.rub(coulomb=machine.size)
    return {"coulomb": machine.size}


def _asymmetric_friction(machine: _ScenarioDraft) -> dict[str, float]:
    half = machine.size / 2 * machine.random.choice([-1.0, 1.0])
    machine.rub(coulomb=machine.size + half, backward_coulomb=machine.size - half)
    return {"coulomb": machine.size, "coulomb_difference": float(half)}


def _stribeck_friction(machine: _ScenarioDraft) -> dict[str, float]:
    velocity = SLOW * machine.random.uniform(0.5, 1.5)
    machine.rub(coulomb=machine.size, stribeck={"extra": machine.size, "velocity": velocity})
    return {"coulomb": machine.size, "extra": machine.size, "velocity": velocity}


def _load_dependent_friction(machine: _ScenarioDraft) -> dict[str, float]:
    dependence = machine.size / machine.weight()
    machine.rub(coulomb=machine.size / 2, load_dependence=dependence)
    return {"coulomb": machine.size / 2, "load_dependence": dependence}


def _gravity_error(machine: _ScenarioDraft) -> dict[str, float]:
    """The centre of mass of the link after the axis is further out, or nearer, than in CAD."""
    link = f"link_{machine.scenario.joints.index(machine.joint) + 1}"
    entry = machine.data["links"].setdefault(link, {})
    probe = 0.01  # m
    entry["shift"] = (probe, 0.0, 0.0)
    before, after = (_pull(one, machine.joint) for one in (machine.scenario, Scenario.model_validate(machine.data)))
    shift = probe * machine.size / float(np.hypot(*(after - before))) * machine.random.choice([-1.0, 1.0])
    entry["shift"] = (float(shift), 0.0, 0.0)
    return {}


def _hose_spring(machine: _ScenarioDraft) -> dict[str, float]:
    rest = machine.random.uniform(-0.5, 0.5)
    machine.train["hose"] = {"stiffness": machine.size, "rest": rest}
    return {"stiffness": machine.size, "torque_at_zero": -machine.size * rest}


def _measurement_delay(machine: _ScenarioDraft) -> dict[str, float]:
    delay = machine.random.uniform(0.8e-3, 2.5e-3)
    machine.data["measurement"]["effort_delay"] = delay
    return {"delay": delay}


def _cogging_torque(machine: _ScenarioDraft) -> dict[str, float]:
    order = machine.scenario.nominal(machine.joint).cogging_orders[0]
    phase = machine.random.uniform(0, 2 * np.pi)
    machine.train["cogging"] = ({"order": order, "amplitude": machine.size, "phase": phase},)
    return {f"sine_{order:g}": machine.size * np.cos(phase), f"cosine_{order:g}": machine.size * np.sin(phase)}


def _presliding_hysteresis(machine: _ScenarioDraft) -> dict[str, float]:
    way = SLOW / (2 * np.pi) * machine.random.uniform(0.05, 0.2)
    stiffness = machine.size / way
    ratio = machine.scenario.nominal(machine.joint).gear_ratio
    damping = 0.3 * float(np.sqrt(stiffness * machine.train["motor_inertia"])) * ratio
    machine.train["lugre"] = {
        "stiffness": stiffness,
        "damping": damping,
        "coulomb": machine.size,
        "breakaway": machine.size,
        "stribeck_velocity": 0.1 * SLOW,
    }
    return {"coulomb": machine.size}


def _joint_elasticity(machine: _ScenarioDraft) -> dict[str, float]:
    """Locked rotor at 9 to 13 Hz, speed control of 6 Hz; the other axes get springs that are not visible: 350 Hz."""
    body, zero = RigidBody(machine.scenario), np.zeros(len(machine.scenario.joints))
    found = 0.0
    for joint, axis in machine.data["axes"].items():
        load = float(body.inertia(zero)[machine.scenario.joints.index(joint)])
        own = joint == machine.joint
        stiffness = load * (2 * np.pi * (machine.random.uniform(9.0, 13.0) if own else 350.0)) ** 2
        axis["train"]["spring"] = {
            "stiffness": stiffness,
            "damping": (0.08 if own else 0.3) * np.sqrt(stiffness * load),
        }
        if own:
            motor = axis["train"]["motor_inertia"] * machine.scenario.nominal(joint).gear_ratio ** 2
            axis["control"]["gain"] = 2 * np.pi * 6.0 * (load + motor)
            found = 1 / stiffness
    return {"compliance": found}


def _effort_offset(machine: _ScenarioDraft) -> dict[str, float]:
    offset = machine.size * machine.random.choice([-1.0, 1.0])
    machine.train["effort_offset"] = offset
    return {"offset": offset}


def _pull(scenario: Scenario, joint: str) -> NDArray[np.float64]:
    """Gravity torque about the axis at 0 and at 90 degrees, the other joints at zero, N m."""
    curve = RigidBody(scenario).gravity(scenario.joints.index(joint), np.zeros(len(scenario.joints)))
    return np.array([curve.cosine, curve.sine])


def _weight(scenario: Scenario, joint: str) -> float:
    """Largest gravity torque about the axis over its revolution, N m."""
    return float(np.hypot(*_pull(scenario, joint)))


EFFECTS: dict[str, Callable[[_ScenarioDraft], dict[str, float]]] = {
    "coulomb_friction": _coulomb_friction,
    "asymmetric_friction": _asymmetric_friction,
    "stribeck_friction": _stribeck_friction,
    "load_dependent_friction": _load_dependent_friction,
    "gravity_error": _gravity_error,
    "hose_spring": _hose_spring,
    "joint_elasticity": _joint_elasticity,
    "measurement_delay": _measurement_delay,
    "cogging_torque": _cogging_torque,
    "presliding_hysteresis": _presliding_hysteresis,
    "effort_offset": _effort_offset,
}
