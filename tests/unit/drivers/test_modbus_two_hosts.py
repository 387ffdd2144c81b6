"""Two hosts enable axes of one Modbus machine at the same time, over many orders of their register accesses."""

import itertools
import random
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import cast

import pytest
from greenlet import getcurrent, greenlet

from drivers.cia402 import states
from drivers.cia402.axis import Cia402Axis
from drivers.cia402.host_watch import HostWatch
from drivers.cia402.machine import enable_alone
from drivers.cia402.states import Controlword
from drivers.errors import DriveError, MotionForbidden, NotReady
from drivers.modbus.device import ModbusDevice
from drivers.modbus.line import MasterLine
from drivers.modbus.profile import TcpProfile
from drivers.modbus.registers import RegisterMap
from drivers.modbus.unit import OWNER, ControlToken, RegisterUnit
from tests.unit.drivers.modbus_bank import HIGH, Bank, Clock, Request, Wire, drive, following, get, profile_on, put

LINE = TcpProfile(transport="tcp", host="127.0.0.1", timeout=0.5, watchdog=5.0)
PLAIN = replace(HIGH, signals={name: signal for name, signal in HIGH.signals.items() if name != OWNER})
PROFILE = profile_on(LINE, "tcp", axes=2)
LONGEST = 400  # accesses of a host, far more than enabling takes


class Drives(Bank):
    """Units whose owner, where they have one, is that of the virtual drive: another token is refused."""

    owned = 0  # writes of a token

    def answer(self, request: Request) -> bytes:
        owner = HIGH.signals[OWNER]
        if request.function == 16 and request.address == owner.address:
            held, wanted = int(get(self, HIGH, OWNER, request.unit)), int(owner.format.decode(request.words)[0])
            if wanted and held not in (0, wanted):
                return bytes([0x90, 4])
            self.owned += 1
        return super().answer(request)


class Host:
    """One service: its own connection, watch and token, by the number of the host."""

    numbers = itertools.count()

    def __init__(self, drives: Bank, registers: RegisterMap, number: int | None = None) -> None:
        self.wire, self.watch = Wire(drives, Clock()), HostWatch(60.0)
        line = MasterLine(LINE, self.wire.clock, self.wire)
        line.open()
        units = [RegisterUnit(line, axis.unit_id, registers, axis.place) for axis in PROFILE.axes]
        number = next(Host.numbers) if number is None else number
        self.control = ControlToken(units, registers, self.watch, number)
        devices = [ModbusDevice(axis, PROFILE, registers, "", line, self.control) for axis in PROFILE.axes]
        self.axes = [Cia402Axis(device, self.watch) for device in devices]
        for axis in self.axes:
            axis.introduce()
        self.enabled = False

    def enable(self, number: int) -> None:
        """As `Cia402Machine.enable`. Any motion would begin after it."""
        try:
            enable_alone((self.axes[number],), self.axes, threading.Event())
            self.enabled = True
        except DriveError:
            pass


@dataclass
class Outcome:
    enabled: list[bool]
    both_energised: bool
    accesses: list[int]


def race(registers: RegisterMap, wanted: tuple[int, int], order: Iterator[int]) -> Outcome:
    """Each number of `order` lets a host make its next access; then the first goes on to its end, and the other."""
    drives, energised = prepared(registers), list[bool]()
    hosts = [Host(drives, registers) for _ in range(2)]
    runs = [greenlet(lambda host=host, axis=axis: host.enable(axis)) for host, axis in zip(hosts, wanted, strict=True)]
    desk, made, ask = getcurrent(), [0, 0], drives.answer

    def asked(number: int) -> Callable[[Request], bytes]:
        def answer(request: Request) -> bytes:
            desk.switch()
            made[number] += 1
            return ask(request)

        return answer

    for number, host in enumerate(hosts):
        host.wire.bank = cast(Bank, SimpleNamespace(answer=asked(number)))
    for number in itertools.chain(order, [0] * LONGEST, [1] * LONGEST):
        runs[number].switch()  # nothing happens once it has ended
        each = [states.decode(int(get(drives, registers, "statusword", unit))) for unit in (1, 2)]
        energised.append(all(state in states.ENERGISED for state in each))
        if runs[0].dead and runs[1].dead:
            break
    assert runs[0].dead
    assert runs[1].dead
    return Outcome([host.enabled for host in hosts], any(energised), made)


