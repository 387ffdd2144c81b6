"""Random sequences of what persons, drives and computers do to a machine, and the oracle after each step.

The oracle reads the truth from the virtual machine, never from the service: **no axis has energy without a lease, with
a stop older than the reaction time of the drives, or without a person's command younger than the last stop; no sweep is
lost or counted twice.**
"""

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from random import Random
from typing import Any

import httpx

from tests.virtual_time.clock import Clock
from tests.virtual_time.machine import VirtualMachine
from tests.virtual_time.service import VirtualService

REACTION = 4.5  # s from a stop until no axis has energy: `host_timeout` of the drives (3 s) and their ramp
PATIENCE = 120.0  # s for an answer
BETWEEN = (1e-3, 20.0)  # s between two steps, on a logarithmic scale
GAP = (1e-3, 60.0)  # s
KEPT = ("recorded", "identified")


@dataclass
class Intentions:
    """What the persons of a sequence have wanted so far, s on the clock."""

    stopped: float = float("inf")  # the last stop, gap, kill or restart; before all commands: nothing was commanded
    commanded: float = float("-inf")  # the last start or resume that was sent
    stops: list[tuple[float, str]] = field(default_factory=list[tuple[float, str]])


class Sequence:
    """One machine, one service, one campaign, and persons who do anything at any time."""

    def __init__(
        self, service: VirtualService, machine: VirtualMachine, clock: Clock, campaign: int, seed: int, pending: bool
    ) -> None:
        """`pending`: a person does not wait for the answer of a start before the next thing happens."""
        self.service, self.machine, self.clock, self.campaign = service, machine, clock, campaign
        self.chance, self.pending = Random(f"sequence {seed}"), pending
        self.wanted = Intentions()
        self.did: list[str] = []
        self.kept: dict[int, str] = {}  # sweeps whose recording is stored, by number: for ever
        self._seen = len(machine.wire.cabinet.energy)

    def run(self, steps: int) -> str:
        """What was done. AssertionError."""
        for number in range(steps):
            action = self.chance.choices([each for each, _ in ACTIONS], [weight for _, weight in ACTIONS])[0]
            if number == 0:
                action = start
            self.did.append(f"{self.clock.now:.3f} {action.__name__}")
            action(self)
            self._judge()
            low, high = BETWEEN
            self.clock.sleep(low * (high / low) ** self.chance.random())
            self._judge()
        self.clock.sleep(REACTION)
        self._judge()
        self._judge_sweeps()
        return f"{len(self.did)} steps, energy {self._seen} times, kept {len(self.kept)}"

    # -- what may happen

    def post(self, path: str, content: object = None, wait: bool = True) -> "Future[httpx.Response] | None":
        try:
            answer = self.service.send("POST", path, content)
        except httpx.ConnectError:
            return None
        if wait:
            try:
                answer.result(PATIENCE)
            except (httpx.HTTPError, TimeoutError):
                return None
        return answer

    def command(self, word: str, content: object) -> None:
        self.wanted.commanded = self.clock.now
        self.post(f"/campaigns/{self.campaign}/{word}", content, wait=not self.pending)

    def ended(self, why: str) -> None:
        """From now on every earlier intention is over."""
        self.wanted.stopped = self.clock.now
        self.wanted.stops.append((self.clock.now, why))

    def _judge(self) -> None:
        """Every change of energy since the last look, and what has energy now."""
        energy = self.machine.wire.cabinet.energy
        for when, joint, on in energy[self._seen :]:
            if on:
                self._may(joint, when, "got energy")
        self._seen = len(energy)
        now = self.clock.now
        for joint in self.machine.energised():
            if self.wanted.commanded <= self.wanted.stopped:
                assert now - self.wanted.stopped < REACTION, self._told(joint, now, "still has energy")
            assert not self.service.process.killed or now - self.wanted.stopped < REACTION, self._told(
                joint, now, "has energy without a service"
            )

    def _may(self, joint: str, when: float, what: str) -> None:
        younger = self.wanted.commanded > self.wanted.stopped
        before = not younger and when <= self.wanted.stopped and self.wanted.commanded > float("-inf")
        assert younger or before, self._told(joint, when, what)

    def _told(self, joint: str, when: float, what: str) -> str:
        story = "\n".join(self.did)
        log = "\n".join(self.service.log[-12:])
        last = f"last stop {self.wanted.stops[-1:]}, last command {self.wanted.commanded:.3f}"
        return f"{joint} {what} at {when:.3f}; {last}; what was done:\n{story}\nlog of the service:\n{log}"

    def _judge_sweeps(self) -> None:
        """A person puts all right; what was once stored is there, once."""
        if self.service.process.killed:
            self.service.start()
        answer = self.service.send("GET", f"/campaigns/{self.campaign}/sweeps").result(PATIENCE)
        sweeps: list[dict[str, Any]] = answer.json()
        numbers = [sweep["number"] for sweep in sweeps]
        assert numbers == [*range(1, len(numbers) + 1)], numbers
        for sweep in sweeps:
            if sweep["state"] in KEPT:
                path = f"/campaigns/{self.campaign}/sweeps/{sweep['number']}/recording"
                assert self.service.send("GET", path).result(PATIENCE).status_code == 200, sweep
            elif sweep["number"] in self.kept:
                raise AssertionError(f"lost: {sweep}, was {self.kept[sweep['number']]}")
            if sweep["state"] in KEPT:
                self.kept[sweep["number"]] = sweep["state"]


