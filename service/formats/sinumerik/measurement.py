"""What a control saved of an axis: a frequency response, or the result of automatic servo tuning.

**Frequency response**, XML root `ResponseTestCustom`: the excitation is a pseudo-random binary sequence of 2^order - 1
samples on a speed offset, run in both directions. A time series is one period of it, averaged by the control; the
spectra are those of the series, averaged over both directions: auto-spectra of the input and of the output, and the
cross-spectrum of output* and input. The lines are at k / (n T), n samples of interval T. The frequencies in the file
are uniform from 0 to the bandwidth: 0.15 % too high for order 11, `axis_error`.

**Servo tuning** (AST), XML root `DynamicModelAxisController`, contains the model of the speed controller: inertia of
the rotor, total inertia and friction as identified by the control, zeros of the mechanics, the measured response of
speed to torque with its coherence, and the controller's settings before and after. The control gives no uncertainty.

The number of a signal is that of its display parameter (SINAMICS S120/S150 List Manual): r0061 is the actual speed.
Numbers that occur in no available file are not guessed.
"""

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from service import BadInput
from service.formats.sinumerik.members import Member
from service.model import Array, Complex
from service.model.results.part import Part

DRIVE, CONTROL = 5, 6  # platforms of signals and parameters

GAIN = (DRIVE, 1460)
PARAMETERS = {
    GAIN: "p1460 speed controller gain, N m s/rad",
    (DRIVE, 1462): "p1462 speed controller reset time, ms",
    (DRIVE, 1656): "p1656 current set-point filters active",
    (CONTROL, 32200): "MD32200 position controller gain",
    (CONTROL, 32500): "MD32500 friction compensation active",
    (CONTROL, 36000): "MD36000 exact stop coarse, mm or deg",
    (CONTROL, 36010): "MD36010 exact stop fine, mm or deg",
    (CONTROL, 36030): "MD36030 standstill tolerance, mm or deg",
    (CONTROL, 36400): "MD36400 contour monitoring tolerance, mm or deg",
}
TUNING = "DynamicModelAxisController"


class Quantity(Enum):
    """A quantity on the motor side; units of a linear motor are m/s and N."""

    SPEED = "speed"  # rad/s
    SPEED_SETPOINT = "speed set-point"  # rad/s
    TORQUE = "torque"  # N m
    CURRENT = "torque-forming current"  # A


@dataclass(frozen=True, slots=True)
class Meaning:
    """Name, quantity and unit of a drive's signal."""

    name: str
    quantity: Quantity
    unit: str


SIGNALS = {
    61: Meaning("r0061 speed actual value", Quantity.SPEED, "rad/s"),
    62: Meaning("r0062 speed set-point after the filter", Quantity.SPEED_SETPOINT, "rad/s"),
    63: Meaning("r0063 speed actual value, smoothed", Quantity.SPEED, "rad/s"),
    77: Meaning("r0077 torque-forming current set-point", Quantity.CURRENT, "A"),
    78: Meaning("r0078 torque-forming current actual value", Quantity.CURRENT, "A"),
    80: Meaning("r0080 torque actual value", Quantity.TORQUE, "N m"),
}


@dataclass(frozen=True)
class LoopSignal:
    """One signal on the motor side: a series (n,) for each direction of motion."""

    meaning: Meaning
    series: tuple[Array, ...]


@dataclass(frozen=True)
class Spectra:
    """Spectra computed by the control: b lines; `averages` went into each."""

    frequency: Array  # (b,) Hz, as in the file
    input_power: Array  # (b,)
    output_power: Array  # (b,)
    cross: Complex  # (b,) of output* and input
    averages: int

    @property
    def response(self) -> Complex:
        """Output over input (b,)."""
        return np.asarray(np.conj(self.cross) / self.input_power, dtype=np.complex128)

    @property
    def coherence(self) -> Array:
        """(b,), 0 ... 1."""
        return np.abs(self.cross) ** 2 / (self.input_power * self.output_power)


