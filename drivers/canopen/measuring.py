"""The drive's measuring function (2100h-2103h, 2110h): parameters in, pages of its trace out. Blocking, SDO thread."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from drivers.canopen.axis import Axis
from drivers.canopen.objects import Entry
from drivers.canopen.sdo import ObjectAbsent
from drivers.errors import CommunicationLost, SweepRejected, WrongConfiguration
from drivers.ports import SampleBlock, SweepCommand

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
PAGE_FIRST = Entry(0x2110, 1, "I", "first sample of the page")
PAGE_COUNT = Entry(0x2110, 2, "H", "samples of the page")

NONE, START, ABORT = 0, 1, 2  # commands

SAMPLE = np.dtype(
    [("cycle", "<u4"), ("torque", "<f4"), ("command", "<f4"), ("speed", "<f4"), ("motor", "<f8"), ("load", "<f8")]
)

REASONS = {1: "axis not enabled, or not at standstill", 2: "speed", 3: "position window", 4: "parameters"}


class MeasuringState(IntEnum):
    """2100h:02."""

    IDLE = 0
    RUNNING = 1
    DONE = 2
    ABORTED = 3
    REJECTED = 4


@dataclass(frozen=True, slots=True)
class Progress:
    """State first read, then the count: after DONE the count is final."""

    state: MeasuringState
    recorded: int


class Measuring:
    """The function of one axis during one sweep."""

    def __init__(self, axis: Axis, command: SweepCommand) -> None:
        self._axis = axis
        self._command = command
        self.cycle_ms = max(1, round(1e3 / command.sample_rate))
        self._block_transfer = True  # until the drive refuses it

    def prepare(self) -> None:
        """Writes every parameter with read-back. WrongConfiguration if one is not held."""
        command, sdo = self._command, self._axis.sdo
        settings: list[tuple[Entry, float]] = [
            (OFFSET, self._axis.codec.rev_per_min(command.offset_velocity)),
            (RAMP, command.ramp),
            (SETTLE, command.settle),
            (PERIOD, command.period),
            (PERIODS, command.periods),
            (SINES, len(command.sines)),
            (TRACE_CYCLE, self.cycle_ms),
        ]
        for number, sine in enumerate(command.sines, start=1):
            # A negative gear ratio makes the amplitude negative, and leaves the phase as it is.
            settings += [
                (Entry(0x2101, number, "d", f"frequency {number}"), sine.frequency),
                (Entry(0x2102, number, "d", f"amplitude {number}"), self._axis.codec.rev_per_min(sine.amplitude)),
                (Entry(0x2103, number, "d", f"phase {number}"), sine.phase),
            ]
        sdo.write(COMMAND, NONE)
        for entry, value in settings:
            sdo.settle(entry, value)

    def start(self) -> None:
        """SweepRejected with the drive's reason; nothing moved then."""
        self._axis.sdo.write(COMMAND, START)
        if self.progress().state is MeasuringState.REJECTED:
            reason = self._axis.sdo.integer(REASON)
            raise SweepRejected(f"{self._axis.place}: sweep rejected: {REASONS.get(reason, f'reason {reason}')}")

    def progress(self) -> Progress:
        """WrongConfiguration for a state that this adapter does not know."""
        number = self._axis.sdo.integer(STATE)
        try:
            state = MeasuringState(number)
        except ValueError:
            raise WrongConfiguration(f"{self._axis.place}: {STATE} is {number}") from None
        return Progress(state, self._axis.sdo.integer(RECORDED))

    def page(self, first: int, count: int) -> SampleBlock:
        """Samples `first` to `first + count`, at most 512. CommunicationLost if the drive gives others."""
        sdo = self._axis.sdo
        sdo.write(PAGE_FIRST, first)
        sdo.write(PAGE_COUNT, count)
        raw = self._upload()
        if len(raw) != count * SAMPLE.itemsize:
            raise CommunicationLost(f"{self._axis.place}: trace page of {len(raw)} bytes instead of {count} samples")
        samples = np.frombuffer(raw, SAMPLE)
        index = samples["cycle"].astype(np.int64)
        if not np.array_equal(index, np.arange(first, first + count)):
            raise CommunicationLost(f"{self._axis.place}: trace page from {first} holds other samples")
        codec = self._axis.codec
        load = np.asarray(samples["load"], dtype=float)
        return SampleBlock(
            joint=self._axis.profile.joint,
            index=index,
            time=index.astype(float) * (self.cycle_ms * 1e-3),
            effort=codec.motor_effort(samples["torque"].astype(float)),
            velocity=codec.motor_velocity(samples["speed"].astype(float)),
            position=codec.motor_position(np.asarray(samples["motor"], dtype=float)),
            velocity_setpoint=codec.motor_velocity(samples["command"].astype(float)),
            load_position=None if np.isnan(load).all() else load * (2 * np.pi),
        )

    def _upload(self) -> bytes:
        if self._block_transfer:
            try:
                return self._axis.sdo.upload(0x2110, 3, block=True)
            except ObjectAbsent:
                raise
            except WrongConfiguration:  # abort: no block transfer here
                self._block_transfer = False
        return self._axis.sdo.upload(0x2110, 3, block=False)


def abort_running(axis: Axis) -> bool:
    """Ends the function if it runs: the drive slows down by its ramp. False if it does not run."""
    if axis.sdo.integer(STATE) != MeasuringState.RUNNING:
        return False
    axis.sdo.write(COMMAND, ABORT)
    return True
