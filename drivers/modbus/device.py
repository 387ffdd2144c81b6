"""A CiA 402 drive on Modbus: `drivers.cia402.device.Device` through the signals of a register map.

The drive's measuring function through registers: a sweep's parameters, and the samples in a trace page. Pure.
"""

import logging
import math
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress

import numpy as np

from drivers.cia402 import states
from drivers.cia402.device import (
    Abilities,
    Feedback,
    MeasuringCommand,
    MeasuringState,
    OperationMode,
    await_mode,
    rejection_text,
    require_identity,
    require_rated_torque,
    trace_block,
    trace_cycle,
)
from drivers.cia402.profile import Gear
from drivers.cia402.states import Controlword, PowerState
from drivers.errors import CommunicationLost, DriveFault, LimitExceeded, WrongConfiguration, WrongIdentity
from drivers.modbus.line import MasterLine
from drivers.modbus.profile import ModbusAxis, ModbusProfile
from drivers.modbus.registers import Array, Format, RegisterMap, RegisterSignal, Rounding, TraceLayout
from drivers.modbus.unit import ControlToken, RegisterSetting, RegisterUnit
from drivers.ports import AxisIdentity, SampleBlock, SweepCommand


def _parameters(command: SweepCommand, signals: Mapping[str, RegisterSignal], gear: Gear) -> list[RegisterSetting]:
    """All parameters of a sweep in the units of their signals. Raises LimitExceeded for more sines than the map has.

    A register may change a parameter by 1e-4 of it, a phase by 1e-4 rad, and let a sine drift by 1e-3 of a period.
    """
    near = 1e-4
    single = {
        "offset_speed": gear.rev_per_min(command.offset_velocity),
        "ramp": command.ramp,
        "settle": command.settle,
        "period": command.period,
        "periods": float(command.periods),
        "sines": float(len(command.sines)),
        "trace_cycle": float(trace_cycle(command)),
    }
    settings = [RegisterSetting(signals[name], value, near * abs(value)) for name, value in single.items()]
    frequencies, amplitudes, phases = (signals[name].elements() for name in ("frequency", "amplitude", "phase"))
    room = min(len(frequencies), len(amplitudes), len(phases))
    if len(command.sines) > room:
        raise LimitExceeded(command.joint, f"{len(command.sines)} sines are more than the register map's {room}")
    for sine, frequency, amplitude, phase in zip(command.sines, frequencies, amplitudes, phases, strict=False):
        # A negative gear ratio makes the amplitude negative and does not change the phase.
        speed = gear.rev_per_min(sine.amplitude)
        settings += [
            RegisterSetting(frequency, sine.frequency, 1e-3 / command.duration),
            RegisterSetting(amplitude, speed, near * abs(speed)),
            RegisterSetting(phase, sine.phase, near),
        ]
    return settings


def _columns(registers: Sequence[int], count: int, trace: TraceLayout) -> dict[str, Array]:
    """(count,) of each signal. The lowest value of an integer register means that there is no load encoder: NaN."""
    table = np.asarray(registers, np.uint16).reshape(count, trace.width)
    found: dict[str, Array] = {}
    start = 0
    for name, each in trace.sample:
        values = each.decode(table[:, start : start + each.width])
        start += each.width
        if name == "load_position" and each.whole:
            values[values == each.least] = np.nan
        found[name] = values
    return found


logger = logging.getLogger(__name__)


