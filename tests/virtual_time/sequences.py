"""Random sequences of what persons, drives and computers do to a machine; `oracle` judges them.

A person may command without waiting for the answer, and what happens to the computer happens while other things go on:
a host that is suspended, a bus that is cut, a database that is blocked and a kill that comes at a switch of threads are
begun by a step and end during later ones.
"""

import queue
import sqlite3
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import asdict
from random import Random

import httpx

from tests.virtual_time import primitives
from tests.virtual_time.clock import Clock
from tests.virtual_time.machine import VirtualMachine
from tests.virtual_time.oracle import BY_THEMSELVES, IN_FLIGHT, RAMPED, REACTION, Oracle
from tests.virtual_time.scheduler import drawn
from tests.virtual_time.service import VirtualService

PATIENCE = 60.0  # s for an answer that a person waits for
PORT_ANSWERS = 1.25  # s within which the port of the stop process has answered
BETWEEN = (2e-3, 2.0)  # s between two steps, on a logarithmic scale
STEPS = (3, 8)
GAP = (1.0, 60.0)  # s
LONG = (8.0, 20.0)  # s
CUT = (0.05, 8.0)  # s
BLOCKED = (0.01, 8.0)  # s
SWITCHES = (1, 20_000)  # points of the scheduler until a kill
RESTS = 3  # rests of an axis with energy from a start to the end of the first check move
REST = 0.15  # s into such a rest
LOOK = 5e-3  # s
LEASE = 6.0  # s, `lease_time`
LEASE_NOTICED = 0.8 * LEASE  # s without renewal after which the machine stands for certain
LEASE_EARLIEST = 0.25 * LEASE  # s of a blocked database before which the lease cannot be late
ATTENDED = (1.0, 5.0)  # s
AXES = ("joint_1", "joint_2")


class Session:
    """One machine, one service, some campaigns, and persons who do anything at any time."""

    def __init__(
        self,
        service: VirtualService,
        machine: VirtualMachine,
        clock: Clock,
        campaigns: Sequence[int],
        seed: int,
        only: Sequence["Action"] = (),
        steps: tuple[int, int] = STEPS,
    ) -> None:
        """The plan of the first campaign is approved. `only`: nothing else happens; (): everything may."""
        self.service, self.machine, self.clock, self.campaigns = service, machine, clock, campaigns
        self.chance = Random(f"sequence {seed}")
        self.oracle = Oracle(service, machine, approved={campaigns[0]: -1})
        self._steps = steps
        self._actions = [(each, weight or float(bool(only))) for each, weight in ACTIONS if each in only or not only]
        self.awake = self.mended = self.clock.now  # s, when the host is awake and the bus whole again
        self._blocking: threading.Thread | None = None
        self.stolen = False

    def run(self) -> dict[str, int]:
        """How often which thing happened. AssertionError."""
        for number in range(self.chance.randint(*self._steps)):
            wanted = [(each, weight) for each, weight in self._actions if number or each in FIRST]
            action = self.chance.choices([each for each, _ in wanted], [weight for _, weight in wanted])[0]
            self.did(action.__name__)
            action(self)
            self.look()
            self.clock.sleep(self.draw(BETWEEN))
            self.look()
        self.end()
        counts = self.oracle.counts
        for command in self.oracle.commands:
            if command.open or command.answer.exception() is not None:
                continue
            answer = command.answer.result()
            counts.started += answer.status_code < 300
            counts.refused += answer.status_code >= 300
            counts.superseded += "superseded" in answer.text
        return asdict(counts)

    def end(self) -> None:
        """A stop, and then nothing that nobody asked for."""
        self.clock.sleep(max(0.0, self.awake - self.clock.now, self.mended - self.clock.now))
        self.look()
        self.did("the last stop")
        stop_by_port(self)
        self.clock.sleep(3 * REACTION)
        self.look()
        if self._blocking is not None:
            self._blocking.join()
        self.look()

    # -- what every step does

    def did(self, what: str) -> None:
        self.oracle.did.append(f"{self.clock.now:.4f} {what}")

    def draw(self, between: tuple[float, float]) -> float:
        return drawn(self.chance, between)

    def look(self) -> None:
        self.oracle.judge()
        if self.service.process.killed:
            self.bury()
            self.oracle.judge()

    def bury(self) -> None:
        """After a kill: the service is started again, on the files that it left."""
        if self._blocking is not None:
            self._blocking.join()
        self.clock.sleep(self.draw((0.01, 5.0)))
        self.oracle.judge()
        self.service.bury()
        self.oracle.forget()
        self.oracle.lease_lost = float("inf")  # the second service does not renew: it is gone
        self.service.start()
        self.oracle.end("restart")
        self.did("restarted")

    def post(self, path: str, content: object = None) -> "Future[httpx.Response] | None":
        try:
            return self.service.send("POST", path, content)
        except httpx.ConnectError:
            return None

    def command(
        self, campaign: int, answer: "Future[httpx.Response] | None", attended: float | None
    ) -> "Future[httpx.Response] | None":
        if answer is not None:
            self.oracle.command(campaign, answer, float("inf") if attended is None else attended)
        return answer

    def wait(self, answer: "Future[httpx.Response] | None") -> httpx.Response | None:
        """A person waits for it, or does not."""
        if answer is None or self.chance.random() < 0.4:
            return None
        try:
            return answer.result(PATIENCE)
        except (httpx.HTTPError, TimeoutError):
            return None

    def held_up(self, seconds: float) -> None:
        """The host or its database, for so long."""
        self.oracle.held_up = max(self.oracle.held_up, self.clock.now + seconds)

    def cut(self, seconds: float) -> None:
        """The bus, for so long."""
        wire = self.machine.wire
        self.mended = self.clock.now + seconds
        self.oracle.troubled.append((self.clock.now, self.mended + BY_THEMSELVES))
        self.did(f"the bus is cut for {seconds:.3f} s")
        wire.cut()
        primitives.world.at(self.mended, wire.mend)

    def block(self, seconds: float, then: Callable[[sqlite3.Connection], None] = lambda _: None) -> None:
        """Another program holds the database for so long, and does `then` at the end."""
        if self._blocking is not None and self._blocking.is_alive():
            return
        other = sqlite3.connect(self.service.data / "sweepid.sqlite", timeout=0.0, isolation_level=None)
        while True:
            try:
                other.execute("BEGIN IMMEDIATE")
                break
            except sqlite3.OperationalError:  # the service writes
                self.clock.sleep(0.01)
        began = self.clock.now
        self.held_up(seconds)

        def hold() -> None:
            if seconds > LEASE_NOTICED:
                self.clock.sleep(LEASE_EARLIEST)
                self.oracle.end("lease not renewed", known=began + LEASE_NOTICED, within=REACTION)
            self.clock.sleep(began + seconds - self.clock.now)
            then(other)
            other.execute("COMMIT")
            other.close()

        self._blocking = threading.Thread(target=hold, name="other program", daemon=True)
        self._blocking.start()


