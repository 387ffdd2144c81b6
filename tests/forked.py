"""A copy of this process, for parsers that may break it: C code of others does, when a file is torn."""

import json
import os
import signal
import sys
import traceback
from collections.abc import Callable

from service.errors import BadInput

TIME = 5  # s of CPU that a copy may take; the product's process has its own limit


def copied(task: Callable[[], object], seconds: int = TIME, memory: int | None = None) -> dict[str, object]:
    """What a copy tells that does it: `done`, `place` and `reason` of BadInput, `other` error, or what it `died` of.

    It may take so many seconds of CPU, and `memory` bytes of address space above what this process has.
    On Windows, which copies no process, it is done in this one.
    """
    if sys.platform == "win32":
        return _told(task)
    import resource

    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(ours)
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
            if memory is not None:
                with open("/proc/self/statm", encoding="ascii") as pages:
                    most = int(pages.read().split()[0]) * resource.getpagesize() + memory
                resource.setrlimit(resource.RLIMIT_AS, (most, most))
            os.write(theirs, json.dumps(_told(task)).encode()[:4000])
        finally:
            os._exit(0)
    os.close(theirs)
    with os.fdopen(ours, "rb") as pipe:
        answer = pipe.read()
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return {"died": signal.Signals(os.WTERMSIG(status)).name}
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
