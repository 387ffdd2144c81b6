"""What may be hidden, by the names of the catalogue; each with several laws, none of them drawn from the catalogue.

Each function puts an effect of about `draft.size` into a draft and returns what the truth says of it.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from service.model.counterbalance import Counterbalance
from tests.numeric.second_plant.bodies import Cylinder
from tests.numeric.second_plant.draft import REACH, Draft, Hidden, steady
from tests.numeric.second_plant.dry import bristle, effect_of_warmth, sliders
from tests.numeric.second_plant.friction import Level
from tests.numeric.second_plant.laws import Hose, Law, Waves, Wobble
from tests.numeric.second_plant.machine import Spring
from tests.numeric.second_plant.robots import Body, Mechanism, block, joined

Array = NDArray[np.float64]

STUCK = ("presliding_hysteresis",)  # what a bristle brings
DRY = ("coulomb_friction", "presliding_hysteresis")
MORE = 1.6


def coulomb_friction(draft: Draft) -> Hidden:
    reach = 2e-6 if draft.random.random() < 0.7 else 10 ** draft.random.uniform(-6.0, -5.0)
    draft.train.dry.append(bristle(draft, steady(draft.even(draft.size)), reach))
    return Hidden({"level": draft.size, "bristle": reach}, STUCK)


def asymmetric_friction(draft: Draft) -> Hidden:
    """Another level and another slope each way."""
    mean, way = draft.size * draft.random.uniform(0.8, 1.6), draft.random.choice([-1.0, 1.0])
    forward, backward = mean + way * draft.size / 2, mean - way * draft.size / 2
    unlike = float(draft.random.choice([0.0, 1.0]) * draft.random.uniform(-0.15, 0.15)) + 0.0
    draft.train.dry.append(bristle(draft, lambda now: np.where(now.velocity > 0, forward, backward), 2e-6))
    if unlike:
        slope = unlike * draft.viscous
        draft.train.on_motor.append(Law(lambda now: slope * np.abs(now.velocity)))
    return Hidden({"forward": forward, "backward": backward, "viscous_asymmetry": unlike}, DRY)


def stribeck_friction(draft: Draft) -> Hidden:
    """Exponential of any power (Bo and Pavelescu), or the hyperbola of Hess and Soom."""
    sliding, extra = draft.size * draft.random.uniform(0.8, 1.8), draft.size
    speed = draft.slow * draft.random.uniform(0.3, 1.0)
    if draft.random.random() < 0.3:
        law = "hess_soom"
        exponent = 2.0
        level: Level = lambda now: sliding + extra / (1.0 + np.square(now.velocity / speed))  # noqa: E731
    else:
        law, exponent = "exponential", draft.random.uniform(0.5, 2.0)
        level = lambda now: sliding + extra * np.exp(-((np.abs(now.velocity) / speed) ** exponent))  # noqa: E731
    draft.train.dry.append(bristle(draft, level, 2e-6))
    parameters = {"law": law, "sliding": sliding, "static": sliding + extra, "velocity": speed, "exponent": exponent}
    return Hidden(parameters, DRY)


def nonlinear_viscous_friction(draft: Draft) -> Hidden:
    """Eyring, power law, or a saturating film, `MORE` times `size` at the fastest; small ones are as small as what the
    best straight line leaves of them.
    """
    law = str(draft.random.choice(["eyring", "power", "tanh", "quadratic"]))
    bend = draft.slow * draft.random.uniform(0.7, 2.0)
    exponent = draft.random.uniform(0.4, 0.7) if draft.random.random() < 0.5 else draft.random.uniform(1.5, 2.2)
    laws: dict[str, Callable[[Array], Array]] = {
        "eyring": lambda v: np.arcsinh(v / bend),
        "power": lambda v: np.sign(v) * np.abs(v / bend) ** exponent,
        "tanh": lambda v: np.tanh(v / bend),
        "quadratic": lambda v: v * np.abs(v) / bend**2,
    }
    speeds = np.linspace(0.2 * draft.slow, draft.fastest, 60)
    shape = laws[law](speeds)
    left = float(np.abs(shape - speeds * (shape @ speeds) / (speeds @ speeds)).max())
    torque = draft.size / left if draft.size_class == "small" else MORE * draft.size / float(shape[-1])
    draft.train.on_motor.append(Law(lambda now: torque * laws[law](now.velocity)))
    return Hidden({"law": law, "torque": torque, "velocity": bend, "exponent": exponent if law == "power" else None})


def load_dependent_friction(draft: Draft) -> Hidden:
    """Of what the gear carries, inertia included: added to the dry level, or its root of squares."""
    dry = draft.size * draft.random.uniform(0.3, 1.0)
    share = draft.size / draft.weight()
    law = str(draft.random.choice(["sum", "root", "saturating"]))
    knee = draft.weight()
    laws: dict[str, Level] = {
        "sum": lambda now: dry + share * np.abs(now.load),
        "root": lambda now: np.sqrt(dry**2 + np.square(share * now.load)),
        "saturating": lambda now: dry + 1.5 * share * np.abs(now.load) / (1.0 + 0.5 * np.abs(now.load) / knee),
    }
    draft.train.dry.append(bristle(draft, laws[law], 2e-6))
    return Hidden({"law": law, "level": dry, "load_share": share}, DRY)


def friction_temperature_drift(draft: Draft) -> Hidden:
    """Dry or viscous friction, or both, lose `size` from the first to the last sweep."""
    return effect_of_warmth(draft)


def gravity_error(draft: Draft) -> Hidden:
    """A centre of mass far beyond the prior: weight pulls elsewhere than the bodies say, their inertia is as it was."""
    beyond = {"small": (4.0, 5.0), "medium": (6.0, 9.0), "large": (9.0, 16.0)}[draft.size_class]
    amount = 0.03 * draft.weight() * draft.random.uniform(*beyond)
    axis = np.array(draft.built.joints[draft.index].axis)
    way = np.cross(axis, draft.random.normal(size=3))
    way /= np.linalg.norm(way)
    before = draft.train.gravity

    def shifted(metres: float) -> Draft:
        bodies = list(draft.built.bodies)
        bodies[draft.index] = replace(bodies[draft.index], centre=bodies[draft.index].centre + metres * way)
        draft.train.gravity = draft.curve(replace(draft.built, bodies=tuple(bodies)))
        return draft

    unit = draft.drawn_for(np.abs(shifted(0.1).train.gravity.values - before.values)).max()
    metres = 0.1 * amount / float(unit)
    shifted(metres)
    moment = draft.built.bodies[draft.index].mass * metres * way
    return Hidden({"torque": amount, "moment": moment.tolist()})


def payload(draft: Draft) -> Hidden:
    """A block at the flange that CAD knows nothing of, sized against what the prior of weight could take."""
    more = {"small": (0.12, 0.18), "medium": (0.25, 0.4), "large": (0.4, 0.7)}[draft.size_class]
    wanted = draft.weight() * draft.random.uniform(*more)
    bare, before = draft.built, draft.train.gravity.values
    out = np.array([0.0, 0.0, 0.05]) + draft.random.uniform(-0.12, 0.12, 3)
    unit: Body = block(1.0, tuple((bare.flange + out).tolist()), (0.25, 0.25, 0.2), draft.random)

    def loaded(mass: float) -> None:
        body = replace(unit, mass=mass, spread=mass * unit.spread)
        draft.rebuild(replace(bare, bodies=(*bare.bodies[:-1], joined(bare.bodies[-1], body))))

    loaded(1.0)
    mass = wanted / float(draft.drawn_for(np.abs(draft.train.gravity.values - before)).max())
    loaded(mass)
    return Hidden({"mass": mass, "com": (unit.centre - bare.flange).tolist()})


def torque_constant_error(draft: Draft) -> Hidden:
    """The drive tells more or less than it gives, a little less in saturation."""
    share = {"small": (0.06, 0.08), "medium": (0.10, 0.14), "large": (0.14, 0.22)}[draft.size_class]
    error = float(draft.random.choice([-1.0, 1.0]) * draft.random.uniform(*share))
    bend = draft.random.uniform(0.0, 0.004)
    rated = draft.rated
    draft.after.append(lambda effort, _: (1.0 + error) * effort * (1.0 - bend * np.square(effort / rated)))
    return Hidden({"gain_error": error, "saturation": bend})


def hose_spring(draft: Draft) -> Hidden:
    starts = draft.starts
    rest = float(draft.random.uniform(starts.min(), starts.max()))
    far = float(np.abs(starts - rest).max())
    hardening = _often_none(draft, 0.3)
    hard = far / np.sqrt(hardening) if hardening else np.inf
    stiffness = draft.size / (far * (1.0 + hardening))
    damping = stiffness * draft.random.uniform(0.02, 0.1)
    draft.train.on_load.append(Hose(stiffness, rest, float(hard), damping))
    return Hidden({"stiffness": stiffness, "rest": rest, "damping": damping, "hardening": hardening / far**2})


def counterbalance(draft: Draft) -> Hidden:
    """Between two points: a coil spring, or a cylinder that compresses gas as it lengthens. The robot file has one that
    is off, or none; of a healthy machine the right one.
    """
    random, joint = draft.random, draft.built.joints[draft.index]
    crank, arm, apart = random.uniform(0.12, 0.3), random.uniform(0.35, 0.7), random.uniform(0.0, 0.1)
    toppling = draft.toppling() + random.uniform(-0.15, 0.15)  # pulled towards where the weight topples
    axis, turn = np.array(joint.axis, dtype=float), random.uniform(0, 2 * np.pi)
    aside = np.roll(axis, 1)
    ways = [np.cos(a) * aside + np.sin(a) * np.cross(axis, aside) for a in (turn, turn - toppling)]
    fixed, moved = np.array(joint.origin) + arm * ways[0] + apart * axis, crank * ways[1]
    shortest, stroke = np.hypot(arm - crank, apart), np.hypot(arm + crank, apart) - np.hypot(arm - crank, apart)
    law, middle = str(random.choice(["spring", "gas"])), shortest + stroke / 2
    if law == "gas":
        filled, exponent = random.uniform(0.35, 0.6), random.uniform(1.0, 1.3)
        unit = Cylinder(draft.index, fixed, moved, lambda far: (1 - filled * (far - shortest) / stroke) ** -exponent)
        paper = {"force": (1 - filled / 2) ** -exponent, "exponent": exponent, "column": stroke * (1 / filled - 0.5)}
    else:
        free = shortest * random.uniform(0.3, 0.95)
        unit = Cylinder(draft.index, fixed, moved, lambda far: far - free)
        paper = {"force": middle - free, "rate": 1.0}
    grid = np.linspace(draft.starts.min() - REACH, draft.starts.max() + REACH, 1500)
    torque = unit.holding(draft.built, grid)
    strength = random.uniform(0.3, 0.7) * draft.weight() / float(np.abs(np.interp(draft.starts, grid, torque)).max())
    gravity = draft.train.gravity
    places = gravity.start[:, None] + gravity.step * np.arange(gravity.values.shape[1])
    draft.train.gravity = replace(gravity, values=gravity.values + strength * np.interp(places, grid, torque))
    low, high = {"small": (0.05, 0.1), "medium": (0.1, 0.2), "large": (0.2, 0.4), "none": (0.0, 0.0)}[draft.size_class]
    share = float(random.choice([-1.0, -1.0, -1.0, 1.0]) * random.uniform(low, high))
    missing = draft.size_class == "large" and random.random() < 0.5
    if not missing:
        sized = {key: strength / (1 + share) * paper[key] for key in paper.keys() & {"force", "rate"}}
        draft.on_paper = Counterbalance.model_validate(
            {**paper, **sized, "anchor": fixed.tolist(), "attachment": moved.tolist(), "length": middle}
        )
    return Hidden({"law": law, "share": None if missing else share, "crank": crank, "arm": arm, "zero": toppling})


def parallelogram(draft: Draft) -> Hidden:
    """The drive of a joint sits before the one in front of it and turns its link by two bars, whatever the size."""
    first = draft.index if draft.index in parallel(draft.built) else draft.index - 1
    draft.rebuild(replace(draft.built, linked=first))
    return Hidden({"joint": draft.built.names[first + 1]})


def parallel(mechanism: Mechanism) -> list[int]:
    """The revolute joints whose next one turns about the same direction."""
    return [
        k
        for k, (one, other) in enumerate(pairwise(mechanism.joints))
        if {one.kind, other.kind} == {"revolute"} and abs(np.dot(one.axis, other.axis)) == 1
    ]


def joint_elasticity(draft: Draft) -> Hidden:
    """Two masses; locked rotor of the mean load from 5 Hz (large) to 30 Hz (small)."""
    span = {"small": (20.0, 30.0), "medium": (9.0, 15.0), "large": (5.0, 9.0)}[draft.size_class]
    return _spring(draft, draft.random.uniform(*span), _often_none(draft, 0.2), 0.0)


def measurement_delay(draft: Draft) -> Hidden:
    """The torque is told late: as it was, or through a first-order filter."""
    span = {"small": (0.2e-3, 0.4e-3), "medium": (0.7e-3, 1.5e-3), "large": (1.5e-3, 4e-3)}[draft.size_class]
    delay = draft.random.uniform(*span)
    if draft.random.random() < 0.3 and draft.size_class != "large":
        lag = delay * draft.random.uniform(0.3, 0.7)
        draft.sensors = replace(draft.sensors, effort_delay=delay - lag, effort_lag=lag)
        return Hidden({"law": "filter", "delay": delay, "lag": lag})
    draft.sensors = replace(draft.sensors, effort_delay=delay)
    return Hidden({"law": "pure", "delay": delay})


def cogging_torque(draft: Draft) -> Hidden:
    """Both orders, and side bands one period a turn away, as an eccentric rotor makes them."""
    orders = draft.cogging_orders
    sizes = [draft.size, *(draft.size * draft.random.uniform(0.1, 0.6) for _ in orders[1:])]
    sides = draft.size * draft.random.uniform(0.02, 0.1)
    every = np.array([*orders, orders[0] - 1.0, orders[0] + 1.0])[:, None]
    amplitudes = np.array([*sizes, sides, sides])[:, None]
    phases = draft.random.uniform(0, 2 * np.pi, (len(every), 1))
    draft.train.on_motor.append(Waves(draft.ratio, every, amplitudes, phases))
    told = {"orders": list(orders), "amplitudes": sizes, "phases": phases.ravel()[: len(orders)].tolist()}
    return Hidden({**told, "side_bands": sides})


def transmission_error(draft: Draft) -> Hidden:
    """A ratio that wobbles, where there is weight to feel it by; else friction of the mesh that grows with load."""
    orders = np.array(draft.transmission_orders)[:, None]
    phases = draft.random.uniform(0, 2 * np.pi, (len(orders), 1))
    parts = np.array([1.0, *draft.random.uniform(0.2, 0.8, len(orders) - 1)])[:, None]
    felt = draft.size / (draft.weight() + 1e-9)
    if felt < 0.06 and draft.train.spring is None and draft.random.random() < 0.6:
        errors = felt * parts / (orders * draft.ratio)
        draft.train.on_motor.append(Wobble(draft.ratio, orders, errors, phases, draft.train.load, draft.train.gravity))
        return Hidden({"law": "wobble", "orders": orders.ravel().tolist(), "errors": errors.ravel().tolist()})
    with_load = draft.random.uniform(0.1, 0.5)
    amplitudes = draft.size * parts
    draft.train.on_motor.append(Waves(draft.ratio, orders, amplitudes, phases, with_load, draft.rated))
    amplitudes_told = amplitudes.ravel().tolist()
    return Hidden(
        {"law": "load", "orders": orders.ravel().tolist(), "amplitudes": amplitudes_told, "with_load": with_load}
    )


def presliding_hysteresis(draft: Draft) -> Hidden:
    """A bristle (Dahl) or a row of sliders (Iwan) that yields on a way not much shorter than the reversal's."""
    reach = 10 ** draft.random.uniform(-4.3, -3.4)
    law = str(draft.random.choice(["dahl", "iwan"]))
    make = bristle if law == "dahl" else sliders
    draft.train.dry.append(make(draft, steady(draft.even(draft.size)), reach))
    return Hidden({"law": law, "level": draft.size, "reach": reach}, ("coulomb_friction",))