Action = Callable[[Session], None]


def start(it: Session) -> None:
    """Of a campaign that stands; the other word, which is refused, now and then."""
    it.wait(begin(it))


def begin(it: Session, attended: float | None = None) -> "Future[httpx.Response] | None":
    begun = {command.campaign for command in it.oracle.commands if not command.refused}
    campaign = it.campaigns[it.chance.random() > 0.8]
    word = "resume" if (campaign in begun) is (it.chance.random() < 0.9) else "start"
    content = ({"repeat": True} if word == "resume" else {}) | _attended(attended)
    return it.command(campaign, it.post(f"/campaigns/{campaign}/{word}", content), attended)


def _attended(within: float | None) -> dict[str, object]:
    return {} if within is None else {"attended": {"within_s": within}}


def attended(it: Session) -> None:
    """A start that requires a sign of life, which comes for some time."""
    within = it.draw(ATTENDED)
    it.wait(begin(it, within))
    for _ in range(it.chance.randint(0, 3)):
        it.clock.sleep(0.7 * within)
        it.look()
        for campaign in it.campaigns:
            it.oracle.shown(campaign)
            answer = it.post(f"/campaigns/{campaign}/sign_of_life")
            if answer is not None:
                answer.add_done_callback(lambda _, campaign=campaign: it.oracle.shown(campaign))
    it.clock.sleep(within + RAMPED)


def change_of_mind(it: Session, then: Action = lambda _: None) -> None:
    """A person starts, stops before the answer came, and releases; the start may wait for drives that connect, or for
    the database. `then`: at once after the release.
    """
    wire, what = it.machine.wire, it.chance.random()
    if what < 0.4 and not wire.gone:
        it.cut(0.05)
        it.clock.sleep(0.1)
    elif what < 0.8:
        it.block(it.draw((0.2, 3.0)))
    begin(it)
    it.clock.sleep(it.draw((1e-3, 1.0)))
    it.chance.choice((stop_by_api, stop_by_port))(it)
    it.clock.sleep(it.draw((0.01, 1.0)))
    release(it)
    then(it)
    it.clock.sleep(it.draw((0.1, 2.0)))


def approved_again(it: Session) -> None:
    """As before, and the plan is approved again while the start waits: nothing but its age refuses it."""
    change_of_mind(it, approve)


