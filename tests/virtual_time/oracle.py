"""What is allowed, kept beside a sequence from what persons did and were answered; the truth is read from the machine.

Nothing here asks the service what it thinks, but its statement, which is compared with the truth. Judged is each change
of energy, at its moment, in whatever thread it happens; `trouble` collects what was wrong, because such a moment is no
place to raise. All times are s on the virtual clock.

The rule: **an axis takes energy only with the lease, without a stop that nobody released, and for a command of a person
that is younger than the last end of all intentions (stop, gap, lease trouble, kill, restart), was not given while the
machine was stopped, and was not refused.** A command whose answer is still open counts as accepted. What cannot be
known from outside is decided in favour of the service; each such place says so.
"""

import itertools
import sqlite3
from concurrent.futures import Future
from dataclasses import dataclass, field

import httpx

from tests.virtual_time import primitives
from tests.virtual_time.machine import VirtualMachine
from tests.virtual_time.service import VirtualService

REACTION = 0.5  # s from a stop until no axis has energy, where the bus works
RAMPED = 1.0  # s, the same from a missed sign of life: by the ramp of a move, 0.45 s from its speed, and no quick stop
BY_THEMSELVES = 4.5  # s without their host until no axis has energy: time-out of the drives (3 s) and their ramps
STORED = 2.0  # s after which a stop is stored, if the host runs and the database is free
STALE = 2.1  # s after which an axis that did not tell its velocity is not said to stand, with the way of the answer
IN_FLIGHT = 0.05  # s in which a stop reaches the service and frames that are under way reach the drives
KEPT = ("recorded", "identified")
OVER = ("planned", "paused", "measured", "completed", "aborted")  # a campaign in such a state moves nothing


@dataclass(eq=False)
class Command:
    """A start or resume. `latched`: it was given while the machine was stopped for certain, so it excuses nothing."""

    order: int  # among all commands and ends
    campaign: int
    given: float
    latched: bool
    answer: "Future[httpx.Response]"
    attended: float = float("inf")  # s without a sign of life after which it excuses nothing
    alive: float = float("inf")  # s, of its answer or the last sign of life
    over: bool = False  # its campaign is paused, aborted or finished since, or was resumed by a younger command

    @property
    def open(self) -> bool:
        return not self.answer.done()

    @property
    def refused(self) -> bool:
        return self.answer.done() and (self.answer.exception() is not None or self.answer.result().status_code >= 300)


@dataclass(eq=False)
class End:
    """What ends every intention of a lower order; the service can know it since `known`. `latches`: until a person
    releases it.
    """

    order: int
    why: str
    given: float
    known: float
    latches: bool = False
    released: bool = False  # perhaps: a person who had seen it has asked for it
    forgotten: bool = False  # perhaps: the service was killed before it was stored


@dataclass
class Counts:
    """Of one sequence."""

    energised: int = 0
    stops: int = 0
    superseded: int = 0
    started: int = 0
    refused: int = 0
    kills: int = 0
    gaps: int = 0
    recorded: int = 0
    statements: int = 0


