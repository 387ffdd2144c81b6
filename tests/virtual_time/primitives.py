"""The blocking calls of the standard library over a `Scheduler`: what `world.enter` puts in the place of the real ones.

`threading.Condition`, `Event`, `Semaphore`, `Barrier`, `queue.Queue` and the executors follow: they are Python code
over these.
"""

import asyncio
import itertools
import queue
import selectors
import threading
import time
from collections import deque
from collections.abc import Mapping
from random import Random
from typing import Any, Self

from tests.virtual_time.scheduler import TICK, WALL, Process, Scheduler, SimThread

REAL_IDENT = threading.get_ident
REAL_ALIVE, REAL_JOIN = threading.Thread.is_alive, threading.Thread.join
SPINS = 50  # after so many rounds in a row a loop that waits in rounds for another thread gives way to it
_THREAD = "_simulated"  # attribute of a threading.Thread

world: Scheduler


def bind(scheduler: Scheduler) -> None:
    """All primitives work on this scheduler from now on: there is one for each process of the computer."""
    global world
    world = scheduler


# -- clock


def monotonic() -> float:
    world.now += TICK
    world.point()
    return world.now


def wall() -> float:
    return WALL + monotonic()


def monotonic_ns() -> int:
    return round(monotonic() * 1e9)


def wall_ns() -> int:
    return round(wall() * 1e9)


def clock_gettime(which: int) -> float:
    return wall() if which == time.CLOCK_REALTIME else monotonic()


def urandom(size: int) -> bytes:
    """The same in each run: names and tokens of hosts go into frames."""
    return _CHANCE.randbytes(size)


_CHANCE = Random(0)


def sleep(seconds: float) -> None:
    world.wait("the end of a sleep", world.now + max(0.0, seconds))


# -- locks


class Lock:
    """threading.Lock. Those of a killed process are free: the next process would have its own."""

    def __init__(self) -> None:
        self._locked = False
        self._process: Process | None = None  # which took it
        self._waiting: deque[SimThread] = deque()

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        world.point()
        deadline = None if timeout < 0 else world.now + timeout
        while self.locked():
            if not blocking:
                return False
            me = world.current
            self._waiting.append(me)
            if not world.wait("a lock", deadline):
                if me in self._waiting:
                    self._waiting.remove(me)
                if self.locked():
                    return False
        self._locked, self._process = True, world.current.process
        return True

    def release(self) -> None:
        if not self._locked:
            raise RuntimeError("release unlocked lock")
        self._locked = False
        while self._waiting:
            first = self._waiting.popleft()
            if not first.done:  # one of a killed process waits no more
                world.wake(first)
                break
        world.point()

    def locked(self) -> bool:
        return self._locked and not (self._process is not None and self._process.killed)

    def __enter__(self) -> Self:
        self.acquire()
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def _at_fork_reinit(self) -> None:
        self.__init__()


