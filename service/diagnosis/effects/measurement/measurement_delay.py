"""Torque and motion in one sample were measured at different times."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from service.diagnosis.effects.effect import Effect, Model, Shape, ShapeParameter, named
from service.diagnosis.effects.patch import Patch
from service.diagnosis.rows.responses import Spectrum, spectrum
from service.diagnosis.rows.signals import Tracks

Array = NDArray[np.float64]


def _columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    """Columns per second of delay, so that the coefficient is the delay."""
    delay = shape[0]
    late = np.divide(np.exp(-tracks.laplace * delay) - 1, delay, dtype=np.complex128)
    turning = model.inertia[:, None] * tracks.turned_over
    total = tracks.spectra["velocity"] * model.viscous + spectrum(model.gravity, tracks.rate)
    return [(Spectrum(total.first, total.away + turning) * late).signal(tracks.velocity.shape[1])]


def _scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """A torque that is early is equivalent to a speed that is late. The delay of the position is neglected."""
    delay = parameters["delay"]
    return {"measurement": {"effort_delay": delay} if delay >= 0 else {"velocity_delay": -delay}}


EFFECT = Effect(
    name="measurement_delay",
    physics="tau(t - T) - tau(t) = -T tau' + ...",
    source="Pintelon and Schoukens, System Identification (2012), sec. 13.6: delay between channels",
    sentence="Torque and motion are not of the same instant: one channel comes late.",
    visible_in=("wide",),
    entry="measurement.effort_delay, velocity_delay",
    coefficients=named(("delay", "s")),
    columns=_columns,
    of_model=True,
    late=True,
    scenario=_scenario,
    shape=lambda tracks, model: (ShapeParameter("expansion_point", "s", (-4e-3, -1e-3, 1e-3, 4e-3), -2e-2, 2e-2),),
)