def prepared(registers: RegisterMap) -> Drives:
    drives = Drives("tcp", {unit: dict(words) for unit, words in NEW.registers.items()})
    following(drives, registers)
    return drives


NEW = Drives("tcp")
for axis in PROFILE.axes:
    drive(NEW, HIGH, axis.unit_id, axis.rated_torque)


def outcomes(registers: RegisterMap, wanted: tuple[int, int]) -> list[Outcome]:
    """Of every order in which the hosts change at most twice, and of 300 in which they change at random."""
    most = max(race(registers, wanted, iter([0] * LONGEST)).accesses)
    found = list[Outcome]()
    for first, begin in itertools.product((0, 1), range(most + 1)):
        for length in range(1, most + 1):
            found.append(race(registers, wanted, iter([first] * begin + [1 - first] * length + [first] * most)))
            if found[-1].accesses[1 - first] < length:
                break  # the other host had ended: longer is the same
    rng = random.Random(27)
    for _ in range(300):
        share = rng.random()
        found.append(race(registers, wanted, iter([int(rng.random() < share) for _ in range(4 * most)])))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("wanted", [(0, 1), (0, 0)], ids=["two axes", "the same axis"])
def test_with_an_owner_register_one_host_at_most_gives_energy(wanted: tuple[int, int]) -> None:
    found = outcomes(HIGH, wanted)
    assert not any(outcome.both_energised for outcome in found)
    assert not any(all(outcome.enabled) for outcome in found)
    assert sum(any(outcome.enabled) for outcome in found) > len(found) / 2


@pytest.mark.slow
def test_without_it_two_hosts_never_both_go_on_to_move_two_axes() -> None:
    """They may both energise theirs; at least one sees the other's and takes its own back."""
    found = outcomes(PLAIN, (0, 1))
    assert not any(all(outcome.enabled) for outcome in found)
    assert any(outcome.both_energised for outcome in found)
    assert any(any(outcome.enabled) for outcome in found)


def one_and_other(registers: RegisterMap = HIGH) -> tuple[Drives, Host, Host]:
    drives = prepared(registers)
    return drives, Host(drives, registers), Host(drives, registers)


def test_control_is_kept_until_it_is_released() -> None:
    drives, one, other = one_and_other()
    one.enable(0)
    assert one.enabled
    one.axes[0].disable()
    with pytest.raises(NotReady, match=r"another host has control .*joint_1 \(unit 1\): control_owner"):
        enable_alone((other.axes[1],), other.axes, threading.Event())
    assert get(drives, HIGH, "controlword", 2) == Controlword.DISABLE_VOLTAGE
    one.control.release()
    other.enable(1)
    assert other.enabled
    one.control.release()  # no longer its own
    assert get(drives, HIGH, OWNER, 1) == get(drives, HIGH, OWNER, 2) != 0


def test_a_machine_that_is_taken_in_part_is_given_back() -> None:
    drives, one, _ = one_and_other()
    put(drives, HIGH, 2, OWNER, 4711)
    one.enable(0)
    assert not one.enabled
    assert (get(drives, HIGH, OWNER, 1), get(drives, HIGH, OWNER, 2)) == (0, 4711)


def test_who_loses_control_moves_nothing_until_a_person_has_checked() -> None:
    drives, one, _ = one_and_other()
    one.enable(0)
    one.control.renew()
    one.watch.check()
    put(drives, HIGH, 1, OWNER, 4711)
    one.control.renew()
    with pytest.raises(MotionForbidden, match=r"another host has taken control: joint_1 \(unit 1\)"):
        one.watch.check()


@pytest.mark.parametrize("registers", [HIGH, PLAIN], ids=["owner", "none"])
def test_an_axis_that_another_host_has_enabled_is_not_taken_over(registers: RegisterMap) -> None:
    drives, one, _ = one_and_other(registers)
    put(drives, registers, 1, "statusword", 0x27)
    with pytest.raises(MotionForbidden, match="this service did not enable it"):
        enable_alone((one.axes[0],), one.axes, threading.Event())


def test_what_a_silent_drive_holds_of_the_last_connection_is_still_of_this_host() -> None:
    drives = prepared(HIGH)
    Host(drives, HIGH, 7).control.take()  # and its connection is lost, so that nobody releases
    with pytest.raises(NotReady, match="another host has control"):
        Host(drives, HIGH, 8).control.take()
    before = drives.owned
    Host(drives, HIGH, 7).control.take()
    assert drives.owned == before + len(PROFILE.axes)  # else the time of the watchdog goes on from before
