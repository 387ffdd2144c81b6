"""One stop under one condition: what was said of it within 1.2 s, and the truth of the virtual machine.

Ways: `port` (the stop process), `api`, `both` at once with one press, as a page does it. A way says what its answer
says; without an answer within `ANSWERED` it says nothing.
"""

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from random import Random
from typing import Any

from tests.virtual_time.canbus import Wire
from tests.virtual_time.clock import Clock
from tests.virtual_time.machine import VirtualMachine
from tests.virtual_time.modbus import Gateway
from tests.virtual_time.scheduler import drawn
from tests.virtual_time.service import VirtualService

ANSWERED = 1.2  # s
BEFORE, AFTER = (1e-3, 3.0), (1e-3, 0.3)  # s by which a condition begins before the stop or after it
HELD = (0.02, 6.0)  # s that a process is suspended or blocked
REST = 0.5  # s after the answer, and after a suspension, in which nothing may get energy
STANDSTILL = 1e-3  # rad/s, `standstill_velocity` of the profiles
WAYS = ("port", "api", "both")

Truth = Mapping[str, str]  # by joint why it does not stand without energy; "": it does


@dataclass(frozen=True)
class Answer:
    """Of a way, `at` s after the press."""

    way: str
    at: float
    status: int
    body: Mapping[str, Any]


@dataclass
class Stop:
    """What was said, and what was so."""

    way: str
    condition: str
    answers: list[Answer] = field(default_factory=list[Answer])
    truth: Truth = field(default_factory=dict[str, str])  # at `ANSWERED`
    moved: bool = False  # an axis had energy when the button was pressed
    wrong: list[str] = field(default_factory=list[str])

    @property
    def said(self) -> list[Answer]:
        """In time."""
        return [answer for answer in self.answers if answer.at <= ANSWERED]

    @property
    def summary(self) -> str:
        """For a table: what was said at `ANSWERED` by all ways together, and what was so."""
        if any(answer.status == 200 for answer in self.said):
            return "confirmed, stands"
        said = "not confirmed" if self.said else "silent"
        return f"{said}, {'does not stand' if any(self.truth.values()) else 'stands'}"

    def note(self, answer: Answer, truth: Truth) -> None:
        """An answer, in time or late, and the truth at its moment."""
        self.answers.append(answer)
        confirmed, unconfirmed = {*answer.body.get("confirmed", ())}, {*answer.body.get("unconfirmed", {})}
        self._check(answer.status in (200, 503), f"{answer.way}: status {answer.status}")
        for joint in confirmed:
            self._check(not truth[joint], f"{answer.way}: {joint} is confirmed, but {truth[joint]}")
        self._check(not confirmed & unconfirmed, f"{answer.way}: {confirmed & unconfirmed} in both lists")
        missing = truth.keys() - confirmed - unconfirmed
        self._check(not missing, f"{answer.way}: {missing} in no list")
        self._check((answer.status == 200) == (not unconfirmed), f"{answer.way}: status {answer.status}")
        detail = str(answer.body.get("detail", "stop; use the emergency stop"))
        whole = detail.startswith("stop ") and detail.endswith("; use the emergency stop")
        self._check(answer.status == 200 or whole, f"{answer.way}: {detail}")

    def check_said(self) -> None:
        """Who may be silent, who must confirm."""
        for way in ("port", "api") if self.way == "both" else (self.way,):
            answer = next((each for each in self.said if each.way == way), None)
            held = way == "api" and self.condition in HOLDING
            self._check(held or answer is not None, f"{way}: no answer within {ANSWERED} s")
            if self.condition in HEARD and answer is not None and not held:
                self._check(answer.status == 200, f"{way}: false alarm: {answer.body}")

    def check_rest(self, pressed: float, energy: Sequence[tuple[float, str, bool]]) -> None:
        """What was confirmed stays so."""
        for answer in self.answers:
            for when, joint, on in energy:
                late = when - pressed
                lost = on and late > answer.at and joint in answer.body.get("confirmed", ())
                self._check(
                    not lost, f"{answer.way}: {joint} is confirmed, and has energy {late:.4f} s after the press"
                )

    def _check(self, so: bool, what: str) -> None:
        if not so:
            self.wrong.append(what)


def truth_of(machine: VirtualMachine) -> Truth:
    def why(axis: Mapping[str, Any]) -> str:
        if axis["energised"]:
            return f"has energy, {axis['velocity']:.3g} rad/s"
        return "" if abs(axis["velocity"]) <= STANDSTILL else f"turns at {axis['velocity']:.3g} rad/s"

    return {joint: why(axis) for joint, axis in machine.axes().items()}


# -- conditions: each returns what it is in detail

Begin = Callable[[VirtualMachine, VirtualService, Clock, Random], str]


def nothing(machine: VirtualMachine, service: VirtualService, clock: Clock, chance: Random) -> str:
    del machine, service, clock, chance
    return ""


def frozen_drives(machine: VirtualMachine, service: VirtualService, clock: Clock, chance: Random) -> str:
    del service, clock, chance
    machine.wire.freeze()
    return ""


def lost_commands(machine: VirtualMachine, service: VirtualService, clock: Clock, chance: Random) -> str:
    del service, clock
    return _lose(machine.wire, chance, commands=True)


