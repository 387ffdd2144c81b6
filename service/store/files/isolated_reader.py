"""External files are read in a separate process: a file that expands without limit or crashes its reader does not
affect the memory or the life of the process that owns the machine.

The reader (`main`) answers with JSON, never with objects: a compromised reader cannot run code here.
"""

import asyncio
import json
import os
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from service import BadInput
from service.process.tasks import ONE_THREAD, child_process, give_way


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of one reader."""

    memory: int = 4 * 2**30  # bytes of address space; Windows and macOS have no such limit
    time: float = 600.0  # s
    answer: int = 16 * 2**20  # bytes, maximum answer to this process

    def __str__(self) -> str:
        return f"limits {self.memory} bytes of memory and {self.time:.6g} s"


LIMITS = Limits()


async def read_isolated(
    task: Callable[..., Any], arguments: tuple[Path, ...], place: str, limits: Limits = LIMITS
) -> Any:
    """The answer of `task`, a function of a module with paths as arguments and a JSON-compatible result.

    Raises BadInput: that of the task, or one at `place` that names the exceeded limit or the crash; OSError: that of
    the task, e.g. a full disk. The reader ends on cancellation and when this process dies.
    """
    # address space is limited: no pools and stacks for as many threads as there are cores
    environment = {**ONE_THREAD, "ARROW_DEFAULT_MEMORY_POOL": "system", "MALLOC_ARENA_MAX": "2"}
    words = (str(limits.memory), f"{task.__module__}:{task.__qualname__}", *map(str, arguments))
    async with child_process("service.store.files.isolated_reader", *words, environment=environment) as child:
        process, _, stdout = child
        try:
            async with asyncio.timeout(limits.time):
                answer = await _all_of(stdout, place, limits.answer)
                code = await process.wait()
        except TimeoutError:
            raise BadInput(place, f"was not read within the limit of {limits.time:.6g} s") from None
    if code:
        raise BadInput(place, f"the process that read it {_ended(code)}; {limits}")
    return _result(json.loads(answer), place, limits)


async def _all_of(stream: asyncio.StreamReader, place: str, most: int) -> bytes:
    content = bytearray()
    while part := await stream.read(2**16):
        content += part
        if len(content) > most:
            raise BadInput(place, f"unpacks to more than the limit of {most} bytes")
    return bytes(content)


def _ended(code: int) -> str:
    try:
        return f"was ended by {signal.Signals(-code).name}"
    except ValueError:
        return f"ended with {code}, see the log"


def _result(answer: dict[str, Any], place: str, limits: Limits) -> Any:
    match answer:
        case {"done": done}:
            return done
        case {"place": str(where), "reason": str(reason)}:
            raise BadInput(where, reason)
        case {"errno": int(number)}:
            raise OSError(number, os.strerror(number))
        case _:
            raise BadInput(place, f"needs more memory than the limit of {limits.memory} bytes")


def main(arguments: list[str]) -> None:
    """The reader: ``python -m ...files.isolated_reader MEMORY MODULE:FUNCTION [PATH ...]`` runs the task.

    It writes one JSON object: ``done`` with the function's result, ``place`` and ``reason`` of a BadInput, ``errno`` of
    a disk error, or ``memory`` if there was not enough of it.
    """
    memory, named, *paths = arguments
    give_way()
    _limit(int(memory))
    threading.Thread(target=_end_with_service, name="end with the service", daemon=True).start()
    sys.stdout.write(json.dumps(_answer(named, [Path(path) for path in paths])))
    sys.stdout.flush()
    os._exit(0)  # immediately: the other thread blocks on the input


def _answer(named: str, paths: list[Path]) -> dict[str, Any]:
    module, _, function = named.partition(":")
    try:
        return {"done": getattr(import_module(module), function)(*paths)}
    except BadInput as error:
        return {"place": error.place, "reason": error.reason}
    except MemoryError:
        return {"memory": True}
    except OSError as error:
        if error.errno is None:
            raise
        return {"errno": error.errno}


def _limit(memory: int) -> None:
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if sys.platform == "linux":  # macOS accepts the limit and does not enforce it
            resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


def _end_with_service() -> None:
    """Ends the reader in the middle of a file if the service has ended."""
    while os.read(0, 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    main(sys.argv[1:])
