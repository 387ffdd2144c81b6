"""The process that reads what strangers sent: ``python -m ...files.reader MEMORY MODULE:FUNCTION [PATH ...]``.

It writes one JSON object: ``done`` with the function's result, ``place`` and ``reason`` of a BadInput, ``errno`` of the
disk's error, or ``memory`` where there was not enough of it.
"""

import json
import os
import sys
import threading
from importlib import import_module
from pathlib import Path
from typing import Any

from service.errors import BadInput

_NICE = 10  # it gives way to the process that streams set-points


def main(arguments: list[str]) -> None:
    """Do it and write the answer."""
    memory, named, *paths = arguments
    _give_way(int(memory))
    threading.Thread(target=_end_with_service, name="end with the service", daemon=True).start()
    sys.stdout.write(json.dumps(_answer(named, [Path(path) for path in paths])))
    sys.stdout.flush()
    os._exit(0)  # at once: the other thread holds the input


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


def _give_way(memory: int) -> None:
    if sys.platform != "win32":
        import resource

        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        if sys.platform == "linux":  # macOS takes the number and does not keep to it
            resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


def _end_with_service() -> None:
    """Also in the middle of a file that nobody waits for any more."""
    while os.read(0, 1):
        pass
    os._exit(1)


if __name__ == "__main__":
    main(sys.argv[1:])