@dataclass
class Oracle:
    service: VirtualService
    machine: VirtualMachine
    commands: list[Command] = field(default_factory=list[Command])
    ends: list[End] = field(default_factory=list[End])
    approved: dict[int, int] = field(default_factory=dict[int, int])
    """When the plan of a campaign was approved last, or somebody asked to: order among all commands and ends."""
    held_up: float = 0.0
    """Until then, s, the database was blocked or the host suspended: a stop may not be stored."""
    lease_lost: float = float("inf")  # another service has it since
    troubled: list[tuple[float, float]] = field(default_factory=list[tuple[float, float]])  # the bus was cut
    trouble: list[str] = field(default_factory=list[str])
    counts: Counts = field(default_factory=Counts)
    did: list[str] = field(default_factory=list[str])

    def __post_init__(self) -> None:
        self._order = itertools.count()
        self.on: dict[str, float] = dict.fromkeys(self.machine.energised(), primitives.world.now)
        """Since when an axis has had energy."""
        self._idle: float | None = None  # since when no command can excuse any energy
        self._kept: dict[tuple[int, int], str] = {}  # hash of each recording, by campaign and sweep: for ever
        self.machine.wire.cabinet.changed = self.energy_changed

    # -- what happened

    def command(self, campaign: int, answer: "Future[httpx.Response]", attended: float = float("inf")) -> None:
        now = primitives.world.now
        command = Command(next(self._order), campaign, now, self.stopped(now), answer, attended)
        answer.add_done_callback(lambda _: self._answered(command))
        self.commands.append(command)

    def _answered(self, command: Command) -> None:
        if command.refused:
            return
        for each in self.commands:
            each.over = each.over or (each.campaign == command.campaign and each.order < command.order)
        self._shown(command)

    def shown(self, campaign: int) -> None:
        """A sign of life was given, or arrived at last."""
        for command in self.commands:
            if command.campaign == campaign and not command.open:
                self._shown(command)

    def _shown(self, command: Command) -> None:
        if command.attended < float("inf"):
            command.alive = now = primitives.world.now
            primitives.world.at(now + command.attended + RAMPED, lambda: self._missed(command, now))

    def _missed(self, command: Command, alive: float) -> None:
        now, missed = primitives.world.now, alive + command.attended
        asleep = self.service.process.suspended or self.service.process.killed or self.held_up > alive
        if command.alive == alive and not command.over and not asleep and not self._excused(now):
            self._has_reacted("a sign of life was missed", missed, RAMPED)

    def approval(self, campaign: int) -> None:
        self.approved[campaign] = next(self._order)

    def end(self, why: str, known: float | None = None, latches: bool = False, within: float | None = None) -> None:
        """All that was wanted before now is over; `within`, s after it is known: no axis has the energy it had."""
        now = primitives.world.now
        known = now if known is None else known
        self.ends.append(End(next(self._order), why, now, known, latches))
        if within is not None:
            primitives.world.at(known + within, lambda: self._has_reacted(why, known, within))

    def forget(self) -> None:
        """The service was killed: a stop that was not stored is forgotten, perhaps."""
        killed = next(end.known for end in reversed(self.ends) if end.why == "kill")
        for end in self.ends:
            stored = end.latches and max(end.known, self.held_up) + STORED <= killed
            end.forgotten = end.forgotten or not stored

    def lease_is_lost(self) -> None:
        """At this moment another service takes it: the machine stands already."""
        self.lease_lost = primitives.world.now
        for joint in self.on:
            self._wrong(joint, "has energy while another service takes the machine")

    def stopped(self, at: float) -> bool:
        """Whether a stop that nobody can have released holds the machine for certain."""
        return any(end.latches and not end.released and not end.forgotten and end.known <= at for end in self.ends)

    def released(self, seen: float) -> None:
        """A person asks to release what was there at `seen`: whatever was younger stays. Perhaps it is refused."""
        for end in self.ends:
            end.released = end.released or end.known <= seen

    # -- what is judged

    def energy_changed(self, joint: str, on: bool) -> None:
        now = primitives.world.now
        if not on:
            self.on.pop(joint, None)
            return
        self.on[joint] = now
        self.counts.energised += 1
        at = now - IN_FLIGHT
        if self.stopped(at):
            self._wrong(joint, "got energy while the machine is stopped")
        elif now > self.lease_lost:
            self._wrong(joint, "got energy without the lease")
        elif not self._excused(at):
            self._wrong(joint, "got energy that no command of a person excuses")
        self.judge_statement()

    def _excused(self, at: float) -> bool:
        return any(self._excuses(command, at) for command in self.commands)

    def _excuses(self, command: Command, at: float) -> bool:
        if command.latched or command.refused or command.over or at > command.alive + command.attended:
            return False
        ends = [end for end in self.ends if end.known <= at]
        stops = [end.order for end in ends if end.latches and not end.forgotten]
        approved = self.approved.get(command.campaign)
        if approved is None or any(approved < stop for stop in stops):
            return False
        return all(command.order > end.order for end in ends)

    def _has_reacted(self, why: str, known: float, within: float) -> None:
        if within < BY_THEMSELVES and self._bus_troubled(known, known + within):
            primitives.world.at(known + BY_THEMSELVES, lambda: self._has_reacted(why, known, BY_THEMSELVES))
            return
        for joint, since in self.on.items():
            if since <= known + IN_FLIGHT:
                self._wrong(joint, f"still has energy {within:g} s after: {why}")

    def judge_statement(self) -> None:
        """Never better than the truth: what stands has no energy."""
        machine = self.service.machine_inside
        if machine is None:
            return
        self.counts.statements += 1
        for joint, axis in machine.statement.axes.items():
            if axis.state.value != "stands":
                continue
            if joint in self.on:
                self._wrong(joint, f"has energy and is stated to stand, age {axis.age} s")
            silent = primitives.world.now - self.machine.told(joint)
            if silent > STALE:
                self._wrong(joint, f"is stated to stand, and has told no velocity for {silent:.2f} s")

    def judge(self) -> None:
        """Between two steps. AssertionError with all that was wrong since the last time."""
        self.judge_statement()
        self._judge_store()
        self._judge_idle()
        if self.trouble:
            story, log = "\n".join(self.did), "\n".join(self.service.log[-12:])
            ends = "\n".join(str(end) for end in self.ends[-4:])
            wanted = "\n".join(
                f"{each.given:.4f} of {each.campaign}: latched {each.latched}, refused {each.refused}, over {each.over}"
                for each in self.commands
            )
            raise AssertionError(
                f"{'; '.join(self.trouble)}\nwhat was done:\n{story}\ncommands:\n{wanted}\nends:\n{ends}\n"
                f"log of the service:\n{log}"
            )

    def _judge_idle(self) -> None:
        """A machine that nobody has a use for gives its energy up, whatever ended the use."""
        now = primitives.world.now
        if any(not command.refused and not command.over for command in self.commands):
            self._idle = None
            return
        self._idle = now if self._idle is None else self._idle
        if now - self._idle > (BY_THEMSELVES if self._bus_troubled(self._idle, now) else REACTION):
            for joint, since in self.on.items():
                self._wrong(joint, f"has energy since {since:.4f}, and no campaign runs since {self._idle:.4f}")

    def _bus_troubled(self, start: float, end: float) -> bool:
        return any(began <= end and over >= start for began, over in self.troubled)

    def _judge_store(self) -> None:
        """Nothing is lost, nothing is counted twice; a campaign that is over excuses nothing any more."""
        database = sqlite3.connect(f"file:{self.service.data}/sweepid.sqlite?mode=ro", uri=True)
        try:
            campaigns = dict(database.execute("SELECT id, state FROM campaign"))
            sweeps = {(c, n): state for c, n, state in database.execute("SELECT campaign_id, number, state FROM sweep")}
            rows = database.execute(
                "SELECT s.campaign_id, s.number, r.attempt, r.sha256, r.path FROM recording r JOIN sweep s ON "
                "r.sweep_id = s.id WHERE r.state = 'complete'"
            ).fetchall()
        finally:
            database.close()
        found: dict[tuple[int, int], str] = {}
        for campaign, number, attempt, sha256, path in rows:
            sweep = campaign, number
            if sweep in found:
                self.trouble.append(f"sweep {sweep} was recorded twice, attempt {attempt}")
            if sha256 in found.values():
                self.trouble.append(f"the recording of sweep {sweep} is that of another one as well: {path}")
            found[sweep] = sha256
        for sweep, state in sweeps.items():
            if (state.lower() in KEPT) != (sweep in found):
                self.trouble.append(f"sweep {sweep} is {state}, recording {sweep in found}")
        for sweep, sha256 in self._kept.items():
            if found.get(sweep) != sha256:
                self.trouble.append(f"sweep {sweep} was recorded, and is lost or replaced: {sweeps[sweep]}")
        self.counts.recorded += len(found.keys() - self._kept.keys())
        self._kept = found
        for campaign, state in campaigns.items():
            mine = [command for command in self.commands if command.campaign == campaign]
            if state.lower() in OVER and not any(command.open for command in mine):
                for command in mine:
                    command.over = True

    def _wrong(self, joint: str, what: str) -> None:
        self.trouble.append(f"{primitives.world.now:.4f}: {joint} {what}")
