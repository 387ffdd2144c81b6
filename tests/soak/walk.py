"""One campaign after the other, disturbed at random moments in a random order; what was promised is asked each time.

Nothing moves unasked (`watch`), no sweep is lost or counted twice (`kept`), and after a person has acted it goes on.
"""

import random
import sqlite3
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from service.web.client import Json, ServiceClient, ServiceProblem, ServiceUnreachable
from tests.faults import MODBUS, OWN_SWEEP, STREAMED, Adapter
from tests.soak.disturbances import DISTURBANCES, Disturbance
from tests.soak.watch import Watch
from tests.system.rest_bench import (
    PATIENCE,
    PATIENT_LEASE,
    Fieldbus,
    Service,
    VirtualMachine,
    add_plan,
    until,
    virtual_machine,
)

LONGEST = 6.0  # s into a run that a disturbance comes; a sweep with its way takes some 4 s
GOES_ON = 4.0  # s after what need not end a run
UNDER_WAY = ("running", "pausing", "measured")
STORED = 10.0  # s after a resume within which a recording is stored that the disk had refused before
LOOK = (0.3, 1.0)  # s that nothing may move before a person acts


@dataclass(frozen=True)
class Way:
    """How the machine is reached and moved."""

    name: str
    adapter: Adapter
    speed_factor: float


WAYS = {
    way.name: way
    for way in (
        Way("canopen", OWN_SWEEP, 3.0),
        Way("canopen-streamed", STREAMED, 10.0),
        Way("modbus", MODBUS, 3.0),
    )
}


@dataclass
class Tally:
    """What came of it. All but the counts must stay empty."""

    done: Counter[str] = field(default_factory=Counter)
    ended: Counter[str] = field(default_factory=Counter)
    """Of these the run was ended."""
    broken: list[str] = field(default_factory=list)
    campaigns: int = 0
    sweeps: int = 0
    attempts: int = 0
    lost: dict[str, float] = field(default_factory=dict)
    """Most samples that a drive had measured when it happened and no recording has, ms of the host's time."""
    unplanned: list[str] = field(default_factory=list)
    """Pauses that nothing of ours was the cause of: a busy computer's."""


@dataclass(frozen=True)
class Measured:
    """What a drive had measured of a sweep at some moment, before a disturbance."""

    disturbance: str
    campaign: int
    number: int
    attempt: int
    samples: int
    per_second: float
    """Of the host's time."""


