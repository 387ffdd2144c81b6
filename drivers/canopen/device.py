"""A CiA 402 drive on CANopen: `drivers.cia402.device.Device` through SDO, NMT and EMCY."""

import logging
from dataclasses import dataclass

from drivers.canopen import frames, measuring
from drivers.canopen.bus import CanopenBus
from drivers.canopen.measuring import MeasuringObject
from drivers.canopen.profile import CanopenAxis, CanopenProfile, Cia301, Entry, SetPointWay, codec
from drivers.canopen.sdo import (
    ObjectAbsent,
    PdoMapping,
    Sdo,
    Setting,
    configure_pdos,
    limit_settings,
    pdos_are_mapped,
    session_settings,
    streaming_pdos,
)
from drivers.cia402.device import (
    Abilities,
    Feedback,
    Injector,
    MeasuringCommand,
    MeasuringState,
    OperationMode,
    await_mode,
    rejection_text,
    require_identity,
    require_rated_torque,
    trace_cycle,
)
from drivers.errors import WrongConfiguration, WrongIdentity
from drivers.ports import AxisIdentity, NoiseCommand, SampleBlock, SweepCommand

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class StreamStart:
    """An axis that waits for set-points: see `streamed_axis.StreamRequest`."""

    counter: int | None
    position: int | None
    mode_bits: int


