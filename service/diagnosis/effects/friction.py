"""Effects of friction."""

from collections.abc import Mapping, Sequence

import numpy as np

from service.diagnosis.effects.effect import (
    CatalogueEffect,
    Inexpressible,
    Model,
    Patch,
    Shape,
    ShapeParameter,
    dry,
    named,
    positive,
    spread,
)
from service.diagnosis.rows.signals import Tracks, bristles
from service.model import Array

COULOMB_FRICTION = CatalogueEffect(
    name="coulomb_friction",
    physics="tau = Fc sign(v)",
    source="Coulomb 1785; Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30 (1994), sec. 2",
    sentence="Dry friction of the same size at every speed opposes the motion.",
    visible_in=("backward_slow", "reversal"),
    entry="motor_friction.coulomb",
    coefficients=named(("coulomb", "N m")),
    columns=lambda tracks, model, shape: [tracks.direction],
    scenario=lambda parameters, tracks, model: dry(parameters["coulomb"]),
    possible=lambda parameters, tracks, model: parameters["coulomb"] > 0,
)


def _asymmetric_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    mean, half, viscous = (parameters[k] for k in ("coulomb", "coulomb_difference", "viscous_difference"))
    return dry(mean + half, mean - half, viscous=viscous, backward_viscous=-viscous)