class Walk:
    """The bench that disturbances act on, and a person who puts it right."""

    def __init__(
        self,
        way: Way,
        machine: VirtualMachine,
        service: Service,
        watch: Watch,
        chance: random.Random,
        say: Callable[[str], None],
    ) -> None:
        self.machine, self.service, self.chance = machine, service, chance
        self.client = ServiceClient(service.url)
        self._closing = ExitStack()
        self._closing.enter_context(self.client)
        self.tally = Tally()
        self.campaign = 0
        self.plan = add_plan(
            self.client,
            axes=["joint_1", "joint_2"],
            varied=["joint_2", "joint_3"],
            step=30.0,
            poses=6,
            modes=way.adapter.modes,
        )
        self._way, self._watch, self._say = way, watch, say
        self._campaigns: list[int] = []
        self._measured_before: Measured | None = None
        """Compared with the recordings once the run goes on: until then the service may still store what it holds."""

    def __enter__(self) -> "Walk":
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.close()

    def client_anew(self) -> None:
        """Of a service that was started again, at another address."""
        self.client = self._closing.enter_context(ServiceClient(self.service.url))

    def started(self, campaign: int) -> None:
        """A client started this campaign while others wanted something else: from now on it is the present one."""
        self.campaign = campaign
        self._campaigns.append(campaign)

    def disturb(self, disturbance: Disturbance) -> None:
        """Once, at some moment of a run, and everything put right again."""
        self._run()
        self._count_lost()
        time.sleep(self.chance.uniform(0.0, LONGEST))
        before = self._state()
        if before["state"] == "paused":
            self.tally.unplanned.append(f"before {disturbance.name}: {before['cause']}")
            self._rests(disturbance)
        self._measured_before = self._measured(before, disturbance.name) if disturbance.keeps else None
        disturbance.make(self)
        if disturbance.ends:
            self._watch.must_rest(disturbance.name)
        self._settled(disturbance)
        for act in disturbance.undo:
            act(self)
        time.sleep(self.chance.uniform(*LOOK))
        self.tally.done[disturbance.name] += 1
        if disturbance.ends and before["state"] == "running":
            until(lambda: self._state()["state"] not in UNDER_WAY, f"{disturbance.name} ends the run")
        self._report(disturbance)

    def finish(self) -> None:
        """Every campaign is measured to its end, and its data are what was promised."""
        for campaign in self._campaigns:
            self.campaign = campaign
            until(self._goes_on, f"campaign {self.campaign} comes to its end", 3 * PATIENCE)
        self._count_lost()
        for campaign in self._campaigns:
            self.kept(campaign)

    def _run(self) -> None:
        """A campaign that moves: the one that was interrupted goes on, or a new one begins."""
        if not self.campaign or self._state()["state"] in ("completed", "aborted", "failed"):
            self.campaign = int(self.client.add_campaign(self.plan)["id"])
            self._campaigns.append(self.campaign)
        until(lambda: self._goes_on() or self._state()["state"] == "running", "a run", 3 * PATIENCE)

    def _goes_on(self) -> bool:
        """Whether it is over; if it does not run, a person acts."""
        state = str(self._state()["state"])
        if state == "completed":
            return True
        if state in UNDER_WAY:
            return False
        with suppress(ServiceProblem, ServiceUnreachable):
            self._person_acts()
            self._watch.may_move()
            if state == "paused":
                self.client.resume(self.campaign, repeat=True)
            else:
                self.client.start(self.campaign)
            return False
        self._watch.must_rest("refused")
        time.sleep(0.2)
        return False

    def _person_acts(self) -> None:
        """Looks, releases the stops, connects, acknowledges."""
        if stops := self.client.stops():
            self.client.reset_stop("Ada", [stop["id"] for stop in stops])
        if not self.client.drives()["connected"]:
            self.client.connect()
        for axis in self.client.drives()["axes"]:
            if axis["fault"]:
                self.client.acknowledge(axis["joint"])

    def _state(self) -> Json:
        """Of the present campaign; asked again while the service has no time."""
        found: list[Json] = []

        def told() -> bool:
            with suppress(ServiceProblem, ServiceUnreachable):
                found.append(self.client.campaign(self.campaign))
            return bool(found)

        until(told, "the service answers")
        return found[0]

    def _serves(self) -> bool:
        with suppress(ServiceUnreachable):
            self.client.stops()
            return True
        return False

    def _settled(self, disturbance: Disturbance) -> None:
        """The axes stand where the run has ended; else it goes on as if nothing had been."""
        deadline = time.monotonic() + GOES_ON
        while not disturbance.ends and self._serves():
            if self._state()["state"] not in UNDER_WAY:
                self._watch.must_rest(disturbance.name)
                break
            if time.monotonic() > deadline:
                return
            time.sleep(0.05)
        if disturbance.ends or not self._watch.rests_now:
            self._rests(disturbance)
        self.tally.ended[disturbance.name] += 1

    def _rests(self, disturbance: Disturbance) -> None:
        self._watch.must_rest(disturbance.name)
        with suppress(OSError, ValueError):  # a machine without power does not tell, and needs no watching
            self.machine.axes()
            until(lambda: self._watch.rests_now, f"{disturbance.name}: the axes stand")

    def _measured(self, campaign: Json, disturbance: str) -> Measured | None:
        """Of the sweep that a drive makes now by itself; a streamed one is counted by the host alone."""
        sweep = campaign["progress"]["current"]
        if sweep is None or campaign["state"] != "running" or self._way.adapter.modes != "drive_side":
            return None
        axis = self.machine.axes()[sweep["spec"]["axis"]]
        rate = float(sweep["spec"]["sample_rate"]) * self._way.speed_factor
        running = axis["measuring"] == "running"
        if not running:
            return None
        return Measured(disturbance, self.campaign, sweep["number"], sweep["attempt"], axis["samples"], rate)

    def _count_lost(self) -> None:
        """Of what a drive had measured before the last disturbance: what no recording, whole or partial, has."""
        measured, self._measured_before = self._measured_before, None
        if measured is None:
            return
        asked = (
            "SELECT sweep.state, sweep.attempt, recording.samples FROM sweep"
            " LEFT JOIN recording ON recording.sweep_id = sweep.id AND recording.attempt = ?"
            " WHERE sweep.campaign_id = ? AND sweep.number = ?"
        )
        deadline = time.monotonic() + STORED
        while True:
            ((state, attempt, samples),) = self._rows(asked, (measured.attempt, measured.campaign, measured.number))
            if samples is None and state == "running" and attempt == measured.attempt:
                return  # it still runs
            if samples is not None or time.monotonic() > deadline:
                break
            time.sleep(0.1)
        lost = 1000 * max(0, measured.samples - (samples or 0)) / measured.per_second
        self.tally.lost[measured.disturbance] = max(self.tally.lost.get(measured.disturbance, 0.0), lost)

    def _report(self, disturbance: Disturbance) -> None:
        after = self._state()
        cause = f": {after['cause']}" if after["cause"] else ""
        self._say(f"{sum(self.tally.done.values()):4} {disturbance.name}: {after['state']}{cause}"[:160])

    def kept(self, campaign: int) -> None:
        """Each sweep is identified once, by one complete recording, and is in the estimate once."""
        sweeps = self.client.sweeps(campaign)
        wrong = [sweep["number"] for sweep in sweeps if sweep["state"] != "identified"]
        revisions = sorted(int(estimate["revision"]) for estimate in self.client.estimates(campaign))
        whole = Counter(self._recordings(campaign, "complete"))
        self.tally.campaigns += 1
        self.tally.sweeps += len(sweeps)
        self.tally.attempts += sum(int(sweep["attempt"]) for sweep in sweeps)
        if wrong:
            self.tally.broken.append(f"campaign {campaign}: sweeps {wrong} are not identified")
        if revisions != list(range(1, len(sweeps) + 1)):
            self.tally.broken.append(f"campaign {campaign}: {len(sweeps)} sweeps, revisions {revisions}")
        if whole != Counter(sweep["number"] for sweep in sweeps):
            self.tally.broken.append(f"campaign {campaign}: complete recordings {dict(whole)}")

    def _recordings(self, campaign: int, state: str) -> Iterator[int]:
        asked = (
            "SELECT sweep.number FROM recording JOIN sweep ON sweep.id = recording.sweep_id"
            " WHERE sweep.campaign_id = ? AND recording.state = ?"
        )
        yield from (int(number) for (number,) in self._rows(asked, (campaign, state)))

    def _rows(self, query: str, values: tuple[int | str, ...]) -> list[tuple[Any, ...]]:
        """Of the service's database, read without a lock."""
        (file,) = self.service.data.glob("sweepid.sqlite")
        with closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as database:
            return database.execute(query, values).fetchall()


@contextmanager
def walking(way: Way, folder: Path, seed: int, say: Callable[[str], None]) -> Iterator[tuple[Walk, Watch]]:
    """A machine, a service on it, and somebody who looks on."""
    with ExitStack() as stack:
        machine = stack.enter_context(virtual_machine(folder, way.speed_factor, Fieldbus(way.adapter.fieldbus)))
        service = Service(folder, machine.profile, PATIENT_LEASE)
        service.start()
        stack.callback(service.close)
        watch = stack.enter_context(Watch(machine))
        walk = Walk(way, machine, service, watch, random.Random(seed), say)
        yield stack.enter_context(walk), watch


def of(way: Way) -> list[Disturbance]:
    """Those that this way can meet."""
    return [each for each in DISTURBANCES if way.adapter in each.adapters]
