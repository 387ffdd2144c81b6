"""The drive's measuring function (2100h-2104h, 2110h) and speed control (2140h): objects, parameters, trace pages."""

import numpy as np

from drivers.canopen.profile import Codec, Entry
from drivers.canopen.sdo import Sdo, Setting
from drivers.cia402.device import trace_block, trace_cycle
from drivers.cia402.profile import AxisProfile
from drivers.errors import CommunicationLost
from drivers.ports import NoiseCommand, SampleBlock, SweepCommand


class MeasuringObject:
    """Objects of the measuring function and of the speed control."""

    COMMAND = Entry(0x2100, 1, "H", "measuring command")
    STATE = Entry(0x2100, 2, "H", "measuring state")
    REASON = Entry(0x2100, 3, "H", "reason of rejection")
    OFFSET = Entry(0x2100, 4, "d", "offset speed")
    RAMP = Entry(0x2100, 5, "d", "ramp")
    SETTLE = Entry(0x2100, 6, "d", "settle")
    PERIOD = Entry(0x2100, 7, "d", "period")
    PERIODS = Entry(0x2100, 8, "H", "periods")
    SINES = Entry(0x2100, 9, "H", "number of sines")
    TRACE_CYCLE = Entry(0x2100, 10, "H", "trace cycle in ms")
    RECORDED = Entry(0x2100, 11, "I", "samples recorded")
    KIND = Entry(0x2100, 12, "H", "kind of excitation")  # 0: multi-sine, 1: torque noise
    NOISE_RMS = Entry(0x2104, 1, "d", "RMS of the injected torque")
    LOWEST = Entry(0x2104, 2, "d", "lowest frequency")
    HIGHEST = Entry(0x2104, 3, "d", "highest frequency")
    SEED = Entry(0x2104, 4, "I", "seed of the phases")
    PAGE_FIRST = Entry(0x2110, 1, "I", "first sample of the page")
    PAGE_COUNT = Entry(0x2110, 2, "H", "samples of the page")
    GAIN = Entry(0x2140, 1, "d", "active gain")
    RESET_TIME = Entry(0x2140, 2, "d", "active reset time")
    COMMISSIONED_GAIN = Entry(0x2140, 3, "d", "commissioned gain")
    COMMISSIONED_RESET_TIME = Entry(0x2140, 4, "d", "commissioned reset time")


SAMPLE = np.dtype({
    "names": ["cycle", "torque", "set_speed", "speed", "position", "load_position"],
    "formats": ["<u4", "<f4", "<f4", "<f4", "<f8", "<f8"],
})  # fmt: skip
NOISE_SAMPLE = np.dtype([*SAMPLE.descr, ("injected", "<f4")])


def parameters(command: SweepCommand, codec: Codec) -> list[Setting]:
    """All parameters of a sweep in drive units, without the kind of excitation, which not every drive has."""
    settings = [*_turn(command, codec), (MeasuringObject.SINES, len(command.sines))]
    for number, sine in enumerate(command.sines, start=1):
        # A negative gear ratio makes the amplitude negative and does not change the phase.
        settings += [
            (Entry(0x2101, number, "d", f"frequency {number}"), sine.frequency),
            (Entry(0x2102, number, "d", f"amplitude {number}"), codec.rev_per_min(sine.amplitude)),
            (Entry(0x2103, number, "d", f"phase {number}"), sine.phase),
        ]
    return settings


def noise_parameters(command: NoiseCommand, codec: Codec) -> list[Setting]:
    """All parameters of a noise run in drive units."""
    return [
        *_turn(command, codec),
        (MeasuringObject.KIND, 1),
        (MeasuringObject.NOISE_RMS, abs(command.effort / codec.gear_ratio)),
        (MeasuringObject.LOWEST, command.lowest),
        (MeasuringObject.HIGHEST, command.highest),
        (MeasuringObject.SEED, command.seed),
    ]


def _turn(command: SweepCommand | NoiseCommand, codec: Codec) -> list[Setting]:
    return [
        (MeasuringObject.OFFSET, codec.rev_per_min(command.offset_velocity)),
        (MeasuringObject.RAMP, command.ramp),
        (MeasuringObject.SETTLE, command.settle),
        (MeasuringObject.PERIOD, command.period),
        (MeasuringObject.PERIODS, command.periods),
        (MeasuringObject.TRACE_CYCLE, trace_cycle(command)),
    ]


def samples(
    raw: bytes, first: int, count: int, axis: AxisProfile, codec: Codec, cycle_ms: int, place: str, *, noise: bool
) -> SampleBlock:
    """The samples `first` to `first + count` from the bytes of a page, of a noise run or a sweep.

    Raises CommunicationLost if the page has other samples, and WrongConfiguration if it lacks the direct encoder of
    the profile.
    """
    layout = NOISE_SAMPLE if noise else SAMPLE
    if len(raw) != count * layout.itemsize:
        raise CommunicationLost(place, f"trace page of {len(raw)} bytes instead of {count} samples")
    page = np.frombuffer(raw, layout)
    columns = {name: page[name].astype(float) for name in layout.names or ()}
    return trace_block(axis, codec, place, first, columns, cycle_ms)


def soften(sdo: Sdo, softening: float) -> None:
    """Gain times `softening`, reset time divided by it. Raises WrongConfiguration if the drive does not hold them."""
    sdo.settle(MeasuringObject.GAIN, sdo.read(MeasuringObject.COMMISSIONED_GAIN) * softening)
    sdo.settle(MeasuringObject.RESET_TIME, sdo.read(MeasuringObject.COMMISSIONED_RESET_TIME) / softening)


def restore(sdo: Sdo) -> str | None:
    """Make the commissioned values active. Returns a description of what had to be changed; None if nothing."""
    changed: list[str] = []
    for active, commissioned in (
        (MeasuringObject.GAIN, MeasuringObject.COMMISSIONED_GAIN),
        (MeasuringObject.RESET_TIME, MeasuringObject.COMMISSIONED_RESET_TIME),
    ):
        wanted, found = sdo.read(commissioned), sdo.read(active)
        if found != wanted:
            sdo.settle(active, wanted)
            changed.append(f"{active.name} {found:.4g} instead of {wanted:.4g}")
    return ", ".join(changed) or None
