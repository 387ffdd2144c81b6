"""Enter virtual time: for good, in a process that was forked for it. Nothing can leak into other tests: it ends.

A test in virtual time runs in a copy of the pytest process (`in_a_copy`): all modules are loaded there already, real
threads of the original are not in it, and what is replaced here stays replaced until the copy ends.
"""

import _thread
import _threading_local
import asyncio
import datetime
import faulthandler
import gc
import os
import pickle
import queue
import sys
import threading
import time
import traceback
import types
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

from tests.forked import fork, heard, tell
from tests.virtual_time import primitives
from tests.virtual_time.scheduler import Scheduler

Result = TypeVar("Result")

LOCAL: Any = vars(_thread)["_local"]

_REPLACED: dict[Any, Any] = {
    time.monotonic: primitives.monotonic,
    time.monotonic_ns: primitives.monotonic_ns,
    time.perf_counter: primitives.monotonic,
    time.time: primitives.wall,
    time.time_ns: primitives.wall_ns,
    time.clock_gettime: primitives.clock_gettime,
    time.sleep: primitives.sleep,
    _thread.allocate_lock: primitives.Lock,
    threading.RLock: primitives.RLock,
    _thread.RLock: primitives.RLock,
    threading.get_ident: primitives.get_ident,
    LOCAL: _threading_local.local,
    queue.SimpleQueue: primitives.SimpleQueue,
    os.urandom: primitives.urandom,
}
LONGEST = 600.0  # s of real time until a copy that hangs says where it does, and ends
_OURS = ("service", "drivers", "simulator")
_STAY_REAL = (
    "_pytest",
    "pytest",
    "xdist",
    "execnet",
    "hypothesis",
    "tests.virtual_time",
    "_thread",
    "_threading_local",
)


class _Wall(type):
    def __instancecheck__(cls, instance: object) -> bool:
        return isinstance(instance, datetime.datetime)


class VirtualDatetime(datetime.datetime, metaclass=_Wall):
    """`datetime.now` on the virtual clock; the values are plain datetimes."""

    @classmethod
    def now(cls, tz: datetime.tzinfo | None = None) -> datetime.datetime:
        return datetime.datetime.fromtimestamp(primitives.wall(), tz)


def enter(seed: int) -> Scheduler:
    """From now on this process lives in virtual time. Call it once, from the only thread there is."""
    scheduler = Scheduler(seed)
    primitives.bind(scheduler)
    gc.collect()
    gc.disable()  # what a collection ends, such as executors, it would end at a moment that no seed repeats
    for module in [*sys.modules.values()]:
        if isinstance(module, types.ModuleType) and not module.__name__.startswith(_STAY_REAL):
            _replace_in(module)
    threading.Thread.start = primitives.start
    threading.Thread.join = primitives.join
    threading.Thread.is_alive = primitives.is_alive
    threading.Thread.__hash__ = primitives.ordinal
    policy: Any = type(asyncio.get_event_loop_policy())
    policy._loop_factory = primitives.Loop
    return scheduler


def _replace_in(module: types.ModuleType) -> None:
    """Whoever imported a name, has it as a default argument, or made a lock or thread-local at import, keeps that."""
    own = module.__name__.startswith(_OURS)
    for name, value in [*vars(module).items()]:
        new = _replacement(value)
        if own and value is datetime.datetime:
            new = VirtualDatetime
        if new is not None:
            setattr(module, name, new)
        elif own:
            for function in (value, *(vars(value).values() if isinstance(value, type) else ())):
                if isinstance(function, types.FunctionType) and function.__defaults__:
                    function.__defaults__ = tuple(_replacement(one) or one for one in function.__defaults__)


def _replacement(value: object) -> Any:
    if type(value) is _thread.LockType:
        return primitives.Lock()
    if type(value) is _thread.RLock:
        return primitives.RLock()
    if type(value) is LOCAL:
        return _threading_local.local()
    if issubclass(type(value), (types.BuiltinFunctionType, types.FunctionType, type)):
        return _REPLACED.get(value)
    return None


class CopyFailed(AssertionError):
    """What was done in a copy of this process raised an error, or the copy died; the text is its traceback."""


def in_a_copy(task: Callable[[], Result]) -> Result:
    """The result of `task`, which is done in a copy of this process (fork); it must be possible to pickle it.

    Raises CopyFailed.
    """
    faulthandler.cancel_dump_traceback_later()  # its thread does not come along, and the copy would wait for it
    child, pipe = fork()
    if child == 0:
        faulthandler.dump_traceback_later(LONGEST, exit=True, file=2)
        tell(pipe, partial(_answer, task))
    data, code = heard(child, pipe)
    if not data:
        raise CopyFailed(f"the copy of this process died: {code}")
    done, result = pickle.loads(data)
    if not done:
        raise CopyFailed(result)
    return result


def _answer(task: Callable[[], object]) -> bytes:
    try:
        return pickle.dumps((True, task()))
    except BaseException:  # noqa: BLE001 - told to the original
        return pickle.dumps((False, traceback.format_exc()))