@dataclass(frozen=True)
class LoopMeasurement:
    """The content of a file. Amplitudes on the motor side; `motor_to_axis`: motor rad per rad (m) of the axis."""

    version: str
    axis: int
    measured_at: str
    sample_interval: float  # s
    order: int
    periods: int  # averaged by the control
    bandwidth: float  # Hz
    offset: float  # rad/s
    amplitude: float  # unit of the input
    motor_to_axis: float
    rotary: bool
    torque_constant: float  # N m/A
    input: LoopSignal
    output: LoopSignal
    spectra: Spectra
    parameters: dict[tuple[int, int], float]
    unread: tuple[str, ...]

    @property
    def frequency(self) -> Array:
        """True frequencies (b,) of the lines 0 ... b - 1, Hz."""
        count = len(self.output.series[0])
        return np.arange(len(self.spectra.frequency)) / (count * self.sample_interval)

    @property
    def axis_error(self) -> float:
        """Relative error of the frequencies in the file, positive if they are too high."""
        return float(self.spectra.frequency[-1] / self.frequency[-1] - 1)


def _check_family(root: Member, kind: str) -> None:
    """BadInput for another kind of file, or for a version without known files."""
    if root.kind != kind:
        raise BadInput(root.place, f"is a {root.kind}, not a {kind}")
    versions = ("4.7.", "4.96.")  # of the available files
    if not root.version.startswith(versions):
        known = " and ".join(f"{version}x" for version in versions)
        raise BadInput(root.place, f"has version {root.version!r}; known are {known}")


def measurement_of(root: Member) -> LoopMeasurement:
    """The measurement in a file; BadInput names file and member if something is missing, unknown or inconsistent."""
    _check_family(root, "ResponseTestCustom")
    for name, code, words in (
        ("m_eControlLoopType", 2, "of the speed control loop"),
        ("m_eWaveformType", 4, "with pseudo-random noise"),
    ):
        if root.whole(name) != code:
            raise BadInput(root.place, f"member {name} is {root.whole(name)}: not measured {words} ({code})")
    source, condition = root.first("ExcitationSource"), root.first("ResponseTestCondition")
    interval, order = condition.number("m_dSamplingInterval"), source.whole("m_uPrbsOrder")
    if not (1e-6 < interval < 1 and 3 <= order <= 20):
        raise BadInput(root.place, f"samples every {interval} s of a sequence of order {order}: out of range")
    nodes = {node.whole("m_iUniqueInstanceId"): node for node in root.each("PlatformSignalNode")}
    chosen = root.first("PrimaryFreqRespSigNodeData")
    ends = [chosen.whole(f"m_i{end}SigNodeUniqueInstanceID") for end in ("Input", "Output")]
    if not set(ends) <= set(nodes):
        raise BadInput(root.place, f"its response is of signals {ends}, and it holds {sorted(nodes)}")
    inward, outward = (nodes[end] for end in ends)
    excitation = source.first("ExcitationSourceCondition")
    found = LoopMeasurement(
        version=root.version,
        axis=root.whole("m_uAxis"),
        measured_at=_instant(root.get("m_timeStampMeas")),
        sample_interval=interval,
        order=order,
        periods=condition.whole("m_uNumberOfAverages"),
        bandwidth=condition.number("m_dBandwidth"),
        offset=excitation.number("m_dOffsetAmplitude"),
        amplitude=abs(excitation.number("m_dExcitationAmplitude")),
        motor_to_axis=source.number("m_dMotorToAxisRatio"),
        rotary=source.flag("m_bIsRotaryAxis"),
        torque_constant=source.number("m_dMotorForceConstant"),
        input=_signal(inward, interval, order),
        output=_signal(outward, interval, order),
        spectra=_spectra(inward, outward),
        parameters=_parameters(condition),
        unread=(),
    )
    if len(found.input.series) != len(found.output.series) or len(found.spectra.cross) > 2 ** (order - 1):
        raise BadInput(root.place, "its signals or spectra are not of one length")
    if source.flag("m_bIsLinearMotor"):
        raise BadInput(root.place, "is of a linear motor, which is not supported: its units are not known")
    return replace(found, unread=root.unread())