Action = Callable[[Sequence], None]


def start(it: Sequence) -> None:
    it.command("start", {})


def resume(it: Sequence) -> None:
    it.command("resume", {"repeat": it.chance.random() < 0.5})


def pause(it: Sequence) -> None:
    it.post(f"/campaigns/{it.campaign}/pause")


def stop_by_api(it: Sequence) -> None:
    it.post("/stop", {"by": "Ada", "why": "test"}, wait=it.chance.random() < 0.7)
    it.ended("stop by the API")


def stop_by_port(it: Sequence) -> None:
    it.service.press_stop().get()
    it.ended("stop by the port")


def release(it: Sequence) -> None:
    try:
        stops = it.service.send("GET", "/stop").result(PATIENCE).json()
    except (httpx.HTTPError, TimeoutError):
        return
    numbers = [stop["id"] for stop in stops.get("stops", [])]
    if numbers:
        it.post("/stop/reset", {"by": "Ada", "stops": numbers})


def connect(it: Sequence) -> None:
    it.post("/drives/connect")


def acknowledge(it: Sequence) -> None:
    for joint in ("joint_1", "joint_2"):
        it.post(f"/drives/{joint}/acknowledge")


def put_right(it: Sequence) -> None:
    """A person looks, releases, connects, acknowledges and resumes."""
    for action in (release, connect, acknowledge, resume):
        action(it)


def host_gap(it: Sequence) -> None:
    low, high = GAP
    gap = low * (high / low) ** it.chance.random()
    it.clock.suspend(it.service.process, gap)
    it.clock.sleep(gap)
    if gap > it.machine.host_timeout * 1.1:
        it.ended(f"gap of {gap:.2f} s")


def drive_fault(it: Sequence) -> None:
    it.machine.order("fault", joint=it.chance.choice(("joint_1", "joint_2")), code=0x2310)


def blocked_database(it: Sequence) -> None:
    with it.service.blocked_database():
        it.clock.sleep(0.01 * 1000 ** it.chance.random())


def kill(it: Sequence) -> None:
    if not it.service.process.killed:
        it.service.kill()
        it.ended("kill")
        it.clock.sleep(it.chance.random() * 5.0)
        it.service.start()
        it.ended("restart")


ACTIONS: list[tuple[Action, float]] = [
    (start, 1.0),
    (resume, 2.0),
    (put_right, 5.0),
    (pause, 1.0),
    (stop_by_api, 2.0),
    (stop_by_port, 2.0),
    (release, 3.0),
    (connect, 1.0),
    (acknowledge, 1.0),
    (host_gap, 1.0),
    (drive_fault, 1.0),
    (blocked_database, 1.0),
    (kill, 0.5),
]
