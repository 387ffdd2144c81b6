"""Effects of the measurement: delay, zero point, torque constant."""

from collections.abc import Mapping, Sequence

import numpy as np

from service.diagnosis.effects.effect import CatalogueEffect, Model, Patch, Readout, Shape, ShapeParameter, named
from service.diagnosis.rows.rigid import load_rows, nominal_parameters
from service.diagnosis.rows.signals import PaddedSpectrum, Tracks, spectrum
from service.model import Array


def _delay_columns(tracks: Tracks, model: Model, shape: Shape) -> Sequence[Array]:
    """Columns per second of delay, so that the coefficient is the delay."""
    delay = shape[0]
    late = np.divide(np.exp(-tracks.laplace * delay) - 1, delay, dtype=np.complex128)
    turning = model.inertia[:, None] * tracks.turned_over
    total = tracks.spectra["velocity"] * model.viscous + spectrum(model.gravity, tracks.rate)
    return [(PaddedSpectrum(total.first, total.away + turning) * late).signal(tracks.velocity.shape[1])]


def _delay_scenario(parameters: Mapping[str, float], tracks: Tracks, model: Model) -> Patch:
    """A torque that is early is equivalent to a speed that is late. The delay of the position is neglected."""
    delay = parameters["delay"]
    return {"measurement": {"effort_delay": delay} if delay >= 0 else {"velocity_delay": -delay}}


MEASUREMENT_DELAY = CatalogueEffect(
    name="measurement_delay",
    physics="tau(t - T) - tau(t) = -T tau' + ...",
    source="Pintelon and Schoukens, System Identification (2012), sec. 13.6: delay between channels",
    sentence="Torque and motion are not of the same instant: one channel comes late.",
    visible_in=("wide",),
    entry="measurement.effort_delay, velocity_delay",
    coefficients=named(("delay", "s")),
    columns=_delay_columns,
    of_model=True,
    late=True,
    scenario=_delay_scenario,
    shape=lambda tracks, model: (ShapeParameter("expansion_point", "s", (-4e-3, -1e-3, 1e-3, 4e-3), -2e-2, 2e-2),),
)


EFFORT_OFFSET = CatalogueEffect(
    name="effort_offset",
    physics="tau = c",
    source="Gautier and Briot, J. Dyn. Sys. Meas. Control 136 (2014), offset of the current sensor",
    sentence="The drive tells a constant torque too much, in either direction.",
    visible_in=("forward_slow", "backward_slow"),
    entry="effort_offset",
    coefficients=named(("offset", "N m")),
    columns=lambda tracks, model, shape: [np.ones_like(tracks.velocity)],
    scenario=lambda parameters, tracks, model: {"train": {"effort_offset": parameters["offset"]}},
)


def _gain_readout(tracks: Tracks, change: Array, covariance: Array) -> Readout:
    robot, index = tracks.robot, tracks.robot.index(tracks.joint)
    nominal = load_rows(robot, index, tracks.poses) @ nominal_parameters(robot)
    weight = np.repeat(tracks.sizes**2, len(tracks.poses)) * nominal
    weight /= weight @ nominal
    return {"gain_error": (float(weight @ change.ravel()), float(np.sqrt(max(weight @ covariance @ weight, 0.0))), "")}


TORQUE_CONSTANT_ERROR = CatalogueEffect(
    name="torque_constant_error",
    physics="tau = e (J a + b v + gravity); CAD's prior alone tells e from other links",
    source="Gautier and Briot, J. Dyn. Sys. Meas. Control 136 (2014), Global identification of joint drive gains",
    sentence="The drive's torque constant is wrong: all torques are told too large or too small.",
    visible_in=("forward_slow", "backward_slow"),
    entry="effort_gain",
    readout=_gain_readout,
    scenario=lambda parameters, tracks, model: {"train": {"effort_gain": parameters["gain_error"]}},
    by_test_mass=True,
    by_load=True,
    possible=lambda parameters, tracks, model: parameters["gain_error"] > -1,
)