def _signal(node: Member, interval: float, order: int) -> LoopSignal:
    number, platform = node.whole("m_uNodeId"), node.whole("m_ePlatformType")
    if platform != DRIVE or number not in SIGNALS:
        known = ", ".join(f"r{known:04}" for known in SIGNALS)
        raise BadInput(
            node.place, f"signal {number} of platform {platform} is not known; known are the drive's {known}"
        )
    distortion = node.get("m_MeasurementLinearDistortion")
    gain = complex(distortion.number("m_GainValue_real"), distortion.number("m_GainValue_imag"))
    if gain != 1 or distortion.number("m_TimeDelay") != 0:
        raise BadInput(node.place, f"signal {number} is distorted by {gain}, which is not supported")
    series: list[Array] = []
    for member in node.each("TimeSeries"):
        values = member.array("m_ValueVector")
        end, stated = member.number("m_TimeVector.end"), member.whole("m_TimeVector.length")
        if not len(values) == stated == 2**order - 1 or abs(end / ((stated - 1) * interval) - 1) > 1e-6:
            raise BadInput(
                node.place,
                f"signal {number} has {len(values)} samples to {end} s; a period of order {order} has {2**order - 1} "
                f"samples, {interval} s apart",
            )
        series.append(values)
    if not series:
        raise BadInput(node.place, f"signal {number} has no TimeSeries: save the measurement with its time series")
    return LoopSignal(SIGNALS[number], tuple(series))


def _spectra(inward: Member, outward: Member) -> Spectra:
    own, other = (node.get("m_autospectrumInfo") for node in (inward, outward))
    number = inward.whole("m_uNodeId")
    crossed = [each for each in outward.get("m_crossSpecInfoList").children if each.whole("m_uSignodeId") == number]
    if not crossed:
        raise BadInput(outward.place, f"has no cross-spectrum with signal {number}")
    values, frequencies = zip(*(_spectrum(each) for each in (own, other, crossed[0])), strict=True)
    if any(not np.array_equal(each, frequencies[0]) for each in frequencies):
        raise BadInput(outward.place, "its spectra are not of the same frequencies")
    if (values[0].real <= 0).any() or (values[1].real <= 0).any() or (np.diff(frequencies[0]) <= 0).any():
        raise BadInput(outward.place, "an auto-spectrum is not positive, or frequencies do not rise")
    return Spectra(frequencies[0], values[0].real, values[1].real, values[2], crossed[0].whole("m_uNumSpectraInAvg"))


def _spectrum(info: Member) -> tuple[Complex, Array]:
    spectrum = info.get("m_avgCrossSpec")
    pairs, frequency = spectrum.array("m_ValueVector", per_value=2), spectrum.array("m_FrequencyVector")
    if len(pairs) != len(frequency) or len(pairs) < 2:
        raise BadInput(info.place, f"a spectrum has {len(pairs)} values at {len(frequency)} frequencies")
    return np.asarray(pairs @ np.array([1, 1j]), dtype=np.complex128), frequency


def _parameters(condition: Member) -> dict[tuple[int, int], float]:
    """Known parameters at the time of the measurement, by platform and number."""
    found: dict[tuple[int, int], float] = {}
    for item in condition.each("PlatformDataItem"):
        key = (item.whole("m_ePlatformType"), item.whole("m_uItemId"))
        if key in PARAMETERS and key not in found:
            text = item.string("m_vData")
            found[key] = float(text == "true") if text in ("true", "false") else item.number("m_vData")
    return found


def _instant(stamp: Member) -> str:
    """ISO 8601, by the control's clock."""
    date, time = stamp.whole("Date"), stamp.number("Time")
    day = f"{date // 10000:04}-{date // 100 % 100:02}-{date % 100:02}"
    return f"{day}T{int(time) // 10000:02}:{int(time) // 100 % 100:02}:{time % 100:04.1f}"


