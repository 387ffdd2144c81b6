"""One CiA 402 node: every method is a short blocking exchange over SDO, called on the machine's SDO thread."""

import math
import time
from dataclasses import dataclass

from drivers.canopen import configuration, frames, objects
from drivers.canopen.bus import Bus
from drivers.canopen.objects import Entry
from drivers.canopen.profile import AxisProfile, CanopenProfile
from drivers.canopen.sdo import ObjectAbsent, Sdo
from drivers.canopen.units import Codec, velocity_unit
from drivers.cia402 import states
from drivers.cia402.states import State, Wish
from drivers.errors import CommunicationLost, DriveFault, EmergencyStop, NotReady, WrongConfiguration, WrongIdentity
from drivers.ports import AxisIdentity, AxisState, AxisStatus, Fault

TRANSITION_TIMEOUT = 2.0  # s, for one step of the power state machine (brakes take some 100 ms)
RESET_TIMEOUT = 0.5  # s
POLL = 0.002  # s


@dataclass(frozen=True, slots=True)
class Reading:
    """Statusword and motion of one moment, joint side."""

    statusword: int
    position: float
    velocity: float
    effort: float

    @property
    def state(self) -> State:
        return states.decode(self.statusword)


class Axis:
    """Holds what was learnt of the drive at connect, and its latched fault."""

    def __init__(self, profile: AxisProfile, machine: CanopenProfile, bus: Bus) -> None:
        self.profile = profile
        self.place = f"{profile.joint} (node {profile.node})"
        self._machine = machine
        self._bus = bus
        self.sdo = Sdo(bus.add_node(profile.node, str(machine.eds)), self.place, bus.check_alive)
        self.absent: frozenset[Entry] = frozenset()
        self.streams = False  # all three PDOs and mode 9 are there
        self.measures = False  # the measuring function is there
        self.fault: Fault | None = None

    # -- at connect ----------------------------------------------------------------------------------------------

    def identify(self, dictionary_sha256: str) -> AxisIdentity:
        """WrongIdentity where device type, 1018h, rated torque differ from the profile; learns the drive's units."""
        self._nmt(frames.NMT_PRE_OPERATIONAL)  # a node in NMT stop does not answer
        read = self.sdo.integer
        kind = read(objects.DEVICE_TYPE)
        if kind & 0xFFFF != objects.SERVO_DRIVE:
            raise WrongIdentity(f"{self.place}: device type {kind:08X}h is no CiA 402 drive")
        found = (read(objects.VENDOR), read(objects.PRODUCT), read(objects.REVISION))
        expected = self.profile.identity
        wanted = (expected.vendor, expected.product, expected.revision)
        for name, have, want in zip(("vendor", "product", "revision"), found, wanted, strict=True):
            if have != want:
                raise WrongIdentity(f"{self.place}: {name} is {have:08X}h, the profile says {want:08X}h")
        increments = read(objects.INCREMENTS) / max(1, read(objects.MOTOR_REVOLUTIONS))
        rated_torque = read(objects.RATED_TORQUE) * 1e-3
        if not math.isclose(rated_torque, self.profile.rated_torque, rel_tol=2e-3):
            raise WrongIdentity(
                f"{self.place}: rated torque of the motor is {rated_torque:.4g} N m, "
                f"the profile says {self.profile.rated_torque:.4g} N m"
            )
        self.codec = Codec(
            gear_ratio=self.profile.gear_ratio,
            position_offset=self.profile.position_offset,
            rated_torque=rated_torque,
            increments=increments,
            velocity_unit=velocity_unit(read(objects.VELOCITY_UNIT), increments),
        )
        serial = read(objects.SERIAL)
        return AxisIdentity(self.profile.joint, f"node {self.profile.node}", *found, serial, dictionary_sha256)

    def configure(self) -> None:
        """Disabled and pre-operational: PDOs, session settings, limits. WrongConfiguration names what differs."""
        self.disable()
        self._nmt(frames.NMT_PRE_OPERATIONAL)
        mapped = configuration.configure_pdos(self.sdo, self.profile.node)
        absent = self._settle_session()
        self.absent = absent | self.settle_limits(
            self.profile.velocity_limit, self.profile.effort_limit, self.profile.position_limits
        )
        self.streams = mapped and self._supports_cyclic_velocity() and not absent & {objects.SYNC_PERIOD}
        try:
            self.sdo.read(Entry(0x2100, 2, "H", "state of the measuring function"))
            self.measures = True
        except ObjectAbsent:
            self.measures = False

    # -- reading -------------------------------------------------------------------------------------------------

    def read(self) -> Reading:
        """Statusword first, so that what it says is not younger than the motion."""
        statusword = self.sdo.integer(objects.STATUSWORD)
        return Reading(
            statusword,
            float(self.codec.position(self.sdo.read(objects.POSITION))),
            float(self.codec.velocity(self.sdo.read(objects.VELOCITY))),
            float(self.codec.effort(self.sdo.read(objects.TORQUE))),
        )

    def state(self) -> State:
        return states.decode(self.sdo.integer(objects.STATUSWORD))

    def stands(self, reading: Reading) -> bool:
        return abs(reading.velocity) <= self.profile.standstill_velocity

    def status(self) -> AxisStatus:
        """UNKNOWN with NaN where the node does not answer."""
        try:
            self._bus.check(self.profile.node)
            reading = self.read()
            self.latch_fault(reading.state)
        except CommunicationLost:
            return AxisStatus(self.profile.joint, AxisState.UNKNOWN, math.nan, math.nan, math.nan, self.fault)
        state = AxisState.FAULT if self.fault else states.operator_view(reading.state)
        return AxisStatus(self.profile.joint, state, reading.position, reading.velocity, reading.effort, self.fault)

    def latch_fault(self, state: State) -> Fault | None:
        """Keeps a fault that the drive reports until it is acknowledged here, even if the drive forgets it."""
        announced = self._bus.emergency(self.profile.node)
        if self.fault is None and (announced or state in (State.FAULT, State.FAULT_REACTION)):
            code = self.sdo.integer(objects.ERROR_CODE) or (announced.code if announced else 0)
            history = self._history()
            self.fault = Fault(
                joint=self.profile.joint,
                code=code,
                text=f"error {code:04X}h" + (f", history {history:08X}h" if history else ""),
                emergency_stop=code in self._machine.emergency_stop_codes,
            )
        return self.fault

    def check(self, state: State) -> None:
        """CommunicationLost, EmergencyStop or DriveFault if that is what happened to the axis."""
        self._bus.check(self.profile.node)
        fault = self.latch_fault(state)
        if fault is not None:
            kind = EmergencyStop if fault.emergency_stop else DriveFault
            raise kind(f"{self.place}: {fault.text}")

    # -- power ---------------------------------------------------------------------------------------------------

    def enable(self) -> None:
        """Closes the loop at standstill in profile position mode. Ends disabled if it cannot."""
        self.check(self.state())
        reading = self.read()
        if not self.stands(reading):
            raise NotReady(f"{self.place}: moves at {reading.velocity:.4g} {self.profile.unit}/s, cannot be enabled")
        self._nmt(frames.NMT_START)
        try:
            self.set_mode(objects.PROFILE_POSITION)
            self.sdo.write(objects.TARGET_POSITION, self.sdo.read(objects.POSITION))
            state = self.state()
            while state is not State.OPERATION_ENABLED:
                self.sdo.write(objects.CONTROLWORD, states.step(state, Wish.ENABLED))
                following = self._next_state(state, TRANSITION_TIMEOUT)
                self.check(following)
                if following is state:
                    raise NotReady(f"{self.place}: stays in state '{state.value}' for {TRANSITION_TIMEOUT} s")
                state = following
        except BaseException:
            self.disable()
            raise

    def disable(self) -> None:
        """Disable voltage, whatever the state, and wait for it."""
        self.sdo.write(objects.CONTROLWORD, states.step(self.state(), Wish.DISABLED))
        deadline = time.monotonic() + TRANSITION_TIMEOUT
        while (state := self.state()) in states.ENERGISED:
            if time.monotonic() > deadline:
                raise WrongConfiguration(f"{self.place}: does not leave state '{state.value}' on 'disable voltage'")
            time.sleep(POLL)
        self._nmt(frames.NMT_PRE_OPERATIONAL)

    def quick_stop(self) -> None:
        self.sdo.write(objects.CONTROLWORD, states.step(self.state(), Wish.QUICK_STOP))

    def stop_unheard(self) -> None:
        """For a drive that does not answer but may listen: quick stop by RPDO, then NMT stop, which 6007h reacts to."""
        self._bus.send(frames.RPDO1 + self.profile.node, frames.rpdo1(states.QUICK_STOP, 0))
        self._bus.send(frames.SYNC, b"")
        self._nmt(frames.NMT_STOP)

    def halt(self) -> None:
        """The ladder's first rung for a positioning move: slow down by 605Dh, stay in closed loop."""
        if self.state() is State.OPERATION_ENABLED:
            self.sdo.write(objects.CONTROLWORD, states.ENABLE_OPERATION | states.HALT)

    def acknowledge(self) -> None:
        """Fault reset by a rising edge of bit 7, and nothing more. DriveFault if the fault stays."""
        state = self.state()
        if state is State.FAULT:
            self.sdo.write(objects.CONTROLWORD, states.DISABLE_VOLTAGE)
            self.sdo.write(objects.CONTROLWORD, states.step(state, Wish.FAULT_RESET))
            self.sdo.write(objects.CONTROLWORD, states.DISABLE_VOLTAGE)
            state = self._next_state(state, RESET_TIMEOUT)
        if state in (State.FAULT, State.FAULT_REACTION):
            code = self.sdo.integer(objects.ERROR_CODE)
            raise DriveFault(f"{self.place}: fault {code:04X}h cannot be cleared while its cause is there")
        self._bus.forget_emergency(self.profile.node)
        self.fault = None

    # -- before a motion -----------------------------------------------------------------------------------------

    def require_enabled(self) -> Reading:
        """NotReady unless the axis is enabled and stands."""
        reading = self.read()
        self.check(reading.state)
        if reading.state is not State.OPERATION_ENABLED:
            raise NotReady(f"{self.place}: is '{reading.state.value}', must be enabled first")
        if not self.stands(reading):
            raise NotReady(f"{self.place}: still moves at {reading.velocity:.4g} {self.profile.unit}/s")
        return reading

    def settle_limits(self, velocity: float, effort: float, window: tuple[float, float]) -> frozenset[Entry]:
        """Puts a motion's limits and the session's settings into the drive; gives the objects it does not have."""
        return configuration.settle(self.sdo, configuration.limits(self.codec, velocity, effort, window))

    def read_back(self) -> None:
        """The session's settings once more: somebody else may have changed them. WrongConfiguration if not held."""
        self._settle_session()
        if self.streams and not configuration.pdos_are_mapped(self.sdo, self.profile.node):
            raise WrongConfiguration(f"{self.place}: PDO mapping was changed since connect")

    def set_mode(self, mode: int) -> None:
        """6060h with read-back of 6061h."""
        self.sdo.write(objects.MODE, mode)
        deadline = time.monotonic() + TRANSITION_TIMEOUT
        while (shown := self.sdo.integer(objects.MODE_DISPLAY)) != mode:
            if time.monotonic() > deadline:
                raise WrongConfiguration(f"{self.place}: mode {mode} was not taken, the drive shows {shown}")
            time.sleep(POLL)

    def prepare_streaming(self) -> int:
        """Cyclic velocity at set-point zero; gives the sample counter before the first SYNC."""
        self.sdo.settle(objects.TARGET_VELOCITY, 0)
        self.set_mode(objects.CYCLIC_VELOCITY)
        return self.sdo.integer(objects.SAMPLE_COUNTER)

    def start_positioning(self, position: float, velocity: float) -> None:
        """Profile position: target, speed, rising edge of the new set-point bit, hand-shake by bit 12."""
        self.sdo.write(objects.CONTROLWORD, states.ENABLE_OPERATION)
        self.sdo.settle(objects.PROFILE_VELOCITY, self.codec.raw_speed(velocity))
        self.sdo.settle(objects.TARGET_POSITION, self.codec.raw_position(position))
        self.sdo.write(objects.CONTROLWORD, states.ENABLE_OPERATION | states.NEW_SET_POINT)
        deadline = time.monotonic() + TRANSITION_TIMEOUT
        while not self.sdo.integer(objects.STATUSWORD) & states.SET_POINT_ACKNOWLEDGED:
            self.check(self.state())
            if time.monotonic() > deadline:
                raise WrongConfiguration(f"{self.place}: does not acknowledge the set-point (statusword bit 12)")
            time.sleep(POLL)
        self.sdo.write(objects.CONTROLWORD, states.ENABLE_OPERATION)

    # -- inside --------------------------------------------------------------------------------------------------

    def _settle_session(self) -> frozenset[Entry]:
        """What holds for the whole session; gives the absent objects that a profile can do without."""
        for maker in self._machine.maker_settings:
            self.sdo.settle(Entry(maker.index, maker.sub, maker.type, maker.name), maker.value)
        settings = configuration.standing(self.profile, self._machine.bus, self._machine.stop_options, self.codec)
        return configuration.settle(self.sdo, settings)

    def _supports_cyclic_velocity(self) -> bool:
        try:
            modes = self.sdo.integer(Entry(0x6502, 0, "I", "supported drive modes"))
        except ObjectAbsent:
            return True  # optional object; the mode's read-back tells
        return bool(modes >> (objects.CYCLIC_VELOCITY - 1) & 1)

    def _history(self) -> int:
        try:
            return self.sdo.integer(objects.ERROR_HISTORY)
        except WrongConfiguration:  # absent, or empty and refused
            return 0

    def _next_state(self, state: State, within: float) -> State:
        """The state that follows `state`, or `state` itself if none does in time, s."""
        deadline = time.monotonic() + within
        while (now := self.state()) is state and time.monotonic() < deadline:
            time.sleep(POLL)
        return now

    def _nmt(self, command: int) -> None:
        self._bus.send(frames.NMT, bytes([command, self.profile.node]))
