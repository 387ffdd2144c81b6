"""Result of automatic servo tuning (AST) of an axis: XML root `DynamicModelAxisController`.

It contains the model of the speed controller (`DynamicModelSpeedControllerS120`): inertia of the rotor, total inertia
and friction as identified by the control, zeros of the mechanics, the measured response of speed to torque with its
coherence, and the controller's settings before and after. The control gives no uncertainty.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from service.formats.sinumerik.measurement import check_family
from service.formats.sinumerik.members import Member, read_members
from service.model.errors import BadInput

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

ROOT = "DynamicModelAxisController"
MODEL = "DynamicModelSpeedControllerS120"
SMALLEST = 1e-12  # of an inertia, kg m^2, or of the way per turn of a motor


@dataclass(frozen=True, slots=True)
class Regulator:
    """Settings of the speed controller: gain, N m s/rad, reset time, s."""

    gain: float
    reset_time: float
    reference_model: bool


@dataclass(frozen=True)
class Plant:
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
    plant: Plant
    regulators: tuple[Regulator, ...]
    unread: tuple[str, ...]


def read_tuning(path: Path) -> Tuning:
    """BadInput names file and member if something is missing or unknown."""
    root = read_members(path)
    check_family(root, ROOT)
    return tuning_of(root)


def tuning_of(root: Member) -> Tuning:
    """The tuning from the root of a file."""
    position, model = root.first("DynamicModelPositionController840DSL"), root.first(MODEL)
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
        antiresonance=zero if zero > SMALLEST else None,
        axis_per_motor=_positive(position, "m_dAxisDistPerMotorDistUnitsMetersAndRadians"),
        rotary=position.flag("m_bAxisIsRotary"),
        plant=_plant(model.get("m_listMechPlants").first("PlantMeasRecord")),
        regulators=tuple(
            Regulator(each.number("m_dKpGain"), each.number("m_dIntegralTime"), each.flag("m_bUsingReferenceModel"))
            for each in model.each("SpeedLoopRegulator")
        ),
        unread=(),
    )
    return replace(found, unread=root.unread())


def _positive(member: Member, name: str) -> float:
    value = member.number(name)
    if not value > SMALLEST:
        raise BadInput(member.place, f"member {name} is {value}, and must be above {SMALLEST:g}")
    return value


def _plant(record: Member) -> Plant:
    frequency, response = _response(record.get("m_pPlant"))
    coherence = None
    if record.find("m_pMeasCoherence") is not None:
        at, values = _response(record.get("m_pMeasCoherence"))
        if not np.array_equal(at, frequency):
            raise BadInput(record.place, "m_pMeasCoherence is not of the frequencies of m_pPlant")
        coherence = values.real
        if (coherence < 0).any() or (coherence > 1 + 1e-6).any():
            raise BadInput(record.place, "m_pMeasCoherence leaves 0 ... 1")
    return Plant(frequency, response, coherence)


def _response(member: Member) -> tuple[Array, Complex]:
    pairs, frequency = member.array("m_ValueVector", per_value=2), member.array("m_FrequencyVector")
    if len(pairs) != len(frequency) or (np.diff(frequency) <= 0).any() or frequency.min(initial=1.0) < 0:
        raise BadInput(member.place, f"{member.name} has {len(pairs)} values at {len(frequency)} rising frequencies")
    return frequency, np.asarray(pairs @ np.array([1, 1j]), dtype=np.complex128)