def backlash(draft: Draft) -> Hidden:
    """Play of a few arc minutes between motor and load, flanks as stiff as gears are."""
    span = {"small": (0.1, 0.2), "medium": (1.0, 2.5), "large": (2.5, 6.0)}[draft.size_class]
    play = np.radians(draft.random.uniform(*span) / 60.0)
    hidden = _spring(draft, draft.random.uniform(60.0, 90.0), 0.0, play / 2)
    return Hidden({"play": play, **hidden.parameters}, ("joint_elasticity",))


def effort_offset(draft: Draft) -> Hidden:
    """Of the current sensor; a little of it comes as the drive warms."""
    offset = float(draft.random.choice([-1.0, 1.0])) * draft.size
    drift, pace = draft.random.choice([-1.0, 1.0]) * _often_none(draft, 0.05), draft.random.uniform(200.0, 600.0)
    begins = np.array([spec.started_at for spec in draft.plan.specs])
    each = offset * (1.0 + drift * (np.exp(-begins / pace) - 0.5))
    draft.after.append(lambda effort, _: effort + each)
    return Hidden({"offset": offset, "drift": drift})


def _often_none(draft: Draft, most: float) -> float:
    """A nonlinearity, absent in two cases of five."""
    return float(draft.random.choice([0.0, 1.0], p=[0.4, 0.6]) * draft.random.uniform(0.0, most))