class RLock:
    """threading.RLock, also what Condition asks of it."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._owner: int | None = None
        self._depth = 0

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        if self._is_owned():
            self._depth += 1
            return True
        if not self._lock.acquire(blocking, timeout):
            return False
        self._owner, self._depth = get_ident(), 1
        return True

    def release(self) -> None:
        if not self._is_owned():
            raise RuntimeError("cannot release un-acquired lock")
        self._depth -= 1
        if not self._depth:
            self._owner = None
            self._lock.release()

    def __enter__(self) -> Self:
        self.acquire()
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def _is_owned(self) -> bool:
        return self._owner == get_ident() and self._lock.locked()

    def _release_save(self) -> tuple[int, int | None]:
        saved, self._depth, self._owner = (self._depth, self._owner), 0, None
        self._lock.release()
        return saved

    def _acquire_restore(self, saved: tuple[int, int | None]) -> None:
        self._lock.acquire()
        self._depth, self._owner = saved

    def _at_fork_reinit(self) -> None:
        self.__init__()


class SimpleQueue:
    """queue.SimpleQueue."""

    __class_getitem__ = classmethod(lambda cls, _: cls)

    def __init__(self) -> None:
        self._items: deque[Any] = deque()
        self._waiting: deque[SimThread] = deque()

    def put(self, item: Any, block: bool = True, timeout: float | None = None) -> None:
        self.put_nowait(item)
        world.point()

    def put_nowait(self, item: Any) -> None:
        """Also what the world around the program does: never waits, never lets another thread run."""
        self._items.append(item)
        while self._waiting:
            first = self._waiting.popleft()
            if not first.done:
                world.wake(first)
                break

    def get(self, block: bool = True, timeout: float | None = None) -> Any:
        if block and timeout is not None and timeout < 0:
            raise ValueError("'timeout' must be a non-negative number")
        deadline = None if timeout is None else world.now + timeout
        world.point()
        while not self._items:
            if not block:
                raise queue.Empty
            me = world.current
            self._waiting.append(me)
            if not world.wait("an item of a queue", deadline):
                if me in self._waiting:
                    self._waiting.remove(me)
                if not self._items:
                    raise queue.Empty
        return self._items.popleft()

    def give_back(self, item: Any) -> None:
        """The next to be taken."""
        self._items.appendleft(item)

    def get_nowait(self) -> Any:
        return self.get(False)

    def empty(self) -> bool:
        return not self._items

    def qsize(self) -> int:
        return len(self._items)


# -- threads


def get_ident() -> int:
    me = world.current
    return MAIN_IDENT if me is world.main else me.number


MAIN_IDENT = REAL_IDENT()


def start(self: threading.Thread) -> None:
    process = world.current.process
    thread = world.add(self.name, process)
    setattr(self, _THREAD, thread)
    active: dict[int, threading.Thread] = threading._active  # pyright: ignore[reportAttributeAccessIssue]

    def run() -> None:
        try:
            self.run()
        except SystemExit:
            pass
        except BaseException:  # noqa: BLE001 - as a real thread does
            self._invoke_excepthook(self)  # pyright: ignore[reportAttributeAccessIssue]
        setattr(self, "_is_stopped", True)  # noqa: B010 - private, as all of this
        active.pop(thread.number, None)

    setattr(self, "_ident", thread.number)  # noqa: B010
    active[thread.number] = self
    threading._limbo.pop(self, None)  # pyright: ignore[reportAttributeAccessIssue]
    world.start(thread, run)
    self._started.set()  # pyright: ignore[reportAttributeAccessIssue]
    world.point()


def is_alive(self: threading.Thread) -> bool:
    thread: SimThread | None = getattr(self, _THREAD, None)
    return REAL_ALIVE(self) if thread is None else not thread.done


def join(self: threading.Thread, timeout: float | None = None) -> None:
    thread: SimThread | None = getattr(self, _THREAD, None)
    if thread is None:
        REAL_JOIN(self, timeout)
    elif not thread.done:
        thread.joiners.append(world.current)
        world.wait(f"the end of {thread}", None if timeout is None else world.now + max(0.0, timeout))


def ordinal(self: threading.Thread) -> int:
    """A hash by which a set of threads has the same order in each run: an address has not."""
    return self.__dict__.setdefault("_ordinal", next(_ordinals))


_ordinals = itertools.count(1)


# -- the event loop


class NumberedTask(asyncio.Task[Any]):
    """Sets of tasks have the same order in each run."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._ordinal = next(_ordinals)
        super().__init__(*args, **kwargs)

    def __eq__(self, other: object) -> bool:
        return self is other

    def __hash__(self) -> int:
        return self._ordinal


class Events(selectors.BaseSelector):
    """What an event loop waits with. No file exists here that could become ready: only another thread wakes a loop."""

    def __init__(self) -> None:
        self._poked = False
        self._waiting: SimThread | None = None
        self._spins = 0  # rounds of the loop in which it always had something to do

    def poke(self) -> None:
        self._poked = True
        if self._waiting is not None:
            world.wake(self._waiting)
        world.point()

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if self._poked or (timeout is not None and timeout <= 0):
            self._spins += 1
            world.let_others(lowest=self._spins > SPINS)
        else:
            self._spins = 0
            self._waiting = world.current
            world.wait("something to do in its event loop", None if timeout is None else world.now + timeout)
            self._waiting = None
        self._poked = False
        return []

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        raise RuntimeError(f"{fileobj} in virtual time: real files and sockets know only real time")

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        raise KeyError(fileobj)

    def get_map(self) -> Mapping[Any, selectors.SelectorKey]:
        return {}


class Loop(asyncio.SelectorEventLoop):
    """The event loop of asyncio, without the socket pair by which real threads wake it."""

    def __init__(self, selector: selectors.BaseSelector | None = None) -> None:
        self._events = Events()
        super().__init__(self._events)
        self.set_task_factory(lambda loop, coro, **more: NumberedTask(coro, loop=loop, **more))

    def _make_self_pipe(self) -> None:
        pass

    def _close_self_pipe(self) -> None:
        pass

    def _write_to_self(self) -> None:
        self._events.poke()