def broken_off(it: Session) -> None:
    """A person starts, and aborts while an axis has energy and rests: it is about to move, or it is between two moves,
    where nothing but the end of the motion takes its energy away.
    """
    begun, answer = it.clock.now, begin(it)
    cabinet = it.machine.wire.cabinet
    for _ in range(it.chance.randint(1, RESTS)):
        for resting in (False, True):
            while cabinet.resting is not resting and it.clock.now - begun < LONG[0]:
                if answer is None or (answer.done() and (answer.exception() or answer.result().status_code >= 300)):
                    return
                it.clock.sleep(LOOK)
    it.clock.sleep(REST * it.chance.random())
    for campaign in it.campaigns:
        it.post(f"/campaigns/{campaign}/abort", {"why": "test"})
    for _ in range(3):
        it.clock.sleep(0.4 * REACTION)
        it.look()


def pause(it: Session) -> None:
    it.wait(it.post(f"/campaigns/{it.chance.choice(it.campaigns)}/pause"))


def pause_taken_back(it: Session) -> None:
    campaign = it.chance.choice(it.campaigns)
    it.wait(it.post(f"/campaigns/{campaign}/pause"))
    within = it.draw(ATTENDED) if it.chance.random() < 0.5 else None
    it.wait(it.command(campaign, it.post(f"/campaigns/{campaign}/resume", _attended(within)), within))
    if within is not None:
        it.clock.sleep(within + 2 * RAMPED)


def abort(it: Session) -> None:
    it.wait(it.post(f"/campaigns/{it.chance.choice(it.campaigns)}/abort", {"why": "test"}))


def approve(it: Session) -> None:
    """Of one of the plans; that of the first campaign is approved until the first stop."""
    which = it.chance.randrange(len(it.campaigns))
    path = f"/plans/{it.service.plans[which]}/approvals"
    try:
        found = it.service.send("GET", path).result(PATIENCE).json()
    except (httpx.HTTPError, TimeoutError):
        return
    it.oracle.approval(it.campaigns[which])
    it.wait(it.post(path, {"sha256": found["sha256"], "approved_by": "Ada"}))


def stop_by_api(it: Session) -> None:
    answer = it.post("/stop?by=Ada&why=test")
    if answer is None:
        return
    it.oracle.counts.stops += 1
    it.oracle.end("stop by the API", max(it.clock.now, it.awake), latches=True, within=REACTION)
    response = it.wait(answer)
    if response is not None and response.status_code == 200 and it.machine.energised():
        it.oracle.trouble.append("the API confirmed a stop, and an axis has energy")


def stop_by_port(it: Session) -> None:
    if it.service.process.killed:
        return
    it.oracle.counts.stops += 1
    answer = it.service.press_stop()
    it.oracle.end("stop by the port", max(it.clock.now, it.awake), latches=True)
    primitives.world.at(it.clock.now + REACTION, _reacted_to_port(it, it.clock.now))
    asked = it.clock.now
    try:
        status, _ = answer.get(timeout=PORT_ANSWERS)
    except queue.Empty:
        assert it.service.process.killed, f"the port did not answer within {PORT_ANSWERS} s"
        return  # its process ends with the service, after a stop of its own
    if status == 200 and it.machine.energised():
        it.oracle.trouble.append("the port confirmed a stop, and an axis has energy")
    assert it.clock.now - asked <= PORT_ANSWERS


def _reacted_to_port(it: Session, asked: float) -> Callable[[], None]:
    """The stop process works while the service sleeps, but not over a bus that is cut."""
    return lambda: it.oracle._has_reacted("stop by the port", asked, REACTION)  # pyright: ignore[reportPrivateUsage]


def release(it: Session, between: Callable[[], object] = lambda: None) -> None:
    """A person looks, and releases what he saw, but nothing younger."""
    try:
        stops = it.service.send("GET", "/stop").result(PATIENCE).json()
    except (httpx.HTTPError, TimeoutError):
        return
    seen = it.clock.now
    numbers = [stop["id"] for stop in stops["stops"]]
    between()
    if numbers:
        it.oracle.released(seen)
        it.wait(it.post("/stop/reset", {"by": "Ada", "stops": numbers}))


def late_release(it: Session) -> None:
    """A person looks, another one stops, the first releases what he saw and starts: the other stop is in force."""
    stop_by_port(it)
    it.clock.sleep(it.draw((0.1, 1.0)))
    release(it, lambda: (stop_by_port(it), it.clock.sleep(it.draw((0.06, 1.0)))))
    for action in (approve, start):
        action(it)


def stop_outlives_a_kill(it: Session) -> None:
    """Stored, it holds the machine after the restart; nobody releases it."""
    it.chance.choice((stop_by_api, stop_by_port))(it)
    it.clock.sleep(it.draw((0.1, 4.0)))
    kill(it)
    it.clock.sleep(it.draw((0.1, 1.0)))
    it.look()
    for action in (connect, acknowledge, approve, start):
        action(it)


