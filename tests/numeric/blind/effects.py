"""What may be hidden: richer physics than the catalogue's columns, sized by the torque it makes.

Each function puts an effect into a draft and returns the parameters that a diagnosis may state, under its names.
"""

from collections.abc import Callable

import numpy as np

from simulator import DriveTrain, Turn, Waveform, warmth
from tests.numeric.blind.machine import ELASTIC_BAND, Draft

Hide = Callable[[Draft], dict[str, float]]


def coulomb_friction(draft: Draft) -> dict[str, float]:
    part = draft.random.uniform(0.3, 1.0)
    draft.friction(coulomb=part * draft.size)
    draft.train["load_friction"] = draft.train["load_friction"] | {"coulomb": (1 - part) * draft.size}
    return {"coulomb": draft.size}


def asymmetric_friction(draft: Draft) -> dict[str, float]:
    """`size` between the directions; every other one differs in its viscous part as well."""
    mean, way = draft.size * draft.random.uniform(0.8, 2.0), draft.random.choice([-1.0, 1.0])
    viscous = draft.train["motor_friction"]["viscous"]
    unlike = viscous * draft.random.choice([1.0, 0.5])
    draft.friction(coulomb=mean + way * draft.size / 2, backward_coulomb=mean - way * draft.size / 2)
    draft.friction(backward_viscous=unlike)
    return {"coulomb": mean, "coulomb_difference": way * draft.size / 2, "viscous_difference": (viscous - unlike) / 2}


def stribeck_friction(draft: Draft) -> dict[str, float]:
    coulomb, speed = draft.size * draft.random.uniform(0.8, 2.0), draft.slow * draft.random.uniform(0.3, 1.5)
    exponent = draft.random.uniform(0.7, 2.2)
    draft.friction(coulomb=coulomb, stribeck={"extra": draft.size, "velocity": speed, "exponent": exponent})
    return {"coulomb": coulomb, "extra": draft.size, "velocity": speed, "exponent": exponent}


def nonlinear_viscous_friction(draft: Draft) -> dict[str, float]:
    """`size` is what a straight line leaves of it, about a third of the whole at the fastest."""
    exponent = draft.random.uniform(0.35, 0.65) if draft.random.random() < 0.5 else draft.random.uniform(1.6, 2.3)
    fastest = 3 * 1.6 * draft.slow
    draft.friction(power={"coefficient": 3 * draft.size / fastest**exponent, "exponent": exponent})
    return {"exponent": exponent}


def load_dependent_friction(draft: Draft) -> dict[str, float]:
    coulomb = draft.size * draft.random.uniform(0.3, 1.0)
    dependence = draft.size / float(np.abs(draft.gravity()).max())
    draft.friction(coulomb=coulomb, load_dependence=dependence)
    return {"coulomb": coulomb, "load_dependence": dependence}


def friction_temperature_drift(draft: Draft) -> dict[str, float]:
    """Dry friction is `size` less at the end, from what it has itself dissipated."""
    coulomb, loss = draft.size * draft.random.uniform(1.5, 3.0), 0.03
    last = draft.designs[-1].spec.started_at
    warming = {"heat_capacity": 1.0, "time_constant": last * draft.random.uniform(0.4, 1.5), "coulomb_loss": loss}
    warming["viscous_loss"] = draft.random.uniform(0.0, loss)
    draft.friction(coulomb=coulomb)
    wanted = -np.log(1 - draft.size / coulomb) / loss
    for _ in range(12):  # the capacity that ends at that temperature: hotter friction heats less
        train = DriveTrain.model_validate(draft.train | {"warming": warming})
        warming["heat_capacity"] *= warmth(train, _turns(draft))[-1] / wanted
    draft.train["warming"] = warming
    return {"coulomb": coulomb}


def gravity_error(draft: Draft) -> dict[str, float]:
    """Centre of mass and mass of the arm's links are not those of CAD."""
    for number, link in enumerate(_arm(draft)):
        entry = draft.links.setdefault(link, {})
        entry["shift"] = tuple(draft.random.normal(scale=0.02, size=3) * (1.0, 0.3, 1.0))
        entry["mass"] = float(np.clip(1 + 0.08 * draft.random.standard_normal(), 0.7, 1.4)) if number else 1.0
    _scale_links(draft, _arm(draft))
    return {}


def payload(draft: Draft) -> dict[str, float]:
    """A bar at the tool, a hand's breadth to a forearm's length out."""
    out = draft.random.uniform(0.0, 0.25)
    bare = draft.gravity()
    body = {"name": "payload", "start": (out, 0.0, 0.0), "end": (out + 0.1, 0.0, 0.0), "radius": 0.05, "mass": 1.0}
    draft.links.setdefault("tool", {})["added"] = (body,)
    body["mass"] = draft.size / float(np.abs(draft.gravity() - bare).max())
    return {"mass": body["mass"]}


