"""Hand-made files of a Sinumerik's optimisation tool, of axes whose inertia is known; without the reader's code."""

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

CHARACTERS = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ!#$`()*+-/:;=?@[]^_{|}~"
SAMPLE = 125e-6  # s
GAIN = 0.8  # N m s/rad of the speed controller
INERTIA = 0.0029  # kg m^2
FRICTION = 0.02  # N m s/rad
DELAY = 0.7e-3  # s
ROTOR, TOTAL, ANTIRESONANCE = 0.076, 0.147, 41.5  # of the tuning file: kg m^2, kg m^2, Hz


def base85(values: Array) -> str:
    """Doubles as the control writes them."""
    text = ""
    for (word,) in struct.iter_unpack(">I", b"".join(struct.pack(">d", value) for value in values)):
        digits = [word // 85**power % 85 for power in (4, 3, 2, 1, 0)]
        text += "." if word == 0 else "".join(CHARACTERS[digit] for digit in digits)
    return "\n  ".join(text[k : k + 200] for k in range(0, len(text), 200))


def number(kind: str, name: str, value: object) -> str:
    return f'<{kind} name="{name}">{str(value).lower() if isinstance(value, bool) else value}</{kind}>'


def array(name: str, values: Array | Complex) -> str:
    flat = np.stack([values.real, values.imag], -1).ravel() if np.iscomplexobj(values) else values.real
    return (
        f'<NumericArray elementtype="double" format="base85" name="{name}">'
        f"{number('unsigned_int', 'm_length', len(values))}"
        f'<raw name="m_pNumberArray"><![CDATA[{base85(flat)}]]></raw></NumericArray>'
    )


def sequence(order: int) -> Array:
    """A maximum-length sequence of 2^order - 1 values +-1: every line has the same power."""
    taps = {7: (7, 6), 9: (9, 5), 10: (10, 7), 11: (11, 9)}[order]
    bits = [1] * order
    for _ in range(2**order - 1 - order):
        bits.append(bits[-taps[0]] ^ bits[-taps[1]])
    return 2.0 * np.array(bits) - 1


@dataclass(frozen=True)
class Loop:
    """A speed loop that measures itself: response (b,) over lines 0 ... b - 1."""

    order: int = 11
    noise: float = 1e-4  # rad/s
    seed: int = 0
    version: str = "4.7.6.0.3"
    output: int = 61
    with_gain: bool = False
    reset_time: float | None = None

    @property
    def count(self) -> int:
        return 2**self.order - 1

    def response(self) -> Complex:
        s = 2j * np.pi * np.fft.rfftfreq(self.count, SAMPLE)
        train = (INERTIA * s + FRICTION) * np.exp(s * DELAY) / GAIN
        if self.reset_time is not None:
            train = train * self.reset_time * s / (1 + self.reset_time * s)
        return np.asarray(1 / (1 + train), np.complex128)

    def series(self) -> list[tuple[Array, Array]]:
        """Set-point and speed of both directions."""
        rng = np.random.default_rng(self.seed)
        pairs: list[tuple[Array, Array]] = []
        for direction in (1, -1):
            setpoint = direction * (0.42 + 0.21 * sequence(self.order))
            speed = np.fft.irfft(np.fft.rfft(setpoint) * self.response(), self.count)
            pairs.append((setpoint, speed + rng.normal(0, self.noise, self.count)))
        return pairs

    def xml(self) -> str:
        pairs = self.series()
        lines = self.count // 2
        spectra = [[np.fft.rfft(signal)[:lines] / self.count for signal in pair] for pair in pairs]
        power_in, power_out, cross = (
            np.mean([np.conj(pair[a]) * pair[b] for pair in spectra], axis=0) for a, b in ((0, 0), (1, 1), (1, 0))
        )
        nodes = self._node(self.output, 0, [out for _, out in pairs], power_out, cross)
        nodes += self._node(62, 1, [into for into, _ in pairs], power_in, None)
        return f"""<?xml version="1.0" encoding="ISO-8859-1"?>
<ResponseTestCustom satclassid="174" ver="{self.version}" env="1">
{number("unsigned_int", "m_eControlLoopType", 2)}{number("unsigned_int", "m_uAxis", 1)}
{number("unsigned_int", "m_eWaveformType", 4)}
<SatTimeStamp name="m_timeStampMeas">{number("unsigned_int", "Date", 20240305)}{number("float", "Time", 81502.5)}
</SatTimeStamp>
<LinkedList name="m_MeasurementSignalNodeList">{nodes}</LinkedList>
<LinkedList name="m_ExcitationSourceList"><ExcitationSource name="m_ExcitationSource_ListElement">
{number("unsigned_int", "m_uPrbsOrder", self.order)}{number("boolean", "m_bIsRotaryAxis", False)}
{number("boolean", "m_bIsLinearMotor", False)}{number("float", "m_dMotorToAxisRatio", 628.3185307)}
{number("float", "m_dMotorForceConstant", 0.46)}
<LinkedList name="m_listpExcitationSourceConditions"><ExcitationSourceCondition name="e">
{number("float", "m_dOffsetAmplitude", 0.42)}{number("float", "m_dExcitationAmplitude", 0.21)}
</ExcitationSourceCondition></LinkedList></ExcitationSource></LinkedList>
<LinkedList name="m_listpResponseTestConditions"><ResponseTestCondition name="c">
{number("unsigned_int", "m_uNumberOfAverages", 4)}{number("float", "m_dSamplingInterval", SAMPLE)}
{number("float", "m_dBandwidth", 4000)}{self._gain()}
{number("float", "m_dOfTheNextVersion", 7)}
</ResponseTestCondition></LinkedList>
<LinkedList name="m_listPrimaryFreqRespSigNodeData"><PrimaryFreqRespSigNodeData name="p">
{number("integer", "m_iInputSigNodeUniqueInstanceID", 1)}{number("integer", "m_iOutputSigNodeUniqueInstanceID", 0)}
</PrimaryFreqRespSigNodeData></LinkedList>
</ResponseTestCustom>"""

    def _gain(self) -> str:
        if not self.with_gain:
            return ""
        held = (
            ("unsigned_int", "m_uItemId", 1460),
            ("integer", "m_ePlatformType", 5),
            ("float", "m_vData", GAIN),
        )
        return f'<PlatformDataItem name="i">{"".join(number(*each) for each in held)}</PlatformDataItem>'

    def _node(self, signal: int, instance: int, series: list[Array], power: Complex, cross: Complex | None) -> str:
        frequency = np.linspace(0, 4000, len(power))
        ends = (("m_TimeVector.start", 0), ("m_TimeVector.end", (self.count - 1) * SAMPLE))
        time = "".join(number("float", *end) for end in ends)
        time += number("unsigned_int", "m_TimeVector.length", self.count)
        records = "".join(f'<TimeSeries name="t">{array("m_ValueVector", each)}{time}</TimeSeries>' for each in series)

        def spectrum(name: str, of: int, values: Complex) -> str:
            return (
                f'<SigNodeCrossSpectrumInfo name="{name}">{number("unsigned_int", "m_uSignodeId", of)}'
                f'{number("unsigned_int", "m_uNumSpectraInAvg", 2)}<CrossSpectrum name="m_avgCrossSpec">'
                f"{array('m_ValueVector', values)}{array('m_FrequencyVector', frequency)}</CrossSpectrum>"
                "</SigNodeCrossSpectrumInfo>"
            )

        crossed = "" if cross is None else spectrum("m_crossSpecInfoList_el", 62, cross)
        return f"""<PlatformSignalNode name="n">{number("unsigned_int", "m_uNodeId", signal)}
{number("unsigned_int", "m_ePlatformType", 5)}
<TransferFunction name="m_MeasurementLinearDistortion">{number("float", "m_GainValue_real", 1)}
{number("float", "m_GainValue_imag", 0)}{number("float", "m_TimeDelay", 0)}</TransferFunction>
{number("integer", "m_iUniqueInstanceId", instance)}
<LinkedList name="m_TimeSeriesList">{records}</LinkedList>{spectrum("m_autospectrumInfo", signal, power)}
<LinkedList name="m_crossSpecInfoList">{crossed}</LinkedList></PlatformSignalNode>"""


def tuning_xml(noise: float = 0.01, seed: int = 0, version: str = "4.96.0.0.1") -> str:
    """A spindle tuned by itself: two masses, mu = 0.4 N m s/rad on the motor."""
    frequency = np.geomspace(0.5, 4000, 600)
    s = 2j * np.pi * frequency
    load = (TOTAL - ROTOR) * s / (1 - (frequency / ANTIRESONANCE) ** 2 + 0.02j * frequency / ANTIRESONANCE)
    rng = np.random.default_rng(seed)
    scatter = rng.normal(0, noise, 600) + 1j * rng.normal(0, noise, 600)
    response = (1 + scatter) / (ROTOR * s + load + 0.4)
    coherence = np.full(600, 1 - noise**2) + 0j
    return f"""<?xml version="1.0" encoding="ISO-8859-1"?>
<DynamicModelAxisController satclassid="30" ver="{version}" env="1">
{number("string", "m_szAxisName", "AX7")}{number("string", "m_szInitTime", "2024-03-05T08:15:02")}
<LinkedList name="m_DynModList"><DynamicModelPositionController840DSL name="m">
{number("float", "m_dAxisDistPerMotorDistUnitsMetersAndRadians", 0.380952777)}
{number("boolean", "m_bAxisIsRotary", True)}
<DynamicModelSpeedControllerS120 name="m_DynamicModelBase_ListElement">
{number("float", "m_dMotorInertia", ROTOR)}{number("float", "m_dTotalInertia", 0.14675)}
{number("boolean", "m_bMotorIsRotary", True)}{number("float", "m_dViscousCoeff", 0.323)}
{number("float", "m_dMinUsableMechPlantFrequency", 5.52)}
{number("float", "m_dSpeedPlantLowestEstZeroFreq", ANTIRESONANCE)}
<LinkedList name="m_listMechPlants"><PlantMeasRecord name="m_listMechPlants_el">
<FrequencyResponseFunction name="m_pPlant">{array("m_ValueVector", response)}{array("m_FrequencyVector", frequency)}
</FrequencyResponseFunction>
<FrequencyResponseFunction name="m_pMeasCoherence">{array("m_ValueVector", coherence)}
{array("m_FrequencyVector", frequency)}</FrequencyResponseFunction></PlantMeasRecord></LinkedList>
<LinkedList name="m_listpSpeedLoopRegulators"><SpeedLoopRegulator name="r">{number("float", "m_dKpGain", 22.24)}
{number("float", "m_dIntegralTime", 0.035)}{number("boolean", "m_bUsingReferenceModel", True)}
</SpeedLoopRegulator></LinkedList>
</DynamicModelSpeedControllerS120></DynamicModelPositionController840DSL></LinkedList>
</DynamicModelAxisController>"""