def _spring(draft: Draft, frequency: float, hardening: float, play: float) -> Hidden:
    load = float(draft.drawn_for(draft.train.load).mean())
    stiffness = load * (2 * np.pi * frequency) ** 2
    ratio = draft.random.uniform(0.02, 0.06)
    twist = (draft.weight() + 0.1 * draft.rated) / stiffness
    hard = twist / np.sqrt(hardening) if hardening else np.inf
    draft.train.spring = Spring(
        np.array([stiffness]), np.array([2 * ratio * np.sqrt(stiffness * load)]), float(hard), play
    )
    return Hidden({"locked_rotor": frequency, "stiffness": stiffness, "damping_ratio": ratio, "hardening": hardening})


CATALOGUE: dict[str, Callable[[Draft], Hidden]] = {
    effect.__name__: effect
    for effect in (
        coulomb_friction, asymmetric_friction, stribeck_friction, nonlinear_viscous_friction, load_dependent_friction,
        friction_temperature_drift, gravity_error, hose_spring, joint_elasticity, measurement_delay, cogging_torque,
        transmission_error, presliding_hysteresis, backlash, effort_offset, torque_constant_error, payload,
        counterbalance, parallelogram,
    )
}  # fmt: skip

# a prior of 30 % would take all of it
TIGHT = ("gravity_error", "torque_constant_error", "payload", "counterbalance", "parallelogram")
PULLED = ("gravity_error", "payload", "load_dependent_friction", "counterbalance")  # need weight
FREE = ("backlash",)  # need a torque that reverses
TURNING = ("effort_offset",)  # a constant beside a slide's weight is part of its mass
BY_TEST_MASS = ("payload", "torque_constant_error")
FIRST = (
    "parallelogram",
    "payload",
    "gravity_error",
    "joint_elasticity",
    "backlash",
)  # bodies and springs, before what looks at them