def torque_constant_error(draft: Draft) -> dict[str, float]:
    share = draft.size / float(np.abs(draft.gravity()).max())
    error = draft.random.choice([-1.0, 1.0]) * float(np.clip(share, 0.02, 0.15))
    draft.train["effort_gain"] = 1.0 + error
    return {"gain_error": error}


def hose_spring(draft: Draft) -> dict[str, float]:
    """With damping; its rest is within the axis' range."""
    where = draft.poses[:, draft.index]
    rest = draft.random.uniform(float(where.min()), float(where.max()))
    stiffness = draft.size / float(np.abs(where - rest).max())
    damping = draft.random.uniform(0.0, 0.3) * draft.train["motor_friction"]["viscous"]
    draft.train["hose"] = {"stiffness": stiffness, "rest": rest, "damping": damping}
    return {"stiffness": stiffness, "torque_at_zero": -stiffness * rest}


def joint_elasticity(draft: Draft) -> dict[str, float]:
    """Locked rotor from 40 Hz (small) to 10 Hz (large), hardening by up to a fifth at the largest twist."""
    load = float(draft.load_inertia().mean())
    frequency = float(np.clip(22.0 * (0.02 / _share(draft)) ** 0.45, 10.0, 45.0)) * draft.random.uniform(0.9, 1.1)
    stiffness = load * (2 * np.pi * frequency) ** 2
    twist = 1.2 * float(np.abs(draft.gravity()).max() + 0.1 * _rated(draft)) / stiffness
    hardening = draft.random.uniform(0.0, 0.2) * stiffness / twist**2
    damping = draft.random.uniform(0.02, 0.06) * 2 * np.sqrt(stiffness * load)
    draft.spring(stiffness=stiffness, damping=damping, hardening=hardening)
    draft.band = ELASTIC_BAND
    return {} if hardening else {"compliance": 1 / stiffness}


def measurement_delay(draft: Draft) -> dict[str, float]:
    """Any fraction of a sample: 0.3 ms (small) to 3 ms (large)."""
    delay = 0.8e-3 * (_share(draft) / 0.02) * draft.random.uniform(0.8, 1.3)
    draft.measurement["effort_delay"] = delay
    return {"delay": delay}


def cogging_torque(draft: Draft) -> dict[str, float]:
    """Both known orders, the second up to two thirds of the first, random phases."""
    orders = draft.robot.axes[draft.index].cogging_orders
    sizes = (draft.size, draft.size * draft.random.uniform(0.1, 0.66))
    phases = draft.random.uniform(0, 2 * np.pi, 2)
    ripples = zip(orders, sizes, phases, strict=True)
    draft.train["cogging"] = tuple({"order": o, "amplitude": a, "phase": p} for o, a, p in ripples)
    waves = {f"sine_{o:g}": a * np.cos(p) for o, a, p in zip(orders, sizes, phases, strict=True)}
    return waves | {f"cosine_{o:g}": a * np.sin(p) for o, a, p in zip(orders, sizes, phases, strict=True)}


def transmission_error(draft: Draft) -> dict[str, float]:
    """`size` is what gravity makes of the first order; the second is up to half as much."""
    orders = draft.robot.axes[draft.index].transmission_orders
    first = draft.size / (orders[0] * draft.ratio * float(np.abs(draft.gravity()).max()))
    sizes = (first, first * draft.random.uniform(0.1, 0.5))
    phases = draft.random.uniform(0, 2 * np.pi, 2)
    draft.spring()
    errors = zip(orders, sizes, phases, strict=True)
    draft.train["gear_error"] = tuple({"order": o, "amplitude": a, "phase": p} for o, a, p in errors)
    return {}


def presliding_hysteresis(draft: Draft) -> dict[str, float]:
    """LuGre with bristles that bend for a fiftieth to a third of a reversal's way."""
    way = draft.slow / (2 * np.pi) * 0.02 * 15 ** draft.random.uniform()
    coulomb = draft.size
    stiffness = coulomb / way
    draft.train["lugre"] = {
        "stiffness": stiffness,
        "damping": draft.random.uniform(0.1, 0.6) * float(np.sqrt(stiffness * draft.motor_inertia)),
        "coulomb": coulomb,
        "breakaway": coulomb * draft.random.uniform(1.0, 1.1),
        "stribeck_velocity": draft.slow * 0.1,
    }
    return {"coulomb": coulomb}


def backlash(draft: Draft) -> dict[str, float]:
    """2" (small) to 60" (large) from flank to flank."""
    gap = 6e-5 * (_share(draft) / 0.02) * draft.random.uniform(0.7, 1.4)
    draft.spring(backlash=gap)
    return {"play": gap}


def effort_offset(draft: Draft) -> dict[str, float]:
    offset = draft.size * draft.random.choice([-1.0, 1.0])
    draft.train["effort_offset"] = offset
    return {"offset": offset}