class ModbusDevice:
    """One unit. See `Device`."""

    restart_code = 0  # used as error code of a restart

    injector = None  # a register map has no torque noise

    def __init__(
        self,
        profile: ModbusAxis,
        machine: ModbusProfile,
        registers: RegisterMap,
        sha256: str,
        line: MasterLine,
        control: ControlToken,
    ) -> None:
        self.profile = profile
        self.place = profile.place
        self.emergency_stop_codes = machine.emergency_stop_codes
        self._machine = machine
        self._map = registers
        self._sha256 = sha256
        self._line = line
        self._control = control
        self._unit = RegisterUnit(line, profile.unit_id, registers, self.place)
        self._gear = profile.gear
        self._trace_cycle = 1  # ms
        self._restarted = False
        self._faulty = False
        self._looks = 0

    # -- at connect ----------------------------------------------------------------------------------------------

    def identify(self) -> AxisIdentity:
        """Raises WrongIdentity if constant, vendor, product, revision, serial or rated torque are others."""
        self.forbid_motion()
        self._check_constant()
        found = self._check_identity()
        require_rated_torque(self.place, self._unit.value("rated_torque"), self.profile.rated_torque)
        self._serial = found[3]
        return AxisIdentity(self.profile.joint, f"unit {self.profile.unit_id}", *found, self._sha256)

    def configure(self) -> Abilities:
        self._settle_session()
        self._restarted = False
        self.settle_limits(self.profile.velocity_limit, self.profile.effort_limit, self.profile.position_limits)
        return Abilities(
            measures=self._map.trace is not None,
            injects=False,
            streams=False,
            velocity_limit="max_speed" in self._map.signals,
            effort_limit="max_torque" in self._map.signals,
            position_limits={"position_min", "position_max"} <= self._map.signals.keys(),
            host_watchdog="watchdog" in self._map.signals,
        )

    # -- power ---------------------------------------------------------------------------------------------------

    def allow_motion(self) -> None:
        """Checks first that it is the drive of `identify` and is still configured, and takes control of all units.

        Raises NotReady if another host has it.
        """
        self.read_back()
        self._control.take()
        self._line.use(self.profile.unit_id)

    def forbid_motion(self) -> None:
        self._line.release(self.profile.unit_id)

    def statusword(self) -> int:
        return self._unit.integer("statusword")

    def control(self, controlword: int) -> None:
        self._unit.write({"controlword": controlword})

    def set_mode(self, mode: OperationMode) -> None:
        self._unit.write({"mode": mode})
        await_mode(self.place, mode, lambda: self._unit.integer("mode_display"))

    def check_alive(self) -> None:
        self._line.check(self.profile.unit_id, self.place)

    def announced_error(self) -> int | None:
        """Result of the heartbeat, because a Modbus drive only answers requests. A restart is detected by its watchdog,
        which is off after it. The code of a fault is `error_code`.
        """
        return ModbusDevice.restart_code if self._restarted or self._faulty else None

    def forget_error(self) -> None:
        self._faulty = False
        if self._restarted:
            self.identify()
            self.configure()

    def error_code(self) -> int:
        return self._unit.integer("error_code")

    def error_text(self, code: int) -> str:
        if code == ModbusDevice.restart_code and self._restarted:
            return "drive restarted, its settings are lost"
        return f"error {code:04X}h"

    @property
    def may_move(self) -> bool:
        """Whether this connection has allowed it to move and not forbidden it since."""
        return self._line.in_use(self.profile.unit_id)

    def halt(self) -> None:
        """Quick stop without waiting for the answer."""
        self._unit.tell("controlword", Controlword.QUICK_STOP)

    def reopen(self) -> None:
        """Nothing to do: a Modbus drive always receives."""

    def stop_unheard(self) -> None:
        """Quick stop, and disable voltage after the time of its ramp."""
        self._unit.tell("controlword", Controlword.QUICK_STOP)
        time.sleep(self.profile.velocity_limit / self.profile.quick_stop_deceleration)
        self._unit.tell("controlword", Controlword.DISABLE_VOLTAGE)

    def beat(self) -> None:
        """A request to the drive that proves both are alive, if there was no other request recently."""
        if self._line.due(self.profile.unit_id):
            with suppress(CommunicationLost):  # the line stores the reason and raises it at the next request
                self._look()

    # -- motion --------------------------------------------------------------------------------------------------

    def motion(self) -> Feedback:
        """Values of one instant, if the three registers are adjacent in the map."""
        values = self._unit.read("position", "velocity", "torque")
        return Feedback(
            self._gear.motor_position(values["position"]),
            self._gear.motor_velocity(values["velocity"]),
            self._gear.motor_effort(values["torque"] * 1e-3 * self._gear.rated_torque),
        )

    def read_back(self) -> None:
        """Also raises WrongIdentity if the unit differs from that at connect: addresses may have been swapped since.

        Raises DriveFault if it restarted: after a person acknowledges it, it is configured again.
        """
        found = self._check_identity()
        if found[3] != self._serial:
            raise WrongIdentity(self.place, f"serial is {found[3]:08X}h, at connect it was {self._serial:08X}h")
        self.look_for_restart()
        if self._restarted:
            raise DriveFault(self.place, f"{self.error_text(ModbusDevice.restart_code)}")
        self._settle_session()

    def settle_limits(self, velocity: float, effort: float, window: tuple[float, float]) -> None:
        """Writes those of the four limits that the map has, limited to the range of their registers."""
        low, high = sorted(self._gear.revolutions(limit) for limit in window)
        limits: dict[str, tuple[float, Rounding]] = {
            "max_torque": (self._gear.permille(effort), math.floor),
            "max_speed": (self._speed(velocity), round),
            "position_min": (low, math.floor),
            "position_max": (high, math.ceil),
        }
        signals = self._map.signals
        self._unit.settle(
            *(
                RegisterSetting(signals[name], signals[name].format.clip(value), rounding=rounding)
                for name, (value, rounding) in limits.items()
                if name in signals
            )
        )

    def hold_target(self) -> None:
        self._unit.write({"target_position": self._unit.value("position")})

    def set_target(self, position: float, velocity: float) -> None:
        signals = self._map.signals
        self._unit.settle(
            RegisterSetting(signals["profile_velocity"], self._speed(velocity)),
            RegisterSetting(signals["target_position"], self._gear.revolutions(position)),
        )

    # -- measuring function --------------------------------------------------------------------------------------

    @property
    def page_size(self) -> int:
        """At most one page of the map, and what the line carries in 0.1 s, because a stop must wait for it."""
        trace, piece = self._trace(), self._piece
        requests = max(1, math.floor(0.1 / self._machine.line.read_time(piece)))
        return min(trace.registers, requests * piece) // trace.width

    def prepare_measuring(self, command: SweepCommand) -> None:
        """Raises LimitExceeded if the register of a parameter is too coarse for its value."""
        self._trace_cycle = trace_cycle(command)
        self._unit.write({"measuring_command": MeasuringCommand.NONE})
        self._unit.settle(*_parameters(command, self._map.signals, self._gear))

    def start_measuring(self) -> None:
        self._unit.write({"measuring_command": MeasuringCommand.START})

    def abort_measuring(self) -> None:
        self._unit.write({"measuring_command": MeasuringCommand.ABORT})

    def measuring_state(self) -> MeasuringState:
        """Raises WrongConfiguration for a state that this adapter does not know."""
        number = self._unit.integer("measuring_state")
        if number == MeasuringState.IDLE:  # state of a drive without a sweep
            self.look_for_restart()
        try:
            return MeasuringState(number)
        except ValueError:
            raise WrongConfiguration(self.place, f"measuring_state is {number}") from None

    def rejection(self) -> str:
        return rejection_text(self._unit.integer("measuring_reason"))

    def samples_recorded(self) -> int:
        return self._unit.integer("samples_recorded")

    def page(self, first: int, count: int) -> SampleBlock:
        """Read in pieces of whole samples, so that no request splits a value."""
        trace, piece = self._trace(), self._piece
        self._unit.write({"page_first": first, "page_count": count})
        registers: list[int] = []
        for start in range(0, count * trace.width, piece):
            number = min(piece, count * trace.width - start)
            registers += self._unit.registers(trace.address + start, number, f"trace from sample {first}")
        columns = _columns(registers, count, trace)
        return trace_block(self.profile, self._gear, self.place, first, columns, self._trace_cycle)

    # -- inside --------------------------------------------------------------------------------------------------

    def _speed(self, speed: float) -> float:
        """Magnitude of a speed, rad/s (m/s) -> rev/min; also rad/s^2 (m/s^2) -> rev/min/s."""
        return abs(self._gear.rev_per_min(speed))

    def _check_constant(self) -> None:
        signal = self._map.signals["constant"]
        registers = self._unit.registers(signal.address, signal.format.width, str(signal))
        read = int(signal.format.decode(registers)[0])
        if read == self._map.constant:
            return
        other = signal.format.order.other
        turned = int(Format(signal.format.type, other).decode(registers)[0])
        what = f"{self.place}: {signal} reads {read:08X}h, the register map says {self._map.constant:08X}h; "
        if turned == self._map.constant:
            raise WrongIdentity(f"{what}with word_order '{other.value}' both agree: correct word_order in the map")
        raise WrongIdentity(f"{what}with word_order '{other.value}' it would be {turned:08X}h")

    def _check_identity(self) -> tuple[int, int, int, int]:
        read = self._unit.read("vendor", "product", "revision", "serial")
        found = (int(read["vendor"]), int(read["product"]), int(read["revision"]), int(read["serial"]))
        require_identity(self.place, found, self.profile.identity)
        return found

    def _look(self) -> None:
        """One short exchange: checks for a fault, and every second time for a restart."""
        self._looks += 1
        if self._looks % 2:
            self._faulty = states.decode(self.statusword()) in (PowerState.FAULT, PowerState.FAULT_REACTION)
        else:
            self.look_for_restart()

    def look_for_restart(self) -> None:
        if self._restarted or "watchdog" not in self._map.signals:
            return
        if self._unit.value("watchdog") != self._watchdog:
            logger.warning("%s: the drive restarted: its watchdog was off", self.place)
            self._restarted = True

    @property
    def _watchdog(self) -> float:
        """ms, as its register can hold it."""
        form = self._map.signals["watchdog"].format
        return float(form.decode(form.encode(self._machine.line.watchdog * 1e3))[0])

    def _settle_session(self) -> None:
        """Settings for the whole session, as far as the map has them."""
        options = self._machine.stop_options
        acceleration = self._speed(self.profile.acceleration)
        settings = {
            "watchdog": self._machine.line.watchdog * 1e3,
            "connection_loss_option": options.connection_loss,
            "quick_stop_option": options.quick_stop,
            "shutdown_option": options.shutdown,
            "disable_option": options.disable_operation,
            "halt_option": options.halt,
            "fault_option": options.fault_reaction,
            "profile_acceleration": acceleration,
            "profile_deceleration": acceleration,
            "quick_stop_deceleration": self._speed(self.profile.quick_stop_deceleration),
        }
        signals = self._map.signals
        self._unit.settle(
            *(RegisterSetting(signals[name], value) for name, value in settings.items() if name in signals)
        )

    @property
    def _piece(self) -> int:
        """Registers of the whole samples that fit one request."""
        width = self._trace().width
        return self._map.max_read // width * width

    def _trace(self) -> TraceLayout:
        if self._map.trace is None:
            raise WrongConfiguration(self.place, "the register map has no measuring function")
        return self._map.trace