def lost_answers(machine: VirtualMachine, service: VirtualService, clock: Clock, chance: Random) -> str:
    del service, clock
    return _lose(machine.wire, chance, commands=False)


def gateway_gone(machine: VirtualMachine, service: VirtualService, clock: Clock, chance: Random) -> str:
    """It fails what is open and refuses what is new; or nothing passes and nothing fails."""
    del service, clock
    wire = machine.wire
    if chance.random() < 0.5:
        wire.cut()
        return "refused"
    if isinstance(wire, Gateway):
        wire.gone = "silent"
    else:
        wire.lost = lambda _identifier, _data: True
    return "silent"


def suspended_host(machine: VirtualMachine, service: VirtualService, clock: Clock, chance: Random) -> str:
    del machine
    seconds = drawn(chance, HELD)
    clock.suspend(service.process, seconds)
    return f"{seconds:.3f} s"


def busy_loop(machine: VirtualMachine, service: VirtualService, clock: Clock, chance: Random) -> str:
    del machine, clock
    seconds = drawn(chance, HELD)
    service.block_loop(seconds)
    return f"{seconds:.3f} s"


CONDITIONS: dict[str, Begin] = {
    "nothing": nothing,
    "frozen drives": frozen_drives,
    "lost commands": lost_commands,
    "lost answers": lost_answers,
    "gateway gone": gateway_gone,
    "suspended host": suspended_host,
    "busy loop": busy_loop,
}
HOLDING = ("suspended host", "busy loop")
"""The service does not answer, the drives do."""
HEARD = ("nothing", "busy loop")
"""The port has to confirm. Not with a suspended service: on CANopen the drives are made deaf after 0.1 s, and an axis
that brakes longer than that reports its standstill to nobody.
"""

_SYNC = 0x080
_REQUESTS = (0x000, 0x200, 0x300, 0x400, 0x500, 0x600)  # COB-IDs without node: NMT, RPDO, SDO
_HEARTBEAT, _WRITE = 0x700, 16


def _lose(wire: Wire | Gateway, chance: Random, *, commands: bool) -> str:
    """All of them, those of some nodes, or of some kinds; each time or every other time."""
    nodes = {number for number in range(1, 7) if chance.random() < 0.5} if chance.random() < 0.5 else {*range(1, 7)}
    rate = chance.choice((1.0, 1.0, 0.5))
    some = chance.random() < 0.5
    what = f"{'some kinds' if some else 'all'} of {sorted(nodes)}, {rate:g}"

    def adu(data: bytes, command: bool) -> bool:
        concerned = command == commands and data[6] in nodes and (data[7] == _WRITE or not some)
        return concerned and chance.random() < rate

    def frame(identifier: int, data: bytes) -> bool:
        function, node = identifier & ~0x7F, identifier & 0x7F
        command = function in _REQUESTS or identifier == _SYNC or (function == _HEARTBEAT and node > 6)
        if command != commands:
            return False
        if function == 0 and len(data) > 1:
            node = data[1]
        concerned = node in nodes or (not node and len(nodes) == 6)
        kind = function == 0x600 if commands else function == _HEARTBEAT
        return concerned and not (some and kind) and chance.random() < rate

    if isinstance(wire, Gateway):
        wire.lost = adu
    else:
        wire.lost = frame
    return what


# -- one stop


def press_stop(
    service: VirtualService,
    machine: VirtualMachine,
    clock: Clock,
    seed: int,
    condition: str,
    way: str,
    within: float,
) -> Stop:
    """At a moment of the next `within` s. AssertionError if something was said that is not so."""
    chance, stop = Random(f"{condition} {way} {seed}"), Stop(way, condition)
    begin = partial(CONDITIONS[condition], machine, service, clock, chance)
    moment = within * chance.random()
    lead = chance.choice((0.0, drawn(chance, BEFORE), -drawn(chance, AFTER)))
    clock.sleep(moment)
    detail = ""
    if lead >= 0:
        detail = begin()
        clock.sleep(lead)
    pressed = clock.now
    stop.moved = any(truth_of(machine).values())

    def ask(way: str) -> None:
        if way == "port":
            status, body = service.press_stop(press="one").get()
        else:
            answer = service.send("POST", "/stop?by=Ada&why=test&press=one").result()
            status, body = answer.status_code, answer.json()
        stop.note(Answer(way, clock.now - pressed, status, body), truth_of(machine))

    ways = ("port", "api") if way == "both" else (way,)
    threads = [threading.Thread(target=ask, args=[each], name=f"STOP by {each}") for each in ways]
    for thread in threads:
        thread.start()
    if lead < 0:
        clock.sleep(-lead)
        detail = begin()
    clock.sleep(max(0.0, pressed + ANSWERED - clock.now))
    stop.truth = truth_of(machine)
    stop.check_said()
    for thread in threads:  # also what is said later must be so
        thread.join()
    clock.sleep(REST)
    stop.check_rest(pressed, machine.wire.cabinet.energy)
    when = f"{abs(lead):.3f} s {'before' if lead >= 0 else 'after'} STOP by {way}, at {pressed:.3f} s"
    assert not stop.wrong, "\n".join([f"{condition} ({detail}) {when}:", *stop.wrong, *map(str, stop.answers)])
    return stop
