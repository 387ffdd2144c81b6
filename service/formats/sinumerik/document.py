"""A file of the control as a document: recording, frequency response, inertia.

A closed speed loop contains no torque. Its inertia in kg m^2 requires the gain of the controller, which the user enters
or the file contains as a parameter (p1460). Without the gain, the result is J/K, in s.
"""

from dataclasses import dataclass

import numpy as np

from service import BadInput
from service.formats.sinumerik.measurement import GAIN, PARAMETERS, LoopMeasurement, Quantity, SpeedController, Tuning
from service.identification.spectra.speed_loop import LoopFit, fit_closed_loop, fit_torque_response
from service.model import Array, Complex
from service.model.results.part import Part

COHERENT = 0.5  # minimum coherence of a line that is used, if the file has a coherence


class Size(Part):
    """A value with one standard deviation."""

    value: float
    std: float


class OverGain(Size):
    """J/K, in s."""

    unit: str


class LoopInertia(Part):
    """On the motor side, kg m^2, and on the axis; null without the controller's gain. `over_gain`: for a closed loop.

    `band`, Hz, and number of `lines` that were used; `ended`: how the iteration ended.
    """

    motor_side: Size | None
    axis_side: Size | None
    axis_unit: str
    over_gain: OverGain | None
    delay: float | None
    band: tuple[float, float]
    lines: int
    misfit_percent: float
    converged: bool
    ended: str


class ResponseColumns(Part):
    """Columns of the frequency response: Hz, real and imaginary part of output over input."""

    frequency: tuple[float, ...]
    re: tuple[float, ...]
    im: tuple[float, ...]
    coherence: tuple[float, ...] | None = None
    frequency_in_file: tuple[float, ...] | None = None


class ExcitationSignal(Part):
    """`sample_interval`, s, `bandwidth`, Hz; amplitude and offset in `unit`."""

    signal: str
    sample_interval: float
    bandwidth: float
    amplitude: float
    unit: str
    offset: float
    offset_rpm: float
    periods_averaged: int
    directions: int


class MeasuredResponse(Part):
    """A frequency response measured by the control; `inertia` from its time series and from its own spectrum."""

    kind: str
    version: str
    axis: str
    measured_at: str
    input: str
    output: str
    excitation: ExcitationSignal
    motor_to_axis: float
    torque_constant: float
    parameters: dict[str, float]
    inertia: dict[str, LoopInertia]
    speed_controller_gain: float | None
    cannot_tell: tuple[str, ...]
    frequencies_too_high_percent: float
    unread: tuple[str, ...]
    frequency_response: ResponseColumns


class ByControl(Part):
    """Values computed by the control, on the motor side: kg m^2, N m s/rad, Hz."""

    motor_inertia: float
    total_inertia: float
    viscous_friction: float
    antiresonance: float | None


class ServoTuning(Part):
    """An automatic servo tuning: the inertia computed by the control, and that computed here from its response."""

    kind: str
    version: str
    axis: str
    measured_at: str
    motor_to_axis: float
    inertia: dict[str, LoopInertia]
    by_control: ByControl
    speed_controllers: tuple[SpeedController, ...]
    cannot_tell: tuple[str, ...]
    unread: tuple[str, ...]
    frequency_response: ResponseColumns


@dataclass(frozen=True, slots=True)
class Given:
    """Data that the user knows in addition to the file: gain of the speed controller, N m s/rad; reset time, s, of an
    integral part that acts on the control error (None: it sees the reference model, or there is none); the gear ratio,
    rad of the motor per rad (m) of the joint, where it is not the one in the file."""

    gain: float | None = None
    reset_time: float | None = None
    gear_ratio: float | None = None


def measurement_document(found: LoopMeasurement, given: Given, place: str) -> MeasuredResponse:
    """`inertia` from its time series and from its own spectrum; BadInput at `place` if neither determines one."""
    ways = {"time_series": _by_series(found, given, place), "spectrum": _by_spectrum(found, given, place)}
    closed = found.input.meaning.quantity is Quantity.SPEED_SETPOINT
    ratio = given.gear_ratio or found.motor_to_axis
    gain = (given.gain or found.parameters.get(GAIN)) if closed else 1.0
    return MeasuredResponse(
        kind="frequency response",
        version=found.version,
        axis=f"axis {found.axis}",
        measured_at=found.measured_at,
        input=found.input.meaning.name,
        output=found.output.meaning.name,
        excitation=ExcitationSignal(
            signal=f"PRBS of order {found.order}, one period of {len(found.output.series[0])} samples",
            sample_interval=found.sample_interval,
            bandwidth=found.bandwidth,
            amplitude=found.amplitude,
            unit=found.input.meaning.unit,
            offset=found.offset,
            offset_rpm=found.offset * 60 / (2 * np.pi),
            periods_averaged=found.periods,
            directions=len(found.output.series),
        ),
        motor_to_axis=ratio,
        torque_constant=found.torque_constant,
        parameters={PARAMETERS[key]: value for key, value in found.parameters.items()},
        inertia={way: _inertia(fit, gain, ratio, found.rotary) for way, fit in ways.items()},
        speed_controller_gain=gain if closed else None,
        cannot_tell=_unknown(found, gain),
        frequencies_too_high_percent=100 * found.axis_error,
        unread=found.unread,
        frequency_response=_response(found),
    )