class SpeedController(Part):
    """Gain, N m s/rad, and reset time, s."""

    gain: float
    reset_time: float
    reference_model: bool


@dataclass(frozen=True)
class MeasuredPlant:
    """Speed over torque (b,), rad/s per N m, at `frequency` (b,), Hz; coherence (b,) if it is in the file."""

    frequency: Array
    response: Complex
    coherence: Array | None


@dataclass(frozen=True)
class Tuning:
    """On the motor side: kg m^2, N m s/rad, Hz. `axis_per_motor`: rad (m) of the axis per rad of the motor."""

    version: str
    axis: str
    measured_at: str
    motor_inertia: float
    total_inertia: float
    friction: float
    lowest_frequency: float  # above it, the control considers its response valid
    antiresonance: float | None  # the lowest zero of the mechanics; None if the control found none
    axis_per_motor: float
    rotary: bool
    plant: MeasuredPlant
    regulators: tuple[SpeedController, ...]
    unread: tuple[str, ...]


def tuning_of(root: Member) -> Tuning:
    """The tuning in a file; BadInput names file and member if something is missing or unknown."""
    _check_family(root, TUNING)
    position, model = root.first("DynamicModelPositionController840DSL"), root.first("DynamicModelSpeedControllerS120")
    if not model.flag("m_bMotorIsRotary"):
        raise BadInput(root.place, "is of a linear motor, which is not supported: its units are not known")
    zero = model.number("m_dSpeedPlantLowestEstZeroFreq")
    found = Tuning(
        version=root.version,
        axis=root.string("m_szAxisName"),
        measured_at=root.string("m_szInitTime"),
        motor_inertia=_positive(model, "m_dMotorInertia"),
        total_inertia=_positive(model, "m_dTotalInertia"),
        friction=model.number("m_dViscousCoeff"),
        lowest_frequency=model.number("m_dMinUsableMechPlantFrequency"),
        antiresonance=zero if zero > 1e-12 else None,
        axis_per_motor=_positive(position, "m_dAxisDistPerMotorDistUnitsMetersAndRadians"),
        rotary=position.flag("m_bAxisIsRotary"),
        plant=_plant(model.get("m_listMechPlants").first("PlantMeasRecord")),
        regulators=tuple(
            SpeedController(
                gain=each.number("m_dKpGain"),
                reset_time=each.number("m_dIntegralTime"),
                reference_model=each.flag("m_bUsingReferenceModel"),
            )
            for each in model.each("SpeedLoopRegulator")
        ),
        unread=(),
    )
    return replace(found, unread=root.unread())


def _positive(member: Member, name: str) -> float:
    """An inertia, kg m^2, or the way per turn of a motor."""
    value, smallest = member.number(name), 1e-12
    if not value > smallest:
        raise BadInput(member.place, f"member {name} is {value}, and must be above {smallest:g}")
    return value


def _plant(record: Member) -> MeasuredPlant:
    frequency, response = _frequency_response(record.get("m_pPlant"))
    coherence = None
    if record.find("m_pMeasCoherence") is not None:
        at, values = _frequency_response(record.get("m_pMeasCoherence"))
        if not np.array_equal(at, frequency):
            raise BadInput(record.place, "m_pMeasCoherence is not of the frequencies of m_pPlant")
        coherence = values.real
        if (coherence < 0).any() or (coherence > 1 + 1e-6).any():
            raise BadInput(record.place, "m_pMeasCoherence leaves 0 ... 1")
    return MeasuredPlant(frequency, response, coherence)


def _frequency_response(member: Member) -> tuple[Array, Complex]:
    pairs, frequency = member.array("m_ValueVector", per_value=2), member.array("m_FrequencyVector")
    if len(pairs) != len(frequency) or (np.diff(frequency) <= 0).any() or frequency.min(initial=1.0) < 0:
        raise BadInput(member.place, f"{member.name} has {len(pairs)} values at {len(frequency)} rising frequencies")
    return frequency, np.asarray(pairs @ np.array([1, 1j]), dtype=np.complex128)
