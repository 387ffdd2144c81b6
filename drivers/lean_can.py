"""python-can without asammdf. Import this module before `can` or `canopen`.

If asammdf is installed (extra `mdf4`), python-can imports it for a log format that is not used here, and with it
pandas and Arrow. That costs most of a second and 100 MB in each process that opens a bus, including the stop
process.
"""

import importlib
import sys
from typing import cast


def _load() -> None:
    if "can" in sys.modules or "asammdf" in sys.modules:
        return
    modules = cast("dict[str, object]", sys.modules)
    modules["asammdf"] = None  # its import then fails, which python-can handles
    try:
        importlib.import_module("can")
    finally:
        del modules["asammdf"]


_load()
