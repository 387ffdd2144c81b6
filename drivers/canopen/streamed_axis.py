"""One axis of a streamed sweep: its stop sequence, set-points, samples (two TPDOs of one SYNC) and errors. No I/O."""

import sys
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Protocol

import numpy as np

from drivers.canopen import frames
from drivers.canopen.frames import VIRTUAL_WIRES, MotionPdo, PositionPdo, Wires
from drivers.canopen.profile import CanopenAxis, Codec
from drivers.cia402 import states
from drivers.cia402.checks import DriveEnvelope, set_point
from drivers.cia402.states import Controlword, PowerState, Wish
from drivers.errors import Measured
from drivers.ports import SampleBlock, SweepCommand


@dataclass(frozen=True, slots=True)
class SyncSample:
    """Values of an axis at one SYNC, drive units; `index` counts the SYNCs since the counter was read."""

    index: int
    statusword: int
    velocity: int
    torque: int
    position: int


class CounterPairing:
    """Combines TPDO1 and TPDO2 of one axis by the drive's own counter.

    Only TPDO2 carries the counter. A TPDO1 belongs to the same SYNC if the number of TPDO1 since the last TPDO2 equals
    the advance of the counter, because the frames of a node keep their order on CAN. A TPDO1 that arrives when every
    SYNC is already answered is late and is not counted; one that repeats the previous one may be a duplicated frame and
    need not be counted.

    Any single frame that is lost, duplicated or late therefore causes a gap, never a mixed sample. One case remains: a
    TPDO1 is lost *and* a late frame arrives in its place. Such a sample lies within two SYNCs of a gap, which makes the
    recording invalid.
    """

    def __init__(self, counter: int) -> None:
        """`counter` is 2120h:01 before the first SYNC."""
        self._counter = counter
        self._index = -1  # of the last TPDO2 that was counted
        self._motion: MotionPdo | None = None
        self._motions = 0  # number of TPDO1 since that TPDO2
        self._different = 0  # number of these that differ from the previous one
        self._syncs = 0

    @property
    def ahead(self) -> int:
        """SYNCs counted by the drive minus SYNCs sent; if positive, another host sent some."""
        return self._index + 1 - self._syncs

    def sync(self) -> None:
        """A SYNC was sent."""
        self._syncs += 1

    def motion(self, event: MotionPdo) -> None:
        if self.ahead >= 0:
            return
        self._motions += 1
        self._different += event != self._motion or self._different == 0
        self._motion = event

    def position(self, event: PositionPdo) -> SyncSample | None:
        """The sample that this TPDO2 completes; None if it was already received, or if its TPDO1 is not certain."""
        advance = (event.counter - self._counter) & 0xFFFFFFFF
        if not 0 < advance <= 10_000:  # a counter that jumps further, or back, does not belong to this sweep
            return None
        motion, motions, different = self._motion, self._motions, self._different
        self._counter = event.counter
        self._index += advance
        self._motions = self._different = 0
        if motion is None or not different <= advance <= motions:
            return None
        return SyncSample(self._index, motion.statusword, motion.velocity, motion.torque, event.position)


