"""The clock of the wall, as one service and its processes see it, set by a test; the computer's own stays."""

import mmap
import struct
import subprocess
from pathlib import Path

from tests.programs import require

SOURCE = Path(__file__).with_name("clock.c")


class Clock:
    """It shows the computer's time and so many seconds more."""

    def __init__(self, folder: Path) -> None:
        require("cc")
        self._file, self._library = folder / "clock", folder / "clock.so"
        self._file.write_bytes(struct.pack("d", 0.0))
        command = ["cc", "-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o", str(self._library), str(SOURCE), "-lm"]
        subprocess.run([*command, "-ldl"], check=True, timeout=60)

    @property
    def environment(self) -> dict[str, str]:
        """Of the processes that are to see it."""
        return {"LD_PRELOAD": str(self._library), "TEST_CLOCK": str(self._file)}

    def step(self, seconds: float) -> None:
        """As if somebody had set it forwards, or backwards: seen at once by all that run."""
        with self._file.open("r+b") as file, mmap.mmap(file.fileno(), 8) as page:
            (ahead,) = struct.unpack("d", page[:])
            page[:] = struct.pack("d", ahead + seconds)
