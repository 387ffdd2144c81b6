"""The process that reads external files: ``python -m ...files.reader MEMORY MODULE:FUNCTION [PATH ...]``.

It writes one JSON object: ``done`` with the function's result, ``place`` and ``reason`` of a BadInput, ``errno`` of
a disk error, or ``memory`` if there was not enough of it.
"""

import json
import os
import sys
import threading
from importlib import import_module
from pathlib import Path
from typing import Any

from service.model.errors import BadInput
from service.process.tasks import give_way


def main(arguments: list[str]) -> None:
    """Run the task and write the answer."""
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