class Windows:
    """Combines TPDO1 and TPDO2 of one axis by the SYNC after which they arrived, for drives that count no samples.

    The answers to a SYNC arrive after it and before the next one: this interval is the window of the SYNC. TPDO1 and
    TPDO2 both contain the velocity at their SYNC, so two frames that disagree belong to different SYNCs. A window gives
    a sample if it holds one TPDO1 and one TPDO2 that agree. Anything else is a gap. After a gap no sample is accepted
    until two consecutive windows agree with different velocities: a frame that is one cycle late would then have
    disagreed.

    Therefore, with frames late by up to one cycle:

    - A lost, late or duplicated frame of one TPDO is a gap, never a mixed sample.
    - If both answers to a SYNC are missing, their loss cannot be distinguished from all later answers being one cycle
      late. Samples continue after the gap. Late answers are detected at the end, as more frames than SYNCs (the host
      leaves out one SYNC after the last sample for this reason): `doubt` then states it, and the sweep is void.
    - If the host waits with the next SYNC until all drives have answered (`settle`), even that is certain: a frame that
      is missing then is lost.

    These cases remain: a late *duplicated* frame arrives in place of a lost one with exactly the same velocity; both
    answers are late in a row of SYNCs that ends with the loss of both; both answers to a SYNC arrive more than one
    cycle late. In the last two cases both values of a sample belong to one SYNC nevertheless, and the window limits the
    error of its number.
    """

    ahead = 0  # without a counter the drive cannot be ahead

    def __init__(self) -> None:
        self.doubt: str | None = None
        """Why delivered samples may belong to another SYNC than stated."""
        self._syncs = 0
        self._motions: list[MotionPdo] = []
        self._places: list[PositionPdo] = []
        self._settled = False  # frames of the open and earlier windows have arrived, or are lost
        self._certain = True  # so far
        self._agreed: int | None = None  # velocity of the previous window, if its frames agreed
        self._owed_motions = self._owed_places = 0  # frames that are missing and may be late
        self._risked: int | None = None  # first sample delivered while both kinds were missing

    @property
    def answered(self) -> bool:
        """Both TPDOs arrived after the last SYNC."""
        return bool(self._motions and self._places)

    def motion(self, event: MotionPdo) -> None:
        self._motions.append(event)

    def position(self, event: PositionPdo) -> None:
        self._places.append(event)

    def settle(self) -> None:
        """So much time has passed since the last SYNC that no answer is pending any more."""
        self._settled = True

    def sync(self) -> SyncSample | None:
        """The next SYNC is sent. Returns the sample of the previous one, None if there is a gap."""
        sample = self._close() if self._syncs else None
        self._motions.clear()
        self._places.clear()
        self._settled = False
        self._syncs += 1
        return sample

    def _close(self) -> SyncSample | None:
        motions, places, index = self._motions, self._places, self._syncs - 1
        if max(len(motions), len(places)) > 1 and self._risked is not None:
            self.doubt = f"answers to SYNC came a cycle late since sample {self._risked}"
        self._owed_motions = max(0, self._owed_motions + 1 - len(motions))
        self._owed_places = max(0, self._owed_places + 1 - len(places))
        good = len(motions) == len(places) == 1 and motions[0].velocity == places[0].velocity
        agreed, self._agreed = self._agreed, motions[0].velocity if good else None
        proven = good and agreed is not None and agreed != self._agreed
        if proven and min(self._owed_motions, self._owed_places) == 0:
            self._owed_motions = self._owed_places = 0  # the other kind is in step: the missing frames were lost
        if self._settled:
            self._owed_motions = self._owed_places = 0
        believed = good and (self._certain or proven or self._settled)
        lost = self._settled and len(motions) + len(places) <= 1
        self._certain = believed or lost
        if not min(self._owed_motions, self._owed_places):
            self._risked = None
        elif believed and self._risked is None:
            self._risked = index
        if not believed:
            return None
        motion, place = motions[0], places[0]
        return SyncSample(index, motion.statusword, motion.velocity, motion.torque, place.position)


class StopStage(IntEnum):
    """Stage of the stop; it never decreases."""

    RUN = 0
    RAMP = 1
    QUICK_STOP = 2
    DISABLE = 3
    DONE = 4


@dataclass(slots=True)
class StopSequence:
    """Ramp to zero, quick stop, disable voltage, as a table of stages. `ramp_step`: raw velocity units per cycle.

    A stage without success by its deadline, s, leads to the next.
    """

    ramp_step: int
    ramp_time: float
    quick_stop_time: float
    disable_time: float
    stage: StopStage = StopStage.RUN
    _target: int = 0
    _deadline: float = 0.0

    def advance(self, stage: StopStage, now: float, target: int) -> None:
        """Go to `stage` unless it is already reached; `target` is the present set-point."""
        if stage <= self.stage:
            return
        self.stage = stage
        self._target = target
        self._deadline = now + (0.0, self.ramp_time, self.quick_stop_time, self.disable_time, 0.0)[stage]

    def command(self, now: float, standing: bool, state: PowerState) -> tuple[int, int]:
        """Controlword and target velocity of this cycle, after changing the stage if it is due.

        If the drive has left the expected state, the quick stop begins.
        """
        if self.stage is StopStage.RUN:
            self.advance(StopStage.QUICK_STOP, now, 0)
        off = state not in states.ENERGISED | {PowerState.UNKNOWN}
        if self.stage is StopStage.RAMP:
            self._target -= max(-self.ramp_step, min(self.ramp_step, self._target))
            if self._target == 0 and standing:
                self.advance(StopStage.DISABLE, now, 0)
            elif now > self._deadline or state is not PowerState.OPERATION_ENABLED:
                self.advance(StopStage.QUICK_STOP, now, 0)
            else:
                return Controlword.ENABLE_OPERATION, self._target
        if self.stage is StopStage.QUICK_STOP:
            if standing or off or now > self._deadline:
                self.advance(StopStage.DISABLE, now, 0)
            else:
                return states.step(state, Wish.QUICK_STOP), 0
        if self.stage is StopStage.DISABLE and (off or now > self._deadline):
            self.advance(StopStage.DONE, now, 0)
        return states.step(state, Wish.DISABLED), 0