def _asymmetric_possible(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> bool:
    """Whether friction is positive in each direction; otherwise the effect is an offset."""
    return parameters["coulomb"] >= 0 and abs(parameters["coulomb_difference"]) <= 1.05 * parameters["coulomb"]


ASYMMETRIC_FRICTION = CatalogueEffect(
    name="asymmetric_friction",
    physics="tau = Fc sign(v) + Fd |sign(v)| + bd |v|; Fc + Fd forward, Fc - Fd backward",
    source="Janot, Gautier and Brunot, Data set and reference models of EMPS (2019), direction-dependent friction",
    sentence="The axis rubs more in one direction than in the other.",
    visible_in=("backward_slow", "backward_fast"),
    entry="motor_friction.backward_coulomb, backward_viscous",
    coefficients=named(("coulomb", "N m"), ("coulomb_difference", "N m"), ("viscous_difference", "N m s/rad")),
    contains=("coulomb_friction", "effort_offset"),
    columns=lambda tracks, model, shape: [tracks.direction, np.abs(tracks.direction), np.abs(tracks.velocity)],
    scenario=_asymmetric_scenario,
    essential=1,
    possible=_asymmetric_possible,
)


def _stribeck_columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    speed, bend = shape
    return [tracks.direction, tracks.direction * np.exp(-((np.abs(tracks.velocity) / speed) ** bend))]


def _stribeck_shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    slow = tracks.speed
    return (
        ShapeParameter("velocity", "rad/s", spread(0.04 * slow, 2.5 * slow, 9), 0.02 * slow, 5 * slow),
        ShapeParameter("exponent", "", (1.0, 2.0), 0.5, 3.0),
    )


def _stribeck_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    extra, velocity = positive(parameters, "extra"), parameters["velocity"]
    stribeck = {"extra": extra, "velocity": velocity, "exponent": parameters["exponent"]}
    return dry(parameters["coulomb"], stribeck=stribeck)


STRIBECK_FRICTION = CatalogueEffect(
    name="stribeck_friction",
    physics="tau = (Fc + Fs exp(-|v/vs|^n)) sign(v)",
    source="Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30 (1994), eq. (6)",
    sentence="Friction is larger at the slowest speeds and falls as the axis gets faster.",
    visible_in=("forward_slow", "forward_fast", "backward_fast", "reversal"),
    entry="motor_friction.stribeck",
    coefficients=named(("coulomb", "N m"), ("extra", "N m")),
    contains=("coulomb_friction",),
    columns=_stribeck_columns,
    scenario=_stribeck_scenario,
    essential=1,
    possible=lambda parameters, tracks, model: (
        parameters["extra"] > 0 and parameters["coulomb"] > -0.5 * parameters["extra"]
    ),
    shape=_stribeck_shape,
)


def _viscous_columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    velocity, exponent = shape
    return [law(tracks.velocity, velocity, exponent)]


def law(speed: Array, velocity: float, exponent: float) -> Array:
    """Carreau's law x (1 + x^2)^((n - 1)/2), x = v/v0: linear below v0, power n of the speed above; n = 1: linear."""
    ratio = speed / velocity
    return ratio * (1 + ratio**2) ** ((exponent - 1) / 2)


def _viscous_shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    bend = 0.05  # of the slowest speed: below, the law is a pure power of the speed
    slow, fast = tracks.speed, float(np.abs(tracks.velocity).max())
    return (
        ShapeParameter("velocity", "rad/s", spread(bend * slow, fast, 5), 0.02 * bend * slow, 2 * fast),
        ShapeParameter("exponent", "", (0.0, 0.4, 0.7, 1.5, 2.0), -0.5, 3.0),
    )


def _viscous_possible(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> bool:
    """Whether friction is positive at all measured speeds, and the law is not a step (that would be dry friction)."""
    slow = tracks.speed
    near, at = law(np.array([slow / 10, slow]), parameters["velocity"], parameters["exponent"])
    # 0.8 torque at a tenth of the slowest speed over that at the slowest speed: above, the law is a step
    if near > 0.8 * at:
        return False
    speed = np.linspace(0.0, float(np.abs(tracks.velocity).max()), 20)[1:]
    torque = parameters["coefficient"] * law(speed, parameters["velocity"], parameters["exponent"])
    return bool(np.all(torque + model.viscous * speed > 0))


def _viscous_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """In the scenario the law is a power of the speed."""
    if parameters["velocity"] > tracks.speed or parameters["coefficient"] <= 0:
        raise Inexpressible("friction that thins by shear is no power of the speed")
    exponent = parameters["exponent"]
    power = {"coefficient": parameters["coefficient"] / parameters["velocity"] ** exponent, "exponent": exponent}
    return {"train": {"motor_friction": {"power": power}}}


NONLINEAR_VISCOUS_FRICTION = CatalogueEffect(
    name="nonlinear_viscous_friction",
    physics="tau = c x (1 + x^2)^((n - 1)/2), x = v/v0",
    source="Carreau, Trans. Soc. Rheology 16 (1972); Waiboer, Aarts and Jonker, IDETC 2005, lubricated robot joints",
    sentence="Friction does not grow in proportion to the speed.",
    visible_in=("forward_fast", "backward_fast"),
    entry="motor_friction.power",
    coefficients=named(("coefficient", "N m")),
    columns=_viscous_columns,
    scenario=_viscous_scenario,
    shape=_viscous_shape,
    possible=_viscous_possible,
)


def _by_load_columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    torque, knee = model.transmitted(tracks.acceleration), shape[0]
    grows = np.hypot(torque, knee) - knee
    return [tracks.direction, tracks.direction * grows, tracks.direction * torque**2 / knee]


def _by_load_shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    torque = float(np.abs(model.gravity).max()) or tracks.robot.axis(tracks.joint).rated_effort
    return (ShapeParameter("knee", "N m", (0.02 * torque, 0.3 * torque, torque), 1e-3 * torque, 5 * torque),)


def _by_load_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    return dry(parameters["coulomb"], load_dependence=positive(parameters, "load_dependence"))


LOAD_DEPENDENT_FRICTION = CatalogueEffect(
    name="load_dependent_friction",
    physics="tau = (Fc + eta (sqrt(Ts^2 + T1^2) - T1) + e Ts^2 / T1) sign(v), Ts the torque through the gear, "
    "T1 the knee",
    source="Hamon, Gautier and Garrec, IROS 2010, Dynamic identification of robots with a dry friction model",
    sentence="Friction grows with the torque that the gear transmits.",
    visible_in=("backward_slow", "forward_slow"),
    entry="motor_friction.load_dependence",
    coefficients=named(("coulomb", "N m"), ("load_dependence", ""), ("load_curvature", "")),
    contains=("coulomb_friction",),
    columns=_by_load_columns,
    of_model=True,
    scenario=_by_load_scenario,
    essential=1,
    shape=_by_load_shape,
    possible=lambda parameters, tracks, model: parameters["load_dependence"] + parameters["load_curvature"] > 0,
)


def warmth(tracks: Tracks, time_constant: float, exponent: float = 1.0) -> Array:
    """Temperature (n, t) of a gear that is heated by a power of its speed and cools with a time constant. Unit: rad (m)
    for exponent 1 (heat of dry friction: the distance); rad^2/s for exponent 2 (heat of viscous friction).
    """
    heat = np.zeros_like(tracks.velocity)
    step = 1 / tracks.rate
    keep = float(np.exp(-step / time_constant))
    level, clock = 0.0, 0.0
    ages = np.power(keep, np.arange(1.0, heat.shape[1] + 1))
    for row in sorted(range(len(tracks.specs)), key=lambda k: tracks.specs[k].started_at):
        spec, count = tracks.specs[row], int(tracks.inside[row].sum())
        level *= np.exp(-max(spec.started_at - clock, 0.0) / time_constant)
        # T_n = keep T_{n-1} + |v_n| step, in closed form to avoid a loop over samples
        gains = np.abs(tracks.velocity[row, :count]) ** exponent * step
        gained = np.multiply(np.cumsum(np.divide(gains, ages[:count])), ages[:count])
        heat[row, :count] = level * ages[:count] + gained
        heat[row, count:] = heat[row, count - 1]
        level, clock = float(heat[row, count - 1]), spec.started_at + count * step
    return heat


def _drift_columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    warm = warmth(tracks, *shape)
    return [tracks.direction, tracks.direction * warm, tracks.velocity * warm]


def _drift_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """In the scenario, dissipated power heats the gear, not distance: with capacity = power / speed, it is 1 K/rad.

    Friction decreases as exp(-loss T); the column is the tangent of that.
    """
    coulomb, change = positive(parameters, "coulomb"), parameters["coulomb_change"]
    if change >= 0:
        raise Inexpressible(f"coulomb_change = {change:.3g} is not below 0: friction that grows with warmth")
    speed = np.abs(tracks.velocity)
    typical = float(np.sum(speed**2) / np.sum(speed))
    warming = {
        "heat_capacity": coulomb + model.viscous * typical,
        "time_constant": parameters["time_constant"],
        "coulomb_loss": -change / coulomb,
        "viscous_loss": -parameters["viscous_change"] / model.viscous if model.viscous > 0 else 0.0,
    }
    return {"train": {"motor_friction": {"coulomb": coulomb, "backward_coulomb": coulomb}, "warming": warming}}


def _drift_shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    return (
        ShapeParameter("time_constant", "s", spread(20.0, 5000.0, 6), 10.0, 1e4),
        ShapeParameter("heating_exponent", "", (1.0, 2.0), 1.0, 2.0),
    )


def _drift_possible(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> bool:
    """Whether dry friction is positive (against the motion), cold and warm."""
    warm = float(warmth(tracks, parameters["time_constant"], parameters["heating_exponent"]).max())
    # 0.003 of the rated effort: dry friction this little below 0 counts as zero
    least = -0.003 * tracks.robot.axis(tracks.joint).rated_effort
    return min(parameters["coulomb"], parameters["coulomb"] + parameters["coulomb_change"] * warm) > least


def _drift_lasts(tracks: Tracks) -> bool:
    return float(np.ptp([spec.started_at for spec in tracks.specs])) > 20.0


FRICTION_TEMPERATURE_DRIFT = CatalogueEffect(
    name="friction_temperature_drift",
    physics="tau = (Fc + fc T) sign(v) + fv T v, T' = |v| - T/tau",
    source="Simoni et al., IEEE/ASME Trans. Mechatronics 20 (2015), friction of robot joints with temperature",
    sentence="Friction changes as the axis warms up.",
    visible_in=("revisit_forward_slow", "revisit_backward_slow"),
    entry="warming",
    coefficients=named(("coulomb", "N m"), ("coulomb_change", "N m/rad"), ("viscous_change", "N m s/rad2")),
    contains=("coulomb_friction",),
    columns=_drift_columns,
    scenario=_drift_scenario,
    essential=1,
    possible=_drift_possible,
    shape=_drift_shape,
    applies=_drift_lasts,
    of_time=True,
)


SPREAD = (0.25, 0.5, 2.0, 4.0)  # times the distance: bristles of different stiffness, as in the Iwan model


def _presliding_columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    state, *spread = bristles(tracks.position, [shape[0] * factor for factor in (1.0, *SPREAD)])
    return [state, np.gradient(state, axis=1) * tracks.rate * shape[0], *spread]


def _presliding_shape(tracks: Tracks, model: Model) -> tuple[ShapeParameter, ...]:
    way = tracks.speed / (2 * np.pi)
    # 1.0 times the distance within which sticking friction reverses: shorter is no presliding
    least = max(2e-3 * way, 1.0 * tracks.turning)
    return (ShapeParameter("way", "rad", spread(least, max(way, 3 * least), 8), least, max(3 * way, 9 * least)),)


def _presliding_level(parameters: Mapping[str, float]) -> float:
    """Friction level of all bristles together, N m."""
    return sum(parameters[name] for name in parameters if name.startswith("coulomb"))


def _presliding_possible(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> bool:
    """Bristles that push with more than all together oppose are a reversal at the wrong instant, not presliding.

    Without a reversal all bristles oppose the one motion, and only their sum is determined.
    """
    pushing = 3.0  # times the level: the bristles approximate other hysteresis laws with less
    level = _presliding_level(parameters)
    least = min(parameters[name] for name in parameters if name.startswith("coulomb"))
    return level > 0 and (tracks.one_way or least > -pushing * level)


def _presliding_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """LuGre bristles that break away at the Coulomb friction are equal to those of Dahl."""
    coulomb = _presliding_level(parameters)
    if coulomb <= 0:
        raise Inexpressible(f"dry friction = {coulomb:.3g} is not above 0")
    bristles = {"stiffness": coulomb / parameters["way"], "damping": parameters["damping"], "coulomb": coulomb}
    return {"train": {"lugre": bristles | {"breakaway": coulomb, "stribeck_velocity": tracks.speed}}}


PRESLIDING_HYSTERESIS = CatalogueEffect(
    name="presliding_hysteresis",
    physics="tau = Fc z + s dz/dt, dz/dx = (1 - z sign(v)) / x0; some bristles at a quarter and at four times the way",
    source="Dahl 1968; Canudas de Wit, Olsson, Astrom and Lischinsky, IEEE Trans. Automatic Control 40 (1995)",
    sentence="Friction first gives like a spring: after each reversal it builds up over a short way.",
    visible_in=("reversal",),
    entry="lugre",
    coefficients=named(
        ("coulomb", "N m"), ("damping", "N m s/rad"), *((f"coulomb_{factor:g}", "N m") for factor in SPREAD)
    ),
    contains=("coulomb_friction",),
    columns=_presliding_columns,
    scenario=_presliding_scenario,
    shape=_presliding_shape,
    possible=_presliding_possible,
)
