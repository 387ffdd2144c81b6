"""One OS thread, one clock of its own, one interleaving for each seed.

Every thread of the program under test is a greenlet: exactly one runs, until it *waits* (`wait`) or passes a *point*
(`point`) at which the policy lets another one run. Why a run with this scheduler tells the truth about one with real
threads:

1. Every blocking call of the standard library is built on `wait` and `wake` (`primitives`). A thread that waits for
   nothing of these runs on; so only finitely many instructions lie between two calls of the scheduler, and whatever
   the threads do to each other, they do between such calls. A real run is some order of these stretches of
   instructions; the policy may choose any order in which each thread's own stretches stay in order. What is searched
   is therefore a subset of the real runs: a failure found here can happen there. (The reverse fails for races
   *inside* of a stretch: two threads that touch an object without any lock, queue or clock between.)
2. Time passes only when no thread can run: then the clock jumps to the earliest deadline. Each deadline is met
   exactly, in order, equal ones first come first served. A run is thus one in which the computer is infinitely
   fast, except where the seed says otherwise: a process that is suspended (`Process.suspend`) sees its deadlines
   late, as on a computer that did something else, and frames take what the bus draws.
3. A look at the clock costs `TICK`, or a loop that only looks would never end.
4. The choice depends on the seed and on the order of calls alone, never on addresses, real time or real threads.
   `digest` is a hash over each switch, with the clock, and each frame: equal digests mean the same interleaving.
5. When no thread can run and no deadline is left, the program is stuck for ever: `Deadlock` says who waits for what.

Policy (PCT: Burckhardt et al., "A randomized scheduler with probabilistic guarantees of finding bugs", ASPLOS 2010):
each thread gets a random priority, the highest that can run does; at `PREEMPTIONS` random points the running thread
falls below all others. A bug that needs d orderings among n threads and k points is found with probability at least
1 / (n k^(d-1)). Seed 0 is first come first served, without preemption.
"""

import asyncio.events
import heapq
import inspect
import itertools
import sys
from collections import deque
from collections.abc import Callable
from hashlib import blake2b
from random import Random
from types import FrameType
from typing import NoReturn

import greenlet

TICK = 1e-7  # s that a look at the clock takes
BEGIN = 1000.0  # s on the monotonic clock at the start of a run
WALL = 1_790_000_000.0  # s since 1970 when the monotonic clock was 0
LONGEST = 1800.0  # s of virtual time that a run may take
PREEMPTIONS = (0, 1, 2, 3, 5, 8, 13)  # one of these numbers for each seed
HORIZON = (30, 100_000)  # points within which preemptions happen: between these, drawn on a logarithmic scale
_HISTORY = 40  # last switches that are kept for a message


def drawn(chance: Random, between: tuple[float, float]) -> float:
    """On a logarithmic scale."""
    low, high = between
    return low * (high / low) ** chance.random()


class Deadlock(BaseException):
    """Nobody can run and nobody ever will; or a run takes more than `LONGEST`."""