def connect(it: Session) -> None:
    it.wait(it.post("/drives/connect"))


def acknowledge(it: Session) -> None:
    for joint in AXES:
        it.wait(it.post(f"/drives/{joint}/acknowledge"))


def put_right(it: Session) -> None:
    """A person looks, releases, connects, acknowledges, approves and starts or resumes."""
    for action in (release, connect, acknowledge, approve, start):
        action(it)


def let_run(it: Session) -> None:
    """Until a sweep is recorded, if one can be."""
    it.clock.sleep(it.draw(LONG))


def host_gap(it: Session) -> None:
    if it.service.process.killed or it.service.process.suspended:
        return
    gap = it.draw(GAP)
    it.did(f"the host is suspended for {gap:.3f} s")
    it.oracle.counts.gaps += 1
    _asleep(it, gap)
    it.clock.suspend(it.service.process, gap)


def stop_in_a_gap(it: Session) -> None:
    """While an axis has energy, in most cases: the stop process stops it, for the service does not run."""
    it.wait(begin(it))
    it.clock.sleep(it.draw((0.2, 2.0)))
    host_gap(it)
    it.clock.sleep(it.draw((1e-3, 0.5)))
    stop_by_port(it)
    it.clock.sleep(2 * REACTION)


def _asleep(it: Session, gap: float) -> None:
    """Told before it happens: when the host awakes, the end of all intentions is known before anybody is answered."""
    it.awake = it.clock.now + gap
    it.held_up(gap)
    if gap > it.machine.host_timeout:
        began, world = it.clock.now, primitives.world
        gone = it.service.process

        def over() -> None:
            if not gone.killed:
                it.oracle.end(f"gap of {gap:.2f} s", latches=True)

        world.at(it.awake, over)
        if gap > BY_THEMSELVES:
            reacted = it.oracle._has_reacted  # pyright: ignore[reportPrivateUsage]
            world.at(began + BY_THEMSELVES, lambda: reacted("the host is suspended", began, BY_THEMSELVES))


def drive_fault(it: Session) -> None:
    it.machine.order("fault", joint=it.chance.choice(AXES), code=0x2310)


def cut_bus(it: Session) -> None:
    if not it.machine.wire.gone:
        it.cut(it.draw(CUT))


def blocked_database(it: Session) -> None:
    it.block(it.draw(BLOCKED))


def second_service(it: Session) -> None:
    """Nobody renews the lease for its time: another service takes the machine. Only a restart brings it back."""
    if it.service.process.killed or it.service.process.suspended or it.oracle.lease_lost < float("inf"):
        return

    def take(database: sqlite3.Connection) -> None:
        database.execute("UPDATE lease SET owner = 'another service', renewals = renewals + 1")
        it.oracle.lease_is_lost()

    if it.chance.random() < 0.5:
        _asleep(it, LEASE + 2.0)
        it.clock.suspend(it.service.process, LEASE + 2.0)
        it.clock.sleep(LEASE)
        it.block(0.01, take)
    else:
        it.block(LEASE + 0.1, take)


def kill(it: Session) -> None:
    """SIGKILL, now or at a switch of threads within the next moments."""
    if it.service.process.killed:
        return
    it.oracle.counts.kills += 1
    if it.chance.random() < 0.3:
        primitives.world.kill(it.service.process)
        it.oracle.end("kill", within=REACTION)
        return
    doomed = it.service.process

    def die() -> None:
        if not doomed.killed:
            it.did("killed")
            it.oracle.end("kill", within=REACTION)
            primitives.world.kill(doomed)

    primitives.world.interrupt(round(it.draw(SWITCHES)), die)


ACTIONS: list[tuple[Action, float]] = [
    (start, 4.0),
    (put_right, 8.0),
    (change_of_mind, 1.5),
    (broken_off, 0.5),
    (attended, 0.5),
    (let_run, 0.7),
    (pause, 0.7),
    (pause_taken_back, 1.0),
    (abort, 0.5),
    (approve, 0.7),
    (stop_by_api, 1.2),
    (stop_by_port, 1.2),
    (release, 2.5),
    (late_release, 0.5),
    (stop_outlives_a_kill, 0.5),
    (connect, 0.7),
    (acknowledge, 0.7),
    (host_gap, 1.0),
    (stop_in_a_gap, 0.5),
    (drive_fault, 0.7),
    (cut_bus, 1.0),
    (blocked_database, 1.5),
    (second_service, 0.3),
    (kill, 0.5),
    (approved_again, 0.0),  # only where it is asked for
]
FIRST = (
    start,
    change_of_mind,
    approved_again,
    broken_off,
    attended,
    late_release,
    stop_outlives_a_kill,
    stop_in_a_gap,
    host_gap,
    cut_bus,
    blocked_database,
)
assert IN_FLIGHT < REACTION