class SetPoints(Protocol):
    """Targets in drive units, one per cycle. The target sent before SYNC k is reached one period later."""

    mode_bits: int
    """Bits of the controlword while the axis follows the set-points."""

    def planned(self, number: int) -> int:
        """Target of this cycle of the sweep; the last target after its end."""
        ...

    def velocity(self, number: int) -> int:
        """Velocity of this cycle in drive units, from which a ramp to standstill begins."""
        ...

    def ramped(self, number: int, velocity: int) -> int:
        """Target that continues from cycle `number` at this velocity, in drive units; call once per cycle."""
        ...


class Velocities:
    """Targets for 60FFh."""

    mode_bits = 0

    def __init__(self, codec: Codec, command: SweepCommand, last: int, period: float) -> None:
        """`last` is the number of the last sample; `period` s."""
        wave = set_point(command, np.arange(1, last + 1, dtype=float) * period)
        self._targets = [codec.raw_velocity(velocity) for velocity in (*wave, 0.0)]

    def planned(self, number: int) -> int:
        return self._targets[min(number, len(self._targets) - 1)]

    velocity = planned

    def ramped(self, number: int, velocity: int) -> int:
        return velocity


class Positions:
    """Targets for 607Ah or 60C1h: the velocities integrated from `start`, drive units."""

    def __init__(
        self, codec: Codec, command: SweepCommand, last: int, period: float, start: int, mode_bits: int
    ) -> None:
        self.mode_bits = mode_bits
        self._velocities = Velocities(codec, command, last, period)
        # 8 steps per cycle: exact to 10^-4 of an amplitude up to 5 Hz at 8 ms
        fine = set_point(command, np.arange(last * 8 + 1, dtype=float) * (period / 8))
        travelled = np.concatenate([[0.0], np.cumsum((fine[1:] + fine[:-1]) * (period / 8 / 2))])[::8]
        begin = float(codec.position(start))
        targets = [codec.raw_position(begin + float(each)) for each in travelled[1:]]
        self._targets = [*targets, targets[-1]]
        self._step = abs(codec.velocity_unit * codec.increments) * period  # position units per cycle and velocity unit
        self._place: float | None = None  # position during the ramp

    def planned(self, number: int) -> int:
        return self._targets[min(number, len(self._targets) - 1)]

    def velocity(self, number: int) -> int:
        return self._velocities.planned(number)

    def ramped(self, number: int, velocity: int) -> int:
        if self._place is None:
            self._place = float(self.planned(max(0, number - 1)))
        self._place += velocity * self._step
        return round(self._place)


class Ending(Enum):
    """Why a stream ended."""

    COMPLETED = "completed"
    STOPPED = "was stopped"
    FORBIDDEN = "lost its permission to move"
    LEFT_ENVELOPE = "left its envelope"
    LEFT_STATE = "left 'operation enabled'"
    SILENT = "fell silent"
    MISCOUNTED = "does not count the SYNCs that were sent"
    NO_STANDSTILL = "did not come to standstill"
    LATE = "set-points came too late"
    NOT_SENT = "set-points were not sent"


@dataclass(frozen=True, slots=True)
class Trouble:
    """An error that ends the sweep of all axes; `stage` is where their stop sequences begin."""

    ending: Ending
    reason: str
    stage: StopStage = StopStage.QUICK_STOP
    measured: Measured | None = None