class Process:
    """Threads that are suspended or killed together, as an operating system does it."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.suspended = self.killed = False
        self.at_end: list[Callable[[], None]] = []
        """What the operating system does when it ends: closes its pipes and connections."""


class SimThread:
    """A greenlet, and what it waits for."""

    def __init__(self, name: str, process: Process, number: int, priority: float) -> None:
        self.name, self.process, self.number, self.priority = name, process, number, priority
        self.greenlet: greenlet.greenlet | None = None
        self.waits_for = ""  # "": it runs or can run
        self.turn = 0  # of its waits: a deadline of an earlier one is void
        self.expired = self.done = False
        self.joiners: list[SimThread] = []

    def __str__(self) -> str:
        return f"{self.process.name}/{self.name}"


class Scheduler:
    """`current` runs. `at` and `wake` may be called from anywhere, `wait` and `point` by the thread that runs."""

    def __init__(self, seed: int = 0) -> None:
        """The calling thread becomes the main thread, of the process "test"."""
        self.now = BEGIN
        self.switches = self.jumps = self.points = 0
        self.history: deque[str] = deque(maxlen=_HISTORY)
        self.threads: dict[int, SimThread] = {}
        self._ready: list[SimThread] = []  # first come first
        self._timers: list[tuple[float, int, SimThread | Callable[[], None], int]] = []
        self._count = itertools.count(1)
        self._atomic = False  # points are none
        self._interrupt: tuple[int, Callable[[], None]] | None = None
        self._abandoned: list[SimThread] = []  # kept, or their `finally` would run
        self.digest = blake2b(digest_size=8)
        self.seed_with(seed)
        self.main = self.current = self.add("main", Process("test"))
        self.main.greenlet = greenlet.getcurrent()

    def seed_with(self, seed: int) -> None:
        """From now on the interleaving is that of `seed`."""
        self.seed, self.random = seed, Random(seed)
        horizon = self.points + round(drawn(self.random, HORIZON))
        many = self.random.choice(PREEMPTIONS) if seed else 0
        self._preemptions = sorted((self.random.randint(self.points, horizon) for _ in range(many)), reverse=True)
        self._lowest = 0.0
        for thread in self.threads.values():
            thread.priority = self.random.random() if seed else 0.0

    # -- threads

    def add(self, name: str, process: Process) -> SimThread:
        number = next(self._count)
        thread = SimThread(name, process, number, self.random.random() if self.seed else 0.0)
        self.threads[number] = thread
        return thread

    def start(self, thread: SimThread, run: Callable[[], None]) -> None:
        """`run` may raise nothing."""

        def whole() -> None:
            run()
            self._leave(thread)

        thread.greenlet = greenlet.greenlet(whole, self.main.greenlet)
        self._ready.append(thread)

    def wait(self, what: str, deadline: float | None = None) -> bool:
        """Let others run until `wake` (True), or until `deadline`, s (False)."""
        me = self.current
        me.waits_for, me.expired = what, False
        me.turn += 1
        if deadline is not None:
            heapq.heappush(self._timers, (deadline, next(self._count), me, me.turn))
        self._switch_to(self._next())
        return not me.expired

    def wake(self, thread: SimThread) -> None:
        """It can run; no effect if it does not wait."""
        if thread.waits_for and not thread.process.killed:
            thread.waits_for = ""
            self._ready.append(thread)

    def at(self, when: float, call: Callable[[], None]) -> None:
        """`call`, which must not wait, at `when`, s: what the world around the program does."""
        heapq.heappush(self._timers, (when, next(self._count), call, 0))

    def point(self) -> None:
        """A place where another thread may run first."""
        if self._atomic:
            return
        self.points += 1
        if self._interrupt is not None and self.points >= self._interrupt[0]:
            (_, call), self._interrupt = self._interrupt, None
            call()
        if self._preemptions and self.points >= self._preemptions[-1]:
            self._preemptions.pop()
            self.let_others(lowest=True)
        elif self.seed:  # a loop: this is called two million times a minute
            mine = self.current.priority
            for other in self._ready:
                if other.priority > mine:
                    self.let_others()
                    break

    def interrupt(self, points: int, call: Callable[[], None]) -> None:
        """`call` after so many points, in whatever thread is there; replaces an earlier one that is still to come."""
        self._interrupt = self.points + points, call

    def let_others(self, lowest: bool = False) -> None:
        """The running thread goes to the end of those that can run; with `lowest` it also falls below all others."""
        if lowest and self.seed:
            self._lowest -= 1.0
            self.current.priority = self._lowest
        self._ready.append(self.current)
        self._switch_to(self._next())

    # -- processes

    def suspend(self, process: Process, seconds: float) -> None:
        """Nothing of it runs for so long (SIGSTOP, a computer that does something else), including the caller."""
        process.suspended = True
        self.trace(f"suspend {process.name} {seconds!r}")

        def go_on() -> None:
            process.suspended = False
            self.trace(f"continue {process.name}")

        self.at(self.now + seconds, go_on)
        if self.current.process is process:
            self.let_others()

    def kill(self, process: Process) -> None:
        """SIGKILL: none of its threads runs another instruction; if the caller is one of them, this never returns."""
        self.trace(f"kill {process.name}")
        self._atomic = True  # what the operating system does, no thread sees half of
        for close in process.at_end:
            close()
        self._atomic = False
        process.killed = True
        dead = [thread for thread in self.threads.values() if thread.process is process]
        for thread in dead:
            del self.threads[thread.number]
            thread.done, thread.waits_for = True, ""
            for joiner in thread.joiners:
                self.wake(joiner)
        self._abandoned += dead
        self._ready = [thread for thread in self._ready if not thread.process.killed]
        if self.current.process is process:
            self._switch_to(self._next())

    # -- inside

    def trace(self, what: str) -> None:
        """Part of the interleaving."""
        line = f"{self.now:.7f} {what}"
        self.digest.update(line.encode())
        self.history.append(line)

    def _next(self) -> SimThread:
        while True:
            first: SimThread | None = None
            for thread in self._ready:
                if not thread.process.suspended and (first is None or thread.priority > first.priority):
                    first = thread
                    if not self.seed:
                        break
            if first is not None:
                self._ready.remove(first)
                return first
            if not self._timers:
                self._give_up(f"nobody can run any more:\n{self.report()}")
            when, _, action, turn = heapq.heappop(self._timers)
            if isinstance(action, SimThread):
                if not action.waits_for or action.turn != turn:
                    continue
                action.expired = True
                self.wake(action)
            self.now = max(self.now, when)
            self.jumps += 1
            if self.now - BEGIN > LONGEST:
                self._give_up(f"not over after {LONGEST:g} s of virtual time:\n{self.report()}")
            if not isinstance(action, SimThread):
                action()

    def _switch_to(self, thread: SimThread) -> None:
        if thread is self.current:
            return
        loop, hooks = asyncio.events._get_running_loop(), sys.get_asyncgen_hooks()  # both belong to the OS thread
        self._run(thread)
        asyncio.events._set_running_loop(loop)
        sys.set_asyncgen_hooks(*hooks)

    def _run(self, thread: SimThread) -> None:
        self.switches += 1
        self.trace(f"{thread.number} {thread}")
        self.current = thread
        assert thread.greenlet is not None
        thread.greenlet.switch()

    def _leave(self, thread: SimThread) -> None:
        """The last call of a thread."""
        thread.done = True
        del self.threads[thread.number]
        for joiner in thread.joiners:
            self.wake(joiner)
        asyncio.events._set_running_loop(None)
        following = self._next()
        self._abandoned.append(thread)  # a greenlet cannot be freed while it runs
        self._run(following)

    def _give_up(self, why: str) -> NoReturn:
        """Raised in the main thread: any other could swallow it."""
        for thread in self.threads.values():
            self.history.append(f"waits: {thread}")
        if self.current is self.main:
            raise Deadlock(why)
        assert self.main.greenlet is not None
        self.current, self.main.waits_for = self.main, ""
        self.main.greenlet.throw(Deadlock(why))
        raise AssertionError("the main thread does not switch back")

    def report(self) -> str:
        """Who waits for what, and where."""
        lines: list[str] = []
        for thread in self.threads.values():
            frame = thread.greenlet.gr_frame if thread.greenlet is not None else None
            place = _place(inspect.currentframe() if thread is self.current else frame)
            asleep = " (process suspended)" * thread.process.suspended
            lines.append(f"  {thread}{asleep}: waits for {thread.waits_for or 'its turn'}, at {place}")
        return "\n".join(lines)


def _place(frame: FrameType | None) -> str:
    """The innermost lines of the program itself."""
    found: list[str] = []
    while frame is not None and len(found) < 3:
        name = frame.f_code.co_filename
        if any(f"/{room}/" in name for room in ("service", "drivers", "simulator", "tests")) and (
            "virtual_time/scheduler" not in name and "virtual_time/primitives" not in name
        ):
            found.append(f"{'/'.join(name.split('/')[-3:])}:{frame.f_lineno} {frame.f_code.co_name}")
        frame = frame.f_back
    return " < ".join(found) or "a library"