CATALOGUE: dict[str, Hide] = {
    hide.__name__: hide
    for hide in (
        coulomb_friction, asymmetric_friction, stribeck_friction, nonlinear_viscous_friction, load_dependent_friction,
        friction_temperature_drift, gravity_error, hose_spring, joint_elasticity, measurement_delay, cogging_torque,
        transmission_error, presliding_hysteresis, backlash, effort_offset, torque_constant_error, payload,
    )
}  # fmt: skip


def roller_ripple(draft: Draft) -> dict[str, float]:
    """Torque that repeats with the joint, some 40 times a turn: a bearing's rollers."""
    order = draft.random.uniform(25.0, 60.0) / draft.ratio
    draft.train["cogging"] = ({"order": order, "amplitude": draft.size, "phase": draft.random.uniform(0, 6.28)},)
    return {}


def second_mass(draft: Draft) -> dict[str, float]:
    """Something on the load that is not bolted down."""
    inertia = float(draft.load_inertia().min()) * np.clip(0.08 * _share(draft) / 0.02, 0.05, 0.25)
    own = 2 * np.pi * draft.random.uniform(5.0, 12.0)
    damping = draft.random.uniform(0.06, 0.16) * inertia * own
    draft.train["appendage"] = {"inertia": inertia, "stiffness": inertia * own**2, "damping": damping}
    return {}


def friction_patch(draft: Draft) -> dict[str, float]:
    """A sore spot of the bearing within the way of two poses' sweeps."""
    where = draft.poses[draft.random.integers(len(draft.poses)), draft.index] + draft.random.uniform(-0.02, 0.02)
    width = draft.random.uniform(0.01, 0.03)
    draft.train["load_friction"] = draft.train["load_friction"] | {
        "patch": {"centre": where, "width": width, "coulomb": draft.size}
    }
    return {}


def friction_step(draft: Draft) -> dict[str, float]:
    """A seal that begins to rub in the middle of the campaign."""
    draft.later = {"motor_friction": draft.train["motor_friction"] | {"coulomb": draft.size}}
    return {}


OUTSIDE: dict[str, Hide] = {hide.__name__: hide for hide in (roller_ripple, second_mass, friction_patch, friction_step)}

PULLED = ("gravity_error", "payload", "torque_constant_error", "load_dependent_friction", "transmission_error")
"""Only an axis that carries weight shows them."""

BY_TEST_MASS = ("payload", "torque_constant_error")
"""No sweep tells them apart; a known mass does."""

PAIRS = (
    ("coulomb_friction", "cogging_torque"),
    ("coulomb_friction", "measurement_delay"),
    ("coulomb_friction", "gravity_error"),
    ("coulomb_friction", "joint_elasticity"),
    ("asymmetric_friction", "measurement_delay"),
    ("asymmetric_friction", "gravity_error"),
    ("stribeck_friction", "gravity_error"),
    ("stribeck_friction", "cogging_torque"),
    ("load_dependent_friction", "cogging_torque"),
    ("friction_temperature_drift", "measurement_delay"),
    ("presliding_hysteresis", "effort_offset"),
    ("presliding_hysteresis", "cogging_torque"),
    ("hose_spring", "coulomb_friction"),
    ("hose_spring", "joint_elasticity"),
    ("cogging_torque", "joint_elasticity"),
    ("nonlinear_viscous_friction", "cogging_torque"),
    ("effort_offset", "measurement_delay"),
    ("transmission_error", "coulomb_friction"),
)


def _rated(draft: Draft) -> float:
    return draft.nominal.axes[draft.index].rated_effort


def _share(draft: Draft) -> float:
    """Size over rated effort."""
    return draft.size / _rated(draft)


def _arm(draft: Draft) -> tuple[str, ...]:
    """The links that an axis lifts, the nearest two."""
    return ("link_2", "link_3") if draft.joint == "joint_2" else ("link_3", "link_4")


def _scale_links(draft: Draft, links: tuple[str, ...]) -> None:
    """Deviations of mass and centre scaled to a gravity error of `size`: nearly linear, so a few rounds do."""
    changed = {link: dict(draft.links[link]) for link in links}
    for link in links:
        draft.links[link] = draft.links[link] | {"shift": (0.0, 0.0, 0.0), "mass": 1.0}
    bare, factor = draft.gravity(), 1.0
    for _ in range(4):
        for link in links:
            shift = tuple(float(factor * x) for x in changed[link]["shift"])
            draft.links[link] |= {"shift": shift, "mass": max(0.3, 1 + factor * (changed[link]["mass"] - 1))}
        factor *= draft.size / float(np.abs(draft.gravity() - bare).max())


def _turns(draft: Draft) -> list[Turn]:
    turns: list[Turn] = []
    for design in draft.designs:
        spec, sines = design.spec, tuple((s.frequency, s.amplitude, s.phase) for s in design.spec.sines)
        wave = Waveform(spec.offset_velocity, sines, spec.period or 1.0, spec.periods or 1, design.ramp, design.settle)
        turns.append(Turn(spec.started_at, 0.01, wave.velocity(np.arange(0.0, wave.duration, 0.01))))
    return turns