def unplanned(sent: bytes | None, rest: bytes) -> Trouble:
    """Meaning of a frame of the kernel that is not the planned set-point; `rest` is the one that stops the axis."""
    if sent == rest:
        return Trouble(Ending.LATE, "the host did not plan the next set-points in time")
    return Trouble(Ending.NOT_SENT, "a SYNC was sent without its planned set-point")


@dataclass(frozen=True, slots=True)
class StreamRequest:
    """Data of one axis for a streamed sweep.

    `counter` is 2120h:01 at standstill, before the first SYNC; None if the drive counts no samples. `start` is the
    position of a drive that receives positions, in its units; None for one that receives velocities. `mode_bits` of
    the controlword make the drive follow the set-points.
    """

    axis: CanopenAxis
    codec: Codec
    command: SweepCommand
    envelope: DriveEnvelope
    counter: int | None
    start: int | None = None
    mode_bits: int = 0
    wires: Wires = VIRTUAL_WIRES


class StreamedAxis:
    """One axis in progress. Cycles and samples are numbered from the first SYNC that follows set-points.

    The set-point sent before SYNC k is reached one period later, so that the axis should have w(k T) at SYNC k.
    """

    standing_samples = 5  # in a row below the standstill velocity
    most_ahead = 0.2  # s of SYNCs without a sample, before a host that may miss deadlines waits for a drive that counts

    def __init__(self, request: StreamRequest, period: float) -> None:
        axis, codec = request.axis, request.codec
        self.joint = axis.joint
        self.place = f"{axis.joint} (node {axis.node})"
        self.state = PowerState.UNKNOWN  # until a TPDO is received
        self.velocity = 0  # of the last set-point, drive units
        self.silent = 0  # SYNCs since the last sample
        self.behind = 0  # SYNCs sent but not yet counted in the last sample
        self.last = round(request.command.duration / period)  # number of the last sample
        self._request, self._period = request, period
        self._wave = set_point(request.command, np.arange(self.last + 1, dtype=float) * period)
        self._set_points = _set_points(request, self.last, period)
        self.stop_sequence = StopSequence(
            ramp_step=max(1, round(codec.raw_speed(axis.acceleration) * period)),
            ramp_time=axis.velocity_limit / axis.acceleration + 1.0,
            quick_stop_time=axis.velocity_limit / axis.quick_stop_deceleration + 1.0,
            disable_time=1.0,
        )
        self._pairing = Windows() if request.counter is None else CounterPairing(request.counter)
        self._motion: frames.MotionPdo | None = None  # last received
        self._standing = 0
        self._syncs = 0  # sent since the counter was read
        self._first = sys.maxsize  # SYNCs before the first one of the sweep
        self._number = -1  # of the last sample
        self._over = False  # no further sample is needed
        self._fresh: list[SyncSample] = []

    @property
    def standing(self) -> bool:
        return self._standing >= self.standing_samples

    @property
    def complete(self) -> bool:
        """The last sample was received, and the drive has counted every SYNC that was sent."""
        return self._number >= self.last and self.behind == 0

    @property
    def answered(self) -> bool:
        """Both TPDOs came since the last SYNC; those of a drive that counts samples may be `most_ahead` late."""
        if isinstance(self._pairing, Windows):
            return self._pairing.answered
        return (self.behind + self.silent) * self._period <= self.most_ahead

    @property
    def counts(self) -> bool:
        return isinstance(self._pairing, CounterPairing)

    def planned(self, number: int) -> bytes:
        """RPDO of the set-point of this cycle; after the end of the sweep without the bits that start a mode."""
        bits = self._set_points.mode_bits if number <= self.last else 0
        return frames.rpdo1(Controlword.ENABLE_OPERATION | bits, self._set_points.planned(number))

    def was_sent(self, number: int) -> None:
        self.velocity = self._set_points.velocity(number)

    def command(self, number: int, now: float) -> bytes:
        """RPDO of the set-point of this cycle: along the sweep, or along the stop sequence."""
        if self.stop_sequence.stage is StopStage.RUN and self.state is PowerState.OPERATION_ENABLED:
            self.was_sent(number)
            return self.planned(number)
        controlword, self.velocity = self.stop_sequence.command(now, self.standing, self.state)
        if controlword == Controlword.ENABLE_OPERATION:
            controlword |= self._set_points.mode_bits
        return frames.rpdo1(controlword, self._set_points.ramped(number, self.velocity))

    def begin(self) -> None:
        """The next SYNC is the first one of the sweep."""
        self._first = self._syncs

    def settle(self) -> None:
        """No answer to a SYNC is pending any more."""
        if isinstance(self._pairing, Windows):
            self._pairing.settle()

    def sync(self) -> Trouble | None:
        """A SYNC was sent."""
        self._syncs += 1
        self.silent += 1
        sample = self._pairing.sync()
        if sample is not None:
            self._keep(sample)
        if isinstance(self._pairing, Windows) and self._pairing.doubt is not None:
            return Trouble(Ending.MISCOUNTED, self._pairing.doubt)
        return None

    def take(self, event: frames.Event) -> Trouble | None:
        """Process an event of the node; returns the error it reveals, if any."""
        match event:
            case frames.MotionPdo():
                self._pairing.motion(event)
                self._motion = event
            case frames.PositionPdo():
                return self._take_position(event)
            case frames.Emergency() if event.code:
                return Trouble(Ending.LEFT_STATE, f"error {event.code:04X}h")
            case frames.Heartbeat() if event.state == frames.NmtState.BOOT_UP:
                self.state = PowerState.UNKNOWN
                return Trouble(Ending.LEFT_STATE, "node restarted")
            case _:
                pass
        return None

    def block(self, at_least: int) -> SampleBlock | None:
        """The samples since the last block, None if there are fewer than `at_least`."""
        if len(self._fresh) < at_least:
            return None
        fresh, self._fresh = self._fresh, []
        codec, index = self._request.codec, np.array([sample.index for sample in fresh], dtype=np.int64) - self._first
        return SampleBlock(
            joint=self.joint,
            index=index,
            time=index.astype(float) * self._period,
            effort=codec.effort(np.array([sample.torque for sample in fresh], dtype=float)),
            velocity=codec.velocity(np.array([sample.velocity for sample in fresh], dtype=float)),
            position=codec.position(np.array([sample.position for sample in fresh], dtype=float)),
            velocity_setpoint=self._wave[index],
        )

    def _take_position(self, event: frames.PositionPdo) -> Trouble | None:
        if isinstance(self._pairing, Windows):  # the sample is certain at the next SYNC; errors are reported before
            self._pairing.position(event)
            motion = self._motion
            if motion is None:
                return None
            return self._watch(motion.statusword, motion.velocity, motion.torque, event.position)
        sample = self._pairing.position(event)
        if self._pairing.ahead > 0 and self.stop_sequence.stage is StopStage.RUN:
            return Trouble(Ending.MISCOUNTED, f"its sample counter is {self._pairing.ahead} ahead of SYNC")
        if sample is None:
            return None
        self.behind = self._syncs - 1 - sample.index
        self._keep(sample)
        return self._watch(sample.statusword, sample.velocity, sample.torque, sample.position)

    def _keep(self, sample: SyncSample) -> None:
        self.silent = 0
        velocity = float(self._request.codec.velocity(sample.velocity))
        self._standing = self._standing + 1 if abs(velocity) <= self._request.axis.standstill_velocity else 0
        before, self._number = self._number, sample.index - self._first
        # in a stop sequence the host does not wait for answers: after its first gap, answers may be late ones
        self._over |= self.stop_sequence.stage is not StopStage.RUN and self._number > before + 1
        if 0 <= self._number <= self.last and not self._over:
            self._fresh.append(sample)

    def _watch(self, statusword: int, velocity: int, torque: int, position: int) -> Trouble | None:
        codec = self._request.codec
        self.state = states.decode(statusword)
        if self.stop_sequence.stage is not StopStage.RUN:
            return None
        if self.state is not PowerState.OPERATION_ENABLED:
            return Trouble(Ending.LEFT_STATE, f"is '{self.state.value}'")
        violation = self._request.envelope.violation(
            float(codec.position(position)), float(codec.velocity(velocity)), float(codec.effort(torque))
        )
        return None if violation is None else Trouble(Ending.LEFT_ENVELOPE, violation[0], measured=violation[1])


def _set_points(request: StreamRequest, last: int, period: float) -> SetPoints:
    if request.start is None:
        return Velocities(request.codec, request.command, last, period)
    return Positions(request.codec, request.command, last, period, request.start, request.mode_bits)
