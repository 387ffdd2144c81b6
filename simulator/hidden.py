"""`sweepid drive --hide SEED`: one effect, chosen and sized by the seed, that is added to a scenario and not disclosed.

Only effects that sweeps alone can identify are hidden: no payload and no torque constant (they need a test mass), no
warming (it takes hours), no backlash. The axis carries weight, so that every effect is visible. Sizes are 2 to 5 % of
the rated effort.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.rigid_body import RigidBody
from simulator.scenario import DrivenAxis, DriveTrain, LinkDeviation, Scenario, ScenarioError

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
    """A scenario, and what becomes of it; `size` in N m."""

    random: np.random.Generator
    scenario: Scenario
    joint: str
    size: float
    changed: Scenario

    @property
    def train(self) -> DriveTrain:
        return self.scenario.axes[self.joint].train

    def change(self, joint: str, train: Mapping[str, object], **control: object) -> None:
        axis = self.changed.axes[joint].model_dump()
        axis |= {"train": axis["train"] | train, "control": axis["control"] | control}
        self.replace(axes=self.changed.axes | {joint: DrivenAxis.model_validate(axis)})

    def replace(self, **parts: object) -> None:
        self.changed = self.changed.model_copy(update=parts)

    def rub(self, **parts: object) -> None:
        self.change(self.joint, {"motor_friction": self.train.motor_friction.model_dump() | parts})


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
    machine = _ScenarioDraft(random, scenario, joint, size, scenario)
    parameters = EFFECTS[effect](machine)
    return Scenario.model_validate(machine.changed.model_dump()), HiddenEffect(joint, effect, parameters)


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
    dependence = machine.size / _weight(machine.scenario, machine.joint)
    machine.rub(coulomb=machine.size / 2, load_dependence=dependence)
    return {"coulomb": machine.size / 2, "load_dependence": dependence}


def _gravity_error(machine: _ScenarioDraft) -> dict[str, float]:
    """The centre of mass of the link after the axis is further out, or nearer, than in CAD."""
    link = f"link_{machine.scenario.joints.index(machine.joint) + 1}"
    links = machine.scenario.links
    deviation = links.get(link, LinkDeviation())

    def move(shift: float) -> None:
        machine.replace(links=links | {link: deviation.model_copy(update={"shift": (shift, 0.0, 0.0)})})

    probe = 0.01  # m
    move(probe)
    before, after = (_pull(one, machine.joint) for one in (machine.scenario, machine.changed))
    move(float(probe * machine.size / float(np.hypot(*(after - before))) * machine.random.choice([-1.0, 1.0])))
    return {}


def _hose_spring(machine: _ScenarioDraft) -> dict[str, float]:
    rest = machine.random.uniform(-0.5, 0.5)
    machine.change(machine.joint, {"hose": {"stiffness": machine.size, "rest": rest}})
    return {"stiffness": machine.size, "torque_at_zero": -machine.size * rest}


def _measurement_delay(machine: _ScenarioDraft) -> dict[str, float]:
    delay = machine.random.uniform(0.8e-3, 2.5e-3)
    machine.replace(measurement=machine.scenario.measurement.model_copy(update={"effort_delay": delay}))
    return {"delay": delay}


def _cogging_torque(machine: _ScenarioDraft) -> dict[str, float]:
    order = machine.scenario.nominal(machine.joint).cogging_orders[0]
    phase = machine.random.uniform(0, 2 * np.pi)
    machine.change(machine.joint, {"cogging": ({"order": order, "amplitude": machine.size, "phase": phase},)})
    return {f"sine_{order:g}": machine.size * np.cos(phase), f"cosine_{order:g}": machine.size * np.sin(phase)}


def _presliding_hysteresis(machine: _ScenarioDraft) -> dict[str, float]:
    way = SLOW / (2 * np.pi) * machine.random.uniform(0.05, 0.2)
    stiffness = machine.size / way
    ratio = machine.scenario.nominal(machine.joint).gear_ratio
    damping = 0.3 * float(np.sqrt(stiffness * machine.train.motor_inertia)) * ratio
    lugre = {
        "stiffness": stiffness,
        "damping": damping,
        "coulomb": machine.size,
        "breakaway": machine.size,
        "stribeck_velocity": 0.1 * SLOW,
    }
    machine.change(machine.joint, {"lugre": lugre})
    return {"coulomb": machine.size}


def _joint_elasticity(machine: _ScenarioDraft) -> dict[str, float]:
    """Locked rotor at 9 to 13 Hz, speed control of 6 Hz; the other axes get springs that are not visible: 350 Hz."""
    body, zero = RigidBody(machine.scenario), np.zeros(len(machine.scenario.joints))
    found = 0.0
    for joint, axis in machine.scenario.axes.items():
        load = float(body.inertia(zero)[machine.scenario.joints.index(joint)])
        own = joint == machine.joint
        stiffness = load * (2 * np.pi * (machine.random.uniform(9.0, 13.0) if own else 350.0)) ** 2
        gain = axis.control.gain
        if own:
            motor = axis.train.motor_inertia * machine.scenario.nominal(joint).gear_ratio ** 2
            gain, found = 2 * np.pi * 6.0 * (load + motor), 1 / stiffness
        damping = (0.08 if own else 0.3) * np.sqrt(stiffness * load)
        machine.change(joint, {"spring": {"stiffness": stiffness, "damping": damping}}, gain=gain)
    return {"compliance": found}


def _effort_offset(machine: _ScenarioDraft) -> dict[str, float]:
    offset = machine.size * machine.random.choice([-1.0, 1.0])
    machine.change(machine.joint, {"effort_offset": offset})
    return {"offset": offset}


def _pull(scenario: Scenario, joint: str) -> NDArray[np.float64]:
    """Gravity torque about the axis at 0 and at 90 degrees, the other joints at zero, N m."""
    curve = RigidBody(scenario).gravity(scenario.joints.index(joint), np.zeros(len(scenario.joints)))
    return np.array([curve.cosine, curve.sine])


def _weight(scenario: Scenario, joint: str) -> float:
    """Largest gravity torque about the axis over its revolution, N m, with the other joints at zero."""
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
