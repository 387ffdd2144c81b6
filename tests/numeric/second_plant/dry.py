"""Dry friction of a draft: bristles and sliders that begin as an earlier motion left them, and friction that warms."""

import numpy as np

from tests.numeric.second_plant.draft import Draft, Hidden
from tests.numeric.second_plant.friction import Bristle, Level, Sliders


def bristle(draft: Draft, level: Level, reach: float) -> Bristle:
    return Bristle(level, reach, draft.each(-0.5, 0.5))


def sliders(draft: Draft, level: Level, reach: float) -> Sliders:
    """Eight, yielding from a quarter of `reach` to four times it."""
    reaches = reach * np.geomspace(0.25, 4.0, 8)[:, None]
    parts = draft.random.uniform(0.5, 1.5, (8, 1))
    shares = np.repeat(draft.each(-0.5, 0.5)[None], 8, axis=0)
    return Sliders(level, reaches, parts / parts.sum(), shares)


def effect_of_warmth(draft: Draft) -> Hidden:
    """Heat comes of what friction has dissipated, and goes as to cooler air: C dT/dt = P - T / R.

    Dry friction falls as exp(-a T), viscous as an oil's (also an exponential); T in units in which the hottest is one.
    """
    law = str(draft.random.choice(["dry", "viscous", "both"]))
    specs = draft.plan.specs
    pace = draft.random.uniform(0.3, 1.5) * specs[draft.drawn - 1].started_at
    power = np.square(draft.wanted.velocity).mean(axis=0) * draft.viscous
    warm, now, result = 0.0, 0.0, []
    for spec, heat in zip(specs, power, strict=True):
        warm *= np.exp(-(spec.started_at - now) / pace)
        now = spec.started_at
        result.append(warm)
        warm += float(heat) * draft.plan.duration
    warmth = np.array(result) / max(result[: draft.drawn])
    lost = {"dry": 0.0, "viscous": 0.0}
    parameters: dict[str, object] = {"law": law, "time_constant": pace}
    companions: tuple[str, ...] = ()
    for kind in ("dry", "viscous"):
        lost[kind] = draft.size * {"dry": (1.0, 0.0), "viscous": (0.0, 1.0), "both": (0.6, 0.4)}[law][kind == "viscous"]
    if lost["dry"]:
        cold = lost["dry"] * draft.random.uniform(1.5, 3.0)
        levels = cold * np.exp(np.log1p(-lost["dry"] / cold) * warmth)
        draft.train.dry.append(bristle(draft, lambda now: levels, 2e-6))
        parameters |= {"level_cold": cold, "level_lost": lost["dry"]}
        companions = ("coulomb_friction", "presliding_hysteresis")
    if lost["viscous"]:
        share = min(lost["viscous"] / (draft.viscous * 3 * draft.slow), 0.6)
        fade = np.exp(np.log1p(-share) * warmth) / np.exp(np.log1p(-share) * 0.5)  # the mean is the nominal's
        draft.train.viscous_motor = draft.train.viscous_motor * fade
        draft.train.viscous_load = draft.train.viscous_load * fade
        parameters |= {"viscous_lost": share}
    return Hidden(parameters, companions)