class CanopenDevice:
    """One node. See `Device`."""

    restart_code = 0  # used as error code: the node booted, for which there is no code

    def __init__(self, profile: CanopenAxis, machine: CanopenProfile, bus: CanopenBus, dictionary_sha256: str) -> None:
        self.profile = profile
        self.place = f"{profile.joint} (node {profile.node})"
        self.emergency_stop_codes = machine.emergency_stop_codes
        self._machine = machine
        self._bus = bus
        self._map = machine.device_map
        self.way = self._map.excitation[0]
        self._sha256 = dictionary_sha256
        self.sdo = Sdo(bus.add_node(profile.node, str(machine.eds)), self.place, bus.check_alive)
        self._pdos_mapped = False
        self._block_transfer = True  # until the drive refuses it
        self._noise = False  # whether the measuring function is prepared for noise
        self.injector: Injector | None = None

    # -- at connect ----------------------------------------------------------------------------------------------

    def identify(self) -> AxisIdentity:
        """Raises WrongIdentity if device type, 1018h or rated torque differ from the profile."""
        self.forbid_motion()  # a node in NMT stopped does not answer
        read = self.sdo.integer
        kind = read(Cia301.DEVICE_TYPE)
        if kind & 0xFFFF != Cia301.SERVO_DRIVE:
            raise WrongIdentity(self.place, f"device type {kind:08X}h is not a CiA 402 drive")
        found = (read(Cia301.VENDOR), read(Cia301.PRODUCT), read(Cia301.REVISION), read(Cia301.SERIAL))
        require_identity(self.place, found, self.profile.identity)
        self._rated_torque = self.profile.rated_torque
        if "rated_torque" not in self._map.missing:
            self._rated_torque = self._read("rated_torque") * self._map.units.rated_torque
        require_rated_torque(self.place, self._rated_torque, self.profile.rated_torque)
        return AxisIdentity(self.profile.joint, f"node {self.profile.node}", *found, self._sha256)

    def configure(self) -> Abilities:
        """In NMT pre-operational: units, PDOs, session settings, limits. WrongConfiguration names what differs."""
        self._settle_map()  # before the units are read
        self.codec = codec(self.profile, self._map.units, self._rated_torque, self._read)
        way = self._choose_way()
        self.way = way or self.way
        self._streaming_mode = self.way.mode(self._supported_modes())
        self.sdo.settle_sync()
        self._pdos = streaming_pdos(self._map, self.way, self.profile.node)
        self._pdos_mapped = configure_pdos(self.sdo, self._pdos, self._map, self.profile.node)
        needed = (MeasuringObject.KIND, MeasuringObject.SEED, MeasuringObject.COMMISSIONED_RESET_TIME)
        measures = self._map.measuring is not None and self._has(MeasuringObject.STATE)
        self.injector = self if measures and all(self._has(entry) for entry in needed) else None
        absent = self._settle_session() | self._settle(
            self.profile.velocity_limit, self.profile.effort_limit, self.profile.position_limits
        )
        self._bus.note_configured(self.profile.node)
        at = self._map.entry
        streams = self._pdos_mapped and way is not None
        return Abilities(
            measures=measures,
            injects=self.injector is not None,
            streams=streams and not absent & {at(name) for name in self._map.streaming_needs},
            velocity_limit=at("max_speed") not in absent,
            effort_limit=at("max_torque") not in absent,
            position_limits=not absent & {at("position_min"), at("position_max")},
            host_watchdog=not absent & {Cia301.HEARTBEAT_CONSUMER, at("connection_loss")},
            set_point=f"{self.way.value} ({at(self.way.target).index:04X}h)" if streams else "none",
        )

    # -- power ---------------------------------------------------------------------------------------------------

    def allow_motion(self) -> None:
        """With the commissioned speed control."""
        self._harden()
        self._nmt(frames.NmtCommand.START)

    def forbid_motion(self) -> None:
        self._nmt(frames.NmtCommand.PRE_OPERATIONAL)

    def statusword(self) -> int:
        return self.sdo.integer(self._map.entry("statusword"))

    def control(self, controlword: int) -> None:
        self.sdo.write(self._map.entry("controlword"), controlword)

    def set_mode(self, mode: OperationMode) -> None:
        """Write 6060h and wait until 6061h shows the mode."""
        self.sdo.write(self._map.entry("mode"), mode)
        await_mode(self.place, mode, lambda: self.sdo.integer(self._map.entry("mode_display")))

    def check_alive(self) -> None:
        self._bus.check(self.profile.node, self.profile.joint)

    def look_for_restart(self) -> None:
        """Nothing to do: a node reports a restart by its boot-up message."""

    def announced_error(self) -> int | None:
        announced = self._bus.emergency(self.profile.node)
        if announced is not None:
            return announced.code
        return CanopenDevice.restart_code if self._bus.restarted(self.profile.node) else None

    def forget_error(self) -> None:
        self._bus.forget_emergency(self.profile.node)
        if self._bus.restarted(self.profile.node):
            self.identify()
            self.configure()

    def error_code(self) -> int:
        if "error_code" in self._map.missing:
            return self.announced_error() or 0
        return self.sdo.integer(self._map.entry("error_code"))

    def error_text(self, code: int) -> str:
        if code == CanopenDevice.restart_code and self._bus.restarted(self.profile.node):
            return "node restarted, its settings are lost"
        history = self._history()
        return f"error {code:04X}h" + (f", history {history:08X}h" if history else "")

    def reopen(self) -> None:
        self._nmt(frames.NmtCommand.PRE_OPERATIONAL)

    @property
    def deaf(self) -> bool:
        """Whether its SDO channel need not be kept free: the node accepts no process data, or is not heard any more."""
        return not self._pdos_mapped or self._bus.silent(self.profile.node)

    def stop_unheard(self) -> None:
        """Quick stop by RPDO, then NMT stop, to which the drive reacts as set in 6007h."""
        node = self.profile.node
        for identifier, data in frames.stop([node], deaf=[node], wires=self._map.wires):
            self._bus.shout(identifier, data)

    # -- motion --------------------------------------------------------------------------------------------------

    def motion(self) -> Feedback:
        return Feedback(
            float(self.codec.position(self._read("position"))),
            float(self.codec.velocity(self._read("velocity"))),
            float(self.codec.effort(self.sdo.read(self._map.effort))),
        )

    def read_back(self) -> None:
        self._settle_session()
        if self._pdos_mapped and not pdos_are_mapped(self.sdo, self._pdos):
            raise WrongConfiguration(self.place, "PDO mapping was changed since connect")

    def settle_limits(self, velocity: float, effort: float, window: tuple[float, float]) -> None:
        self._settle(velocity, effort, window)

    def hold_target(self) -> None:
        self.sdo.write(self._map.entry("target_position"), self._read("position"))

    def set_target(self, position: float, velocity: float) -> None:
        self.sdo.settle(self._map.entry("profile_velocity"), self.codec.raw_speed(velocity))
        self.sdo.settle(self._map.entry("target_position"), self.codec.raw_position(position))

    @property
    def cyclic_pdos(self) -> tuple[PdoMapping, ...]:
        """PDOs sent in each cycle of a streamed sweep, without the RPDO of the stop."""
        return tuple(pdo for pdo in self._pdos if pdo.mapped != (self._map.entry("controlword"),))

    def prepare_streaming(self) -> StreamStart:
        """Switch to the mode that follows set-points, with set-point zero or the actual position."""
        position = int(self._read("position")) if self.way.positions else None
        self._settle_rest()
        self.sdo.settle(self._map.entry(self.way.target), position or 0)
        if self._streaming_mode is None:
            raise WrongConfiguration(self.place, f"6502h has no mode for {self.way.value}")
        self.set_mode(self._streaming_mode)
        counter = self.sdo.integer(self._map.entry("sample_counter")) if self._map.samples == "counter" else None
        # bit 4 of the controlword makes the drive follow interpolated positions
        return StreamStart(counter, position, 0x10 if self.way is SetPointWay.INTERPOLATED_POSITION else 0)

    # -- measuring function --------------------------------------------------------------------------------------

    page_size = 256  # a page occupies the SDO channel, and a stop must wait for it

    def prepare_measuring(self, command: SweepCommand) -> None:
        settings = measuring.parameters(command, self.codec)
        if self.injector is not None:
            settings.append((MeasuringObject.KIND, 0))
        self._prepare(settings, trace_cycle(command), noise=False)

    def prepare_noise(self, command: NoiseCommand) -> None:
        self._prepare(measuring.noise_parameters(command, self.codec), trace_cycle(command), noise=True)

    def soften(self, softening: float) -> None:
        measuring.soften(self.sdo, softening)

    def restore_control(self) -> None:
        measuring.restore(self.sdo)

    def start_measuring(self) -> None:
        self.sdo.write(MeasuringObject.COMMAND, MeasuringCommand.START)

    def abort_measuring(self) -> None:
        self.sdo.write(MeasuringObject.COMMAND, MeasuringCommand.ABORT)

    def measuring_state(self) -> MeasuringState:
        """Raises WrongConfiguration for a state that this adapter does not know."""
        number = self.sdo.integer(MeasuringObject.STATE)
        try:
            return MeasuringState(number)
        except ValueError:
            raise WrongConfiguration(self.place, f"{MeasuringObject.STATE} is {number}") from None

    def rejection(self) -> str:
        return rejection_text(self.sdo.integer(MeasuringObject.REASON))

    def samples_recorded(self) -> int:
        return self.sdo.integer(MeasuringObject.RECORDED)

    def page(self, first: int, count: int) -> SampleBlock:
        self.sdo.write(MeasuringObject.PAGE_FIRST, first)
        self.sdo.write(MeasuringObject.PAGE_COUNT, count)
        raw = self._upload()
        return measuring.samples(
            raw, first, count, self.profile, self.codec, self._trace_cycle, self.place, noise=self._noise
        )

    # -- inside --------------------------------------------------------------------------------------------------

    def _harden(self) -> None:
        """Restore a speed control that a noise run of another host, or an interrupted one, left softened."""
        found = measuring.restore(self.sdo) if self.injector is not None else None
        if found is not None:
            logger.warning("%s: speed control was left softened, now restored: %s", self.place, found)

    def _prepare(self, settings: list[Setting], trace_cycle: int, *, noise: bool) -> None:
        self._trace_cycle, self._noise = trace_cycle, noise
        self.sdo.write(MeasuringObject.COMMAND, MeasuringCommand.NONE)
        for entry, value in settings:
            self.sdo.settle(entry, value)

    def _upload(self) -> bytes:
        if self._block_transfer:
            try:
                return self.sdo.upload(0x2110, 3, block=True)
            except ObjectAbsent:
                raise
            except WrongConfiguration:  # abort: the drive has no block transfer
                self._block_transfer = False
        return self.sdo.upload(0x2110, 3, block=False)

    def _settle_session(self) -> frozenset[Entry]:
        """Settings for the whole session. Returns the missing objects that a profile can do without."""
        self._settle_map()
        for maker in self._machine.maker_settings:
            self.sdo.settle(Entry(maker.index, maker.sub, maker.type, maker.name), maker.value)
        self._harden()
        bus, options = self._machine.bus, self._machine.stop_options
        return self._settle_present(session_settings(self.profile, bus, options, self.codec, self._map))

    def _settle_map(self) -> None:
        for setting in self._map.settings:
            self.sdo.settle(setting.entry, setting.value)

    def _settle(self, velocity: float, effort: float, window: tuple[float, float]) -> frozenset[Entry]:
        return self._settle_present(limit_settings(self.codec, velocity, effort, window, self._map))

    def _settle_present(self, settings: tuple[Setting, ...]) -> frozenset[Entry]:
        """As `Sdo.settle_all`, without the objects that the map lists as missing."""
        missing = {self._map.entry(name) for name in self._map.missing}
        present = tuple(setting for setting in settings if setting[0] not in missing)
        return self.sdo.settle_all(present) | {entry for entry, _ in settings if entry in missing}

    def _read(self, name: str) -> float:
        """An object of the map. A missing object counts as 1: a factor that is not changed."""
        return 1.0 if name in self._map.missing else self.sdo.read(self._map.entry(name))

    def _has(self, entry: Entry) -> bool:
        try:
            self.sdo.read(entry)
        except ObjectAbsent:
            return False
        return True

    def _settle_rest(self) -> None:
        """Set to zero what the drive would add to the set-points: it keeps the value last written by any host."""
        added = [name for name in ("velocity_offset", "target_velocity") if name not in self._map.missing]
        present = tuple((self._map.entry(name), 0) for name in added if name != self.way.target)
        self.sdo.settle_all(present)

    def _choose_way(self) -> SetPointWay | None:
        """The first way of the map that the drive supports."""
        modes = self._supported_modes()
        able = (way for way in self._map.excitation if way.mode(modes) is not None)
        return next((way for way in able if way is not SetPointWay.VELOCITY_OFFSET or self._has_target(way)), None)

    def _has_target(self, way: SetPointWay) -> bool:
        """Whether the drive has the target object; 6502h does not cover optional objects."""
        return self._has(self._map.entry(way.target))

    def _supported_modes(self) -> int | None:
        """6502h; None if the drive does not have it. Then the read-back of the mode shows whether it is supported."""
        if "supported_modes" in self._map.missing:
            return None
        try:
            return self.sdo.integer(self._map.entry("supported_modes"))
        except ObjectAbsent:
            return None

    def _history(self) -> int:
        try:
            return self.sdo.integer(Cia301.ERROR_HISTORY)
        except WrongConfiguration:  # missing, or empty and refused
            return 0

    def _nmt(self, command: int) -> None:
        self._bus.send(frames.Cob.NMT, bytes([command, self.profile.node]))
