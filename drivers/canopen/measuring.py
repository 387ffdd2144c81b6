"""The drive's measuring function (2100h-2104h, 2110h): objects, parameters, and the bytes of a trace page. Pure."""

import numpy as np

from drivers.canopen.device_map import Entry
from drivers.canopen.sdo import Sdo, Setting
from drivers.canopen.units import Codec
from drivers.cia402.profile import AxisProfile
from drivers.errors import CommunicationLost, WrongConfiguration
from drivers.ports import NoiseCommand, SampleBlock, SweepCommand

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
KIND = Entry(0x2100, 12, "H", "kind of excitation")
NOISE_RMS = Entry(0x2104, 1, "d", "RMS of the injected torque")
LOWEST = Entry(0x2104, 2, "d", "lowest frequency")
HIGHEST = Entry(0x2104, 3, "d", "highest frequency")
SEED = Entry(0x2104, 4, "I", "seed of the phases")
PAGE_FIRST = Entry(0x2110, 1, "I", "first sample of the page")
PAGE_COUNT = Entry(0x2110, 2, "H", "samples of the page")

NONE, START, ABORT = 0, 1, 2  # commands
MULTI_SINE, TORQUE_NOISE = 0, 1  # kinds

SAMPLE = np.dtype(
    [("cycle", "<u4"), ("torque", "<f4"), ("command", "<f4"), ("speed", "<f4"), ("motor", "<f8"), ("load", "<f8")]
)
NOISE_SAMPLE = np.dtype([*SAMPLE.descr, ("injected", "<f4")])

REASONS = {1: "axis not enabled, or not at standstill", 2: "speed", 3: "position window", 4: "parameters", 5: "torque"}


def trace_cycle(command: SweepCommand | NoiseCommand) -> int:
    """Trace cycle in ms, as close to the requested sample rate as the drive supports."""
    return max(1, round(1e3 / command.sample_rate))


def parameters(command: SweepCommand, codec: Codec) -> list[Setting]:
    """All parameters of a sweep in drive units, without the kind of excitation, which not every drive has."""
    settings = [*_turn(command, codec), (SINES, len(command.sines))]
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
        (KIND, TORQUE_NOISE),
        (NOISE_RMS, codec.motor_torque(command.effort)),
        (LOWEST, command.lowest),
        (HIGHEST, command.highest),
        (SEED, command.seed),
    ]


def _turn(command: SweepCommand | NoiseCommand, codec: Codec) -> list[Setting]:
    return [
        (OFFSET, codec.rev_per_min(command.offset_velocity)),
        (RAMP, command.ramp),
        (SETTLE, command.settle),
        (PERIOD, command.period),
        (PERIODS, command.periods),
        (TRACE_CYCLE, trace_cycle(command)),
    ]


def samples(
    raw: bytes,
    first: int,
    count: int,
    axis: AxisProfile,
    codec: Codec,
    cycle_ms: int,
    place: str,
    *,
    noise: bool = False,
) -> SampleBlock:
    """The samples `first` to `first + count` from the bytes of a page, of a noise run or a sweep.

    Raises CommunicationLost if the page has other samples, and WrongConfiguration if it lacks the direct encoder of
    the profile.
    """
    layout = NOISE_SAMPLE if noise else SAMPLE
    if len(raw) != count * layout.itemsize:
        raise CommunicationLost(place, f"trace page of {len(raw)} bytes instead of {count} samples")
    page = np.frombuffer(raw, layout)
    index = page["cycle"].astype(np.int64)
    if not np.array_equal(index, np.arange(first, first + count)):
        raise CommunicationLost(place, f"trace page from {first} holds other samples")
    load = np.asarray(page["load"], dtype=float)
    if axis.load_encoder and np.isnan(load).any():
        raise WrongConfiguration(place, "the profile says load_encoder, the trace holds none")
    return SampleBlock(
        joint=axis.joint,
        index=index,
        time=index.astype(float) * (cycle_ms * 1e-3),
        effort=codec.motor_effort(page["torque"].astype(float)),
        velocity=codec.motor_velocity(page["speed"].astype(float)),
        position=codec.motor_position(np.asarray(page["motor"], dtype=float)),
        velocity_setpoint=codec.motor_velocity(page["command"].astype(float)),
        load_position=load * (axis.load_encoder_direction * 2 * np.pi) if axis.load_encoder else None,
        excitation_effort=codec.motor_effort(page["injected"].astype(float)) if noise else None,
    )


GAIN = Entry(0x2140, 1, "d", "active gain")
RESET_TIME = Entry(0x2140, 2, "d", "active reset time")
COMMISSIONED_GAIN = Entry(0x2140, 3, "d", "commissioned gain")
COMMISSIONED_RESET_TIME = Entry(0x2140, 4, "d", "commissioned reset time")


def soften(sdo: Sdo, softening: float) -> None:
    """Gain times `softening`, reset time divided by it. Raises WrongConfiguration if the drive does not hold them."""
    sdo.settle(GAIN, sdo.read(COMMISSIONED_GAIN) * softening)
    sdo.settle(RESET_TIME, sdo.read(COMMISSIONED_RESET_TIME) / softening)


def restore(sdo: Sdo) -> str | None:
    """Make the commissioned values active. Returns a description of what had to be changed; None if nothing."""
    changed: list[str] = []
    for active, commissioned in ((GAIN, COMMISSIONED_GAIN), (RESET_TIME, COMMISSIONED_RESET_TIME)):
        wanted, found = sdo.read(commissioned), sdo.read(active)
        if found != wanted:
            sdo.settle(active, wanted)
            changed.append(f"{active.name} {found:.4g} instead of {wanted:.4g}")
    return ", ".join(changed) or None
