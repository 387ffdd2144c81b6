"""A copy of this process (fork): for a world that is copied, and for parsers that may break it, as C code of others."""

import json
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable
from typing import NoReturn

from service import BadInput

TIME = 5  # s of CPU that a parser may take; the product's process has its own limit


def fork() -> tuple[int, int]:
    """In the original: the pid of the copy and a pipe, for `heard`. In the copy: 0 and a pipe, for `tell`."""
    reading, writing = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads: pytest's and its plugins' are not needed here
        child = os.fork()
    os.close(writing if child else reading)
    return child, reading if child else writing


def heard(child: int, pipe: int) -> tuple[bytes, int]:
    """What the copy told, once it has ended, and its exit code; that of a signal is negative."""
    with os.fdopen(pipe, "rb") as reading:
        data = reading.read()
    _, status = os.waitpid(child, 0)
    return data, os.waitstatus_to_exitcode(status)


def tell(pipe: int, answer: Callable[[], bytes]) -> NoReturn:
    """The end of the copy, without any cleaning up."""
    try:
        data = answer()
        sys.stdout.flush()
        sys.stderr.flush()
        with os.fdopen(pipe, "wb") as writing:
            writing.write(data)
    finally:
        os._exit(0)


def copied(task: Callable[[], object], seconds: int = TIME, memory: int | None = None) -> dict[str, object]:
    """What a copy tells that does it: `done`, `place` and `reason` of BadInput, `other` error, or what it `died` of.

    It may take so many seconds of CPU, and `memory` bytes of address space above what this process has.
    On Windows, which copies no process, it is done in this one.
    """
    if sys.platform == "win32":
        return _told(task)
    import resource

    child, pipe = fork()
    if child == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        if memory is not None:
            with open("/proc/self/statm", encoding="ascii") as pages:
                most = int(pages.read().split()[0]) * resource.getpagesize() + memory
            resource.setrlimit(resource.RLIMIT_AS, (most, most))
        tell(pipe, lambda: json.dumps(_told(task)).encode())
    answer, code = heard(child, pipe)
    if code < 0:
        return {"died": signal.Signals(-code).name}
    return json.loads(answer or b'{"other": "the copy told nothing"}')


def forked(task: Callable[[], object]) -> None:
    """Do it in a copy. BadInput as the product tells it, also where the copy died; AssertionError for all else."""
    match copied(task):
        case {"done": True}:
            return
        case {"died": by}:
            raise BadInput("file", f"the process that read it was ended by {by}")
        case {"place": str(place), "reason": str(reason)}:
            raise BadInput(place, reason)
        case other:
            raise AssertionError(f"the copy tells {other}")


def _told(task: Callable[[], object]) -> dict[str, object]:
    try:
        task()
    except BadInput as error:
        return {"place": error.place[:300], "reason": error.reason[:300]}
    except MemoryError:
        return {"place": "file", "reason": "needs more memory than there is"}
    except Exception:  # noqa: BLE001 - it is told
        return {"other": traceback.format_exc(limit=-5)[-2500:]}
    return {"done": True}
