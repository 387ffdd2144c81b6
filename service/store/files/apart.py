"""What strangers sent is read in a process of its own: a file that unfolds without end, or on which a reader breaks,
takes neither memory nor life of the process that owns the machine.

The reader (`files.reader`) answers with JSON, never with objects: who takes it over gets nothing run here.
"""

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from service.errors import BadInput

_ENVIRONMENT: Mapping[str, str] = {
    # address space is what is limited: no pools and stacks for as many threads as there are cores
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    "ARROW_DEFAULT_MEMORY_POOL": "system",
    "MALLOC_ARENA_MAX": "2",
}


@dataclass(frozen=True, slots=True)
class Limits:
    """Of one reader."""

    memory: int = 4 * 2**30  # bytes of address space; Windows and macOS have no such limit
    time: float = 600.0  # s
    answer: int = 16 * 2**20  # bytes that it may answer: all that comes to this process

    def __str__(self) -> str:
        return f"limits {self.memory} bytes of memory and {self.time:.6g} s"


LIMITS = Limits()


async def read_apart(task: Callable[..., Any], arguments: tuple[Path, ...], place: str, limits: Limits = LIMITS) -> Any:
    """The answer of `task`, a function of a module that takes paths and returns what JSON can say.

    BadInput: the task's own, or at `place` one that names the limit which the reader met or that it died. OSError: the
    task's, as a full disk. Cancelled, and when this process dies, the reader ends.
    """
    named = f"{task.__module__}:{task.__qualname__}"
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-P", "-m", "service.store.files.reader", str(limits.memory), named, *map(str, arguments)),
        stdin=subprocess.PIPE,  # its end is our death
        stdout=subprocess.PIPE,
        env={**os.environ, **_ENVIRONMENT},
    )
    try:
        async with asyncio.timeout(limits.time):
            answer = await _all_of(process.stdout, place, limits.answer)
            code = await process.wait()
    except TimeoutError:
        raise BadInput(place, f"is not read within {limits.time:.6g} s, its limit") from None
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    if code:
        raise BadInput(place, f"the process that read it {_ended(code)}; {limits}")
    return _told(json.loads(answer), place, limits)


async def _all_of(stream: asyncio.StreamReader | None, place: str, most: int) -> bytes:
    content = bytearray()
    while stream is not None and (part := await stream.read(2**16)):
        content += part
        if len(content) > most:
            raise BadInput(place, f"describes more than fits into {most} bytes, its limit")
    return bytes(content)


def _ended(code: int) -> str:
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"ended with {code}, see the log"


def _told(answer: dict[str, Any], place: str, limits: Limits) -> Any:
    match answer:
        case {"done": done}:
            return done
        case {"place": str(where), "reason": str(reason)}:
            raise BadInput(where, reason)
        case {"errno": int(number)}:
            raise OSError(number, os.strerror(number))
        case _:
            raise BadInput(place, f"needs more than {limits.memory} bytes of memory to be read, its limit")