def tuning_document(found: Tuning, given: Given, place: str) -> ServoTuning:
    """The inertia computed by the control, and that from its response, with a standard deviation."""
    plant, ratio = found.plant, given.gear_ratio or 1 / found.axis_per_motor
    good = np.ones(len(plant.frequency), dtype=bool) if plant.coherence is None else plant.coherence >= COHERENT
    fit = fit_torque_response(
        plant.frequency[good],
        plant.response[good],
        place,
        lowest=found.lowest_frequency,
        antiresonance=found.antiresonance,
        motor_inertia=found.motor_inertia,
    )
    return ServoTuning(
        kind="automatic servo tuning",
        version=found.version,
        axis=found.axis,
        measured_at=found.measured_at,
        motor_to_axis=ratio,
        inertia={"response": _inertia(fit, 1.0, ratio, found.rotary)},
        by_control=ByControl(
            motor_inertia=found.motor_inertia,
            total_inertia=found.total_inertia,
            viscous_friction=found.friction,
            antiresonance=found.antiresonance,
        ),
        speed_controllers=found.regulators,
        cannot_tell=("dry friction and gravity: the response is of small motions about a speed",),
        unread=found.unread,
        frequency_response=_response(found),
    )


def response_table(found: LoopMeasurement | Tuning) -> dict[str, Array]:
    """Columns of the frequency response in the file, at true frequencies."""
    if isinstance(found, Tuning):
        plant = found.plant
        coherence = {} if plant.coherence is None else {"coherence": plant.coherence}
        return {"frequency": plant.frequency, "re": plant.response.real, "im": plant.response.imag, **coherence}
    response = found.spectra.response
    return {
        "frequency": found.frequency,
        "re": response.real,
        "im": response.imag,
        "coherence": found.spectra.coherence,
        "frequency_in_file": found.spectra.frequency,
    }


def _response(found: LoopMeasurement | Tuning) -> ResponseColumns:
    return ResponseColumns.model_validate({name: column.tolist() for name, column in response_table(found).items()})


def recording_table(found: LoopMeasurement) -> dict[str, Array]:
    """Columns of the time series: input and output of each direction, on the motor side."""
    time = np.asarray(np.arange(len(found.output.series[0])) * found.sample_interval, dtype=float)
    columns = {"time": time}
    for number, (inward, outward) in enumerate(zip(found.input.series, found.output.series, strict=True), start=1):
        columns |= {f"input_{number}": inward, f"output_{number}": outward}
    return columns


def _by_series(found: LoopMeasurement, given: Given, place: str) -> LoopFit:
    """Each direction separately, by the DFT of its period; the mean, with at least their difference as uncertainty."""
    fits: list[LoopFit] = []
    for inward, outward in zip(found.input.series, found.output.series, strict=True):
        driven = np.fft.rfft(inward)[1 : len(found.frequency)]
        if np.abs(driven).min() < 1e-6 * np.abs(driven).max():
            raise BadInput(place, "its input has a line without power: not one period of the sequence")
        response = np.fft.rfft(outward)[1 : len(found.frequency)] / driven
        fits.append(_fit(found, found.frequency[1:], response, given, f"{place} time series"))
    values = np.array([fit.inertia for fit in fits])
    apart = float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0
    worst = max(fits, key=lambda fit: fit.inertia_std)
    return LoopFit(
        inertia=float(values.mean()),
        inertia_std=float(np.hypot(worst.inertia_std, apart)),
        friction=float(np.mean([fit.friction for fit in fits])),
        friction_std=worst.friction_std,
        delay=worst.delay,
        band=worst.band,
        lines=worst.lines,
        misfit=worst.misfit,
        converged=all(fit.converged for fit in fits),
        ended=worst.ended,
    )


def _by_spectrum(found: LoopMeasurement, given: Given, place: str) -> LoopFit:
    """From the spectra averaged by the control, at the frequencies in the file."""
    good = found.spectra.coherence >= COHERENT
    good[0] = False
    frequency, response = found.spectra.frequency[good], found.spectra.response[good]
    return _fit(found, frequency, response, given, f"{place} spectrum")


def _fit(found: LoopMeasurement, frequency: Array, response: Complex, given: Given, place: str) -> LoopFit:
    inward, outward = found.input.meaning.quantity, found.output.meaning.quantity
    if outward is not Quantity.SPEED or inward not in (Quantity.SPEED_SETPOINT, Quantity.TORQUE, Quantity.CURRENT):
        raise BadInput(place, f"is of {found.output.meaning.name} over {found.input.meaning.name}: shows no inertia")
    if inward is Quantity.SPEED_SETPOINT:
        return fit_closed_loop(frequency, response, place, given.reset_time)
    if inward is Quantity.CURRENT:
        response = response / found.torque_constant
    return fit_torque_response(frequency, response, place)


def _inertia(fit: LoopFit, gain: float | None, motor_to_axis: float, rotary: bool) -> LoopInertia:
    motor = None if gain is None else Size(value=gain * fit.inertia, std=gain * fit.inertia_std)
    squared = motor_to_axis**2
    return LoopInertia(
        motor_side=motor,
        axis_side=None if motor is None else Size(value=squared * motor.value, std=squared * motor.std),
        axis_unit="kg m^2" if rotary else "kg",
        over_gain=None if fit.delay is None else OverGain(value=fit.inertia, std=fit.inertia_std, unit="s"),
        delay=fit.delay,
        band=fit.band,
        lines=fit.lines,
        misfit_percent=100 * fit.misfit,
        converged=fit.converged,
        ended=fit.ended,
    )


def _unknown(found: LoopMeasurement, gain: float | None) -> tuple[str, ...]:
    missing = (
        "dry friction, gravity and offsets: the response is of small motions about a speed",
        "rotor and load apart: below the first antiresonance they move as one",
    )
    if gain is not None:
        return missing
    torque = (
        "inertia in kg m^2 cannot be computed: the file of a closed speed loop has no torque and no "
        "gain of its controller (p1460, N m s/rad); give it as --speed-gain"
    )
    return (torque, *missing)
