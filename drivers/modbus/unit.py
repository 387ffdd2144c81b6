"""One unit of a line: its signals, written and read as physical values with read-back, and which host controls it."""

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from drivers.cia402.host_watch import HostWatch
from drivers.errors import CommunicationLost, DriveError, LimitExceeded, NotReady, WrongConfiguration
from drivers.modbus.line import MasterLine
from drivers.modbus.registers import MAX_WRITE, RegisterMap, RegisterSignal, Rounding, spans

logger = logging.getLogger(__name__)

OWNER = "control_owner"

Registers = dict[RegisterSignal, list[int]]


@dataclass(frozen=True, slots=True)
class RegisterSetting:
    """Required value of a signal; `resolution`: allowed error caused by the resolution of its register."""

    signal: RegisterSignal
    value: float
    resolution: float = math.inf
    rounding: Rounding = round


class RegisterUnit:
    """Blocking. Raises CommunicationLost if the unit does not answer and WrongConfiguration if it refuses."""

    def __init__(self, line: MasterLine, number: int, registers: RegisterMap, place: str) -> None:
        """`place` as in "joint_1 (unit 1)"."""
        self._line, self._number, self._map, self._place = line, number, registers, place

    def read(self, *names: str) -> dict[str, float]:
        """Physical values; signals with adjacent registers are read by one request."""
        held = self._held(self._map.signals[name] for name in names)
        return {signal.name: float(signal.format.decode(words)[0]) for signal, words in held.items()}

    def value(self, name: str) -> float:
        return self.read(name)[name]

    def integer(self, name: str) -> int:
        return int(self.value(name))

    def write(self, values: Mapping[str, float]) -> None:
        """Write without read-back. Raises LimitExceeded if a register cannot hold its value."""
        settings = [RegisterSetting(self._map.signals[name], value) for name, value in values.items()]
        self._write({setting.signal: self._encode(setting) for setting in settings})

    def settle(self, *settings: RegisterSetting) -> None:
        """Make the signals hold these values: write those that differ, and read them back.

        Raises LimitExceeded if a register is coarser than the allowed error, and WrongConfiguration if the drive
        holds another value after the write.
        """
        wanted = {setting.signal: self._encode(setting) for setting in settings}
        different = self._different(wanted)
        if not different:
            return
        self._write(different)
        for signal in self._different(different):
            held = self._held([signal])[signal]
            raise WrongConfiguration(
                self._place, f"{signal}: wrote {_shown(signal, wanted[signal])}, drive holds {_shown(signal, held)}"
            )

    def tell(self, name: str, value: float) -> None:
        """Write without waiting for an answer."""
        signal = self._map.signals[name]
        self._line.tell(
            self._number, signal.address, self._encode(RegisterSetting(signal, value)), f"{self._place}: {signal}"
        )

    def registers(self, address: int, count: int, what: str) -> list[int]:
        """Raw registers, at most `max_read`."""
        return self._line.read(self._number, address, count, f"{self._place}: {what}")

    # -- inside --------------------------------------------------------------------------------------------------

    def _encode(self, setting: RegisterSetting) -> list[int]:
        signal, value = setting.signal, setting.value
        try:
            registers = signal.format.encode(value, setting.rounding)
        except LimitExceeded as error:
            raise LimitExceeded(self._place, f"{signal}: {error}") from None
        near = float(signal.format.decode(registers)[0])
        if abs(near - value) > setting.resolution:
            raise LimitExceeded(self._place, f"{signal}: {value:.9g} would be {near:.9g} in the drive's steps")
        return registers

    def _held(self, signals: Iterable[RegisterSignal]) -> Registers:
        held: Registers = {}
        for span in spans(signals, self._map.max_read):
            start = span[0].address
            words = self.registers(start, span[-1].end - start, ", ".join(str(signal) for signal in span))
            held |= {signal: words[signal.address - start : signal.end - start] for signal in span}
        return held

    def _write(self, wanted: Registers) -> None:
        for span in spans(wanted, MAX_WRITE):
            what = ", ".join(f"{signal} = {_shown(signal, wanted[signal])}" for signal in span)
            words = [word for signal in span for word in wanted[signal]]
            self._line.write(self._number, span[0].address, words, f"{self._place}: {what}")

    def _different(self, wanted: Registers) -> Registers:
        """The part that differs from the values held by the drive."""
        held = self._held(wanted)
        return {signal: words for signal, words in wanted.items() if not _same(signal, words, held[signal])}


def _same(signal: RegisterSignal, wanted: list[int], held: list[int]) -> bool:
    """Integers must be equal; a float may be rounded by the drive."""
    if signal.format.whole:
        return wanted == held
    return math.isclose(signal.format.decode(wanted)[0], signal.format.decode(held)[0], rel_tol=1e-4)


def _shown(signal: RegisterSignal, registers: list[int]) -> str:
    return f"{signal.format.decode(registers)[0]:.9g}"


class ControlToken:
    """Exclusive control of the units of a line, where their map has the signal `control_owner`; otherwise nothing.

    Modbus does not tell a drive which host writes. Drives with such a register hold the token of one host, refuse that
    of another, and drop it if it is not repeated for the time of their watchdog. Every unit is taken before the first
    axis is enabled, so that two hosts cannot enable two axes of one machine, and is kept until the connection is
    closed. Blocking, on the thread of the line.
    """

    def __init__(self, units: Sequence[RegisterUnit], registers: RegisterMap, watch: HostWatch, host: int) -> None:
        """`host`: a large random number, the same in each connection of one host: what a silent drive still holds of
        its last connection is its own.
        """
        self._signal = registers.signals.get(OWNER)
        self._units = tuple(units) if self._signal is not None else ()
        self._watch = watch
        most = 0 if self._signal is None else self._signal.format.most
        self._token = 1 + host % max(1, int(most))
        self._held = False

    def take(self) -> None:
        """Raises NotReady if another host has control of a unit; then none is taken."""
        if self._held or self._signal is None:
            return
        taken: list[RegisterUnit] = []
        try:
            for unit in self._units:
                unit.write({OWNER: self._token})  # also if the drive holds it from before: its time begins anew
                unit.settle(RegisterSetting(self._signal, self._token))
                taken.append(unit)
        except WrongConfiguration as error:
            self._give_up(taken)
            raise NotReady(f"another host has control of this machine, or had it until this moment: {error}") from None
        except BaseException:
            self._give_up(taken)
            raise
        self._held = True

    def renew(self) -> None:
        """With every heartbeat. If another host has taken a unit, nothing may move until a person has checked."""
        for unit in self._units if self._held else ():
            try:
                unit.write({OWNER: self._token})
            except CommunicationLost:
                pass  # reported by the heartbeat
            except WrongConfiguration as error:
                self._watch.seen(f"another host has taken control: {error}")

    def release(self) -> None:
        """May be called twice."""
        held, self._held = self._held, False
        self._give_up(self._units if held else ())

    def _give_up(self, units: Sequence[RegisterUnit]) -> None:
        for unit in units:
            with suppress(DriveError):  # it lapses
                if unit.integer(OWNER) == self._token:
                    unit.write({OWNER: 0})
