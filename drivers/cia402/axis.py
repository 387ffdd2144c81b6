"""One axis: power, faults and readings through a `Device`, and its latched fault. Blocking, on the machine's thread."""

import math
import threading
import time
from dataclasses import dataclass
from enum import Enum

from drivers.cia402 import states
from drivers.cia402.device import Device, Feedback, MeasuringState, OperationMode
from drivers.cia402.host_watch import HostWatch
from drivers.cia402.states import Controlword, PowerState, Statusword, Wish
from drivers.errors import (
    CauseCode,
    CommunicationLost,
    DriveFault,
    EmergencyStop,
    Measured,
    NotReady,
    SweepInterrupted,
    SweepRejected,
    WrongConfiguration,
)
from drivers.ports import AxisIdentity, AxisState, AxisStatus, Fault


class Energy(Enum):
    """The power state that this host wants for an axis. During a change every state is accepted."""

    OFF = "off"
    CHANGING = "changing"
    ON = "on"


@dataclass(frozen=True, slots=True)
class Reading(Feedback):
    """Statusword and motion at one instant, joint side."""

    statusword: int

    @property
    def state(self) -> PowerState:
        return states.decode(self.statusword)


class Cia402Axis:
    """Stores the properties read at connect, the latched fault, and whether this host energised the axis."""

    transition_timeout = 2.0  # s, for one step of the power state machine (brakes take about 100 ms)
    reset_timeout = 0.5  # s
    poll = 0.002  # s

    def __init__(self, device: Device, watch: HostWatch) -> None:
        """`watch` is checked before each command that enables or moves the axis."""
        self.device = device
        self.energy = Energy.CHANGING
        self._watch = watch
        self.profile = device.profile
        self.place = device.place
        self.fault: Fault | None = None

    # -- at connect ----------------------------------------------------------------------------------------------

    def introduce(self) -> AxisIdentity:
        """Check the identity, configure the drive and leave it disabled."""
        identity = self.device.identify()
        self.disable()
        self.abilities = self.device.configure()
        return identity

    # -- reading -------------------------------------------------------------------------------------------------

    def read(self) -> Reading:
        """Reads the statusword first, so that it is not newer than the motion."""
        statusword = self.device.statusword()
        motion = self.device.motion()
        return Reading(motion.position, motion.velocity, motion.effort, statusword)

    def state(self) -> PowerState:
        return states.decode(self.device.statusword())

    def stands(self, reading: Reading) -> bool:
        return abs(reading.velocity) <= self.profile.standstill_velocity

    def status(self) -> AxisStatus:
        """UNKNOWN with NaN if the drive does not answer."""
        try:
            self.device.check_alive()
            reading = self.read()
            self.latch_fault(reading.state)
            self._notice_enabled(reading.state)
        except CommunicationLost:
            return AxisStatus(self.profile.joint, AxisState.UNKNOWN, math.nan, math.nan, math.nan, self.fault)
        state = AxisState.FAULT if self.fault else states.operator_view(reading.state)
        moving = (reading.position, reading.velocity, reading.effort)
        energised = reading.state not in states.WITHOUT_ENERGY
        return AxisStatus(self.profile.joint, state, *moving, self.fault, self.stands(reading), energised)

    def latch_fault(self, state: PowerState) -> Fault | None:
        """Store a fault that the drive reports until it is acknowledged here, even if the drive clears it."""
        announced = self.device.announced_error()
        if self.fault is None and (announced is not None or state in (PowerState.FAULT, PowerState.FAULT_REACTION)):
            code = self.device.error_code() or announced or 0  # 0: no error code, see `error_text`
            self.fault = Fault(
                joint=self.profile.joint,
                code=code,
                text=self.device.error_text(code),
                emergency_stop=code in self.device.emergency_stop_codes,
            )
        return self.fault

    def check(self, state: PowerState) -> None:
        """Raises CommunicationLost, EmergencyStop or DriveFault if one of them happened to the axis.

        Raises MotionForbidden if the axis lost its energy for another reason and this host did not disable it.
        """
        self.device.check_alive()
        self._check_fault(state)
        self._check_kept(state)

    def check_standing(self) -> None:
        """As `check`, for an axis that stands while another moves. Asks the drive only if it has announced an error."""
        self.device.check_alive()
        if self.fault is not None or self.device.announced_error() is not None:
            self.check(self.state())

    def check_unused(self) -> None:
        """Between motions: reports to the watch if another host enabled the axis. CommunicationLost."""
        self.device.check_alive()
        self._notice_enabled(self.state())

    def expect_stop(self) -> None:
        """A stop was sent; from now on the axis may lose its energy. From any thread."""
        if self.energy is Energy.ON:
            self.energy = Energy.CHANGING

    # -- power ---------------------------------------------------------------------------------------------------

    def enable(self, stop: threading.Event) -> None:
        """Enables the axis at standstill in profile position mode. The axis is left disabled if that fails.

        Raises SweepInterrupted once `stop` is set; it is checked before every step and interrupts waiting.
        """
        self._watch.check()
        self._check_wanted(stop)
        reading = self.read()
        self.check(reading.state)
        self._notice_enabled(reading.state)
        self._watch.check()
        if not self.stands(reading):
            raise NotReady(self.place, f"moves at {reading.velocity:.4g} {self.profile.unit}/s, cannot be enabled")
        self.device.allow_motion()
        self.energy = Energy.CHANGING
        try:
            self.device.set_mode(OperationMode.PROFILE_POSITION)
            self.device.hold_target()
            state = self.state()
            while state is not PowerState.OPERATION_ENABLED:
                self._check_wanted(stop)
                self._command(states.step(state, Wish.ENABLED))
                following = self._next_state(state, self.transition_timeout, stop)
                self._check_wanted(stop)
                self.check(following)
                if following is state:
                    raise NotReady(self.place, f"stays in state '{state.value}' for {self.transition_timeout} s")
                state = following
            self.energy = Energy.ON
            self._check_wanted(stop)
        except BaseException:
            self.disable()
            raise

    def disable(self) -> None:
        """Sends disable voltage in any state, without reading the state first, and waits until it takes effect."""
        self.expect_stop()
        self.device.control(Controlword.DISABLE_VOLTAGE)
        deadline = time.monotonic() + self.transition_timeout
        while (state := self.state()) in states.ENERGISED:
            if time.monotonic() > deadline:
                raise WrongConfiguration(self.place, f"does not leave state '{state.value}' on 'disable voltage'")
            time.sleep(self.poll)
        self.energy = Energy.OFF
        self.device.forbid_motion()

    def quick_stop(self) -> None:
        self.expect_stop()
        self.device.control(Controlword.QUICK_STOP)

    def halt(self) -> None:
        """First stage of the stop sequence for a move: decelerate by 605Dh, in closed loop if that is still allowed."""
        self.expect_stop()
        if self._watch.reason:
            self.quick_stop()
        elif self.state() is PowerState.OPERATION_ENABLED:
            self.device.control(Controlword.ENABLE_OPERATION | Controlword.HALT)

    def slow_down(self) -> None:
        """First stage of the stop sequence: abort the measuring function if it runs, otherwise halt."""
        if self.abilities.measures and self.device.measuring_state() is MeasuringState.RUNNING:
            self.device.abort_measuring()
        else:
            self.halt()

    def acknowledge(self) -> None:
        """Fault reset by a rising edge of bit 7 only. Raises DriveFault if the fault remains."""
        state = self.state()
        if state is PowerState.FAULT:
            self.device.control(Controlword.DISABLE_VOLTAGE)
            self.device.control(states.step(state, Wish.FAULT_RESET))
            self.device.control(Controlword.DISABLE_VOLTAGE)
            state = self._next_state(state, self.reset_timeout, stop=threading.Event())
        if state in (PowerState.FAULT, PowerState.FAULT_REACTION):
            code = self.device.error_code()
            raise DriveFault(
                self.place, f"fault {code:04X}h cannot be cleared while its cause persists: remove the cause first"
            )
        self.device.forget_error()
        self.fault = None

    # -- before a motion -----------------------------------------------------------------------------------------

    def require_enabled(self) -> Reading:
        """Raises NotReady unless the axis is enabled and stands."""
        reading = self.read()
        self.check(reading.state)
        if reading.state is not PowerState.OPERATION_ENABLED:
            raise NotReady(self.place, f"is '{reading.state.value}', must be enabled first")
        if not self.stands(reading):
            raise NotReady(self.place, f"still moves at {reading.velocity:.4g} {self.profile.unit}/s")
        return reading

    def start_positioning(self, position: float, velocity: float, stop: threading.Event) -> None:
        """Profile position: target, speed, rising edge of the new set-point bit, handshake by bit 12.

        The axis may move before the drive acknowledges. `stop` interrupts waiting, so that the stop sequence gets
        the thread.
        """
        self._command(Controlword.ENABLE_OPERATION)
        self.device.set_target(position, velocity)
        self._command(Controlword.ENABLE_OPERATION | Controlword.NEW_SET_POINT)
        deadline = time.monotonic() + self.transition_timeout
        while not self.device.statusword() & Statusword.SET_POINT_ACKNOWLEDGED:
            if stop.is_set():
                return
            self.check(self.state())
            if time.monotonic() > deadline:
                raise WrongConfiguration(self.place, "does not acknowledge the set-point (statusword bit 12)")
            time.sleep(self.poll)
        self._command(Controlword.ENABLE_OPERATION)

    def start_measuring(self) -> None:
        """Raises SweepRejected with the drive's reason; then nothing moved."""
        self._watch.check()
        self.device.start_measuring()
        if self.device.measuring_state() is MeasuringState.REJECTED:
            raise SweepRejected(self.place, f"sweep rejected: {self.device.rejection()}")

    # -- inside --------------------------------------------------------------------------------------------------

    def _command(self, controlword: int) -> None:
        """Sends a controlword that enables or moves the axis; the watch is checked each time."""
        self._watch.check()
        self.device.control(controlword)

    def _check_fault(self, state: PowerState) -> None:
        fault = self.latch_fault(state)
        if fault is not None:
            kind = EmergencyStop if fault.emergency_stop else DriveFault
            raise kind(self.place, fault.text, measured=Measured(fault.code, None, "hex"))

    def _check_kept(self, state: PowerState) -> None:
        """MotionForbidden if an axis enabled here lost its energy. An external stop may be reported first."""
        deadline = time.monotonic() + 0.1  # s by which the report of a stop may arrive after its effect
        while self.energy is Energy.ON and state is not PowerState.OPERATION_ENABLED:
            if time.monotonic() > deadline:
                self.device.look_for_restart()
                self._check_fault(state)
                self._watch.seen(
                    f"{self.place} is '{state.value}', but this service did not disable it: find out what did",
                    CauseCode.ENERGY_CHANGED,
                    self.profile.joint,
                )
                self._watch.check()
            time.sleep(self.poll)

    def _notice_enabled(self, state: PowerState) -> None:
        if self.energy is Energy.OFF and state in (PowerState.SWITCHED_ON, PowerState.OPERATION_ENABLED):
            self._watch.seen(
                f"{self.place} is '{state.value}', but this service did not enable it: find out what did",
                CauseCode.ENERGY_CHANGED,
                self.profile.joint,
            )

    def _check_wanted(self, stop: threading.Event) -> None:
        if stop.is_set():
            raise SweepInterrupted(self.place, "was stopped while it was being enabled")

    def _next_state(self, state: PowerState, within: float, stop: threading.Event) -> PowerState:
        """The state that follows `state`, or `state` if it does not change within `within` s or before `stop`."""
        deadline = time.monotonic() + within
        while (now := self.state()) is state and time.monotonic() < deadline and not stop.is_set():
            time.sleep(self.poll)
        return now
