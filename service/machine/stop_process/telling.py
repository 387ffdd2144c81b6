"""What the stop process tells the service by its standard output. Never blocks, whether or not the service reads."""

import json
import os
import threading
from collections import deque
from contextlib import suppress

MOST = 256  # messages that wait for the service; of stops the oldest are kept, and one of them is enough to hold it
_LONGEST = 4096  # bytes that a pipe takes at once (PIPE_BUF of Linux)


class Telling:
    """From any thread."""

    def __init__(self, pipe: int) -> None:
        """`pipe`: descriptor, made non-blocking."""
        os.set_blocking(pipe, False)
        self._pipe = pipe
        self.waiting: deque[bytes] = deque()
        self._lock = threading.Lock()

    def tell(self, message: dict[str, object]) -> None:
        """One line, now or when the service reads again. A message that waits already is not repeated."""
        line = json.dumps(message, ensure_ascii=False).encode("utf-8", "replace") + b"\n"
        if len(line) > _LONGEST:
            raise ValueError(f"a message of {len(line)} bytes, at most {_LONGEST}")
        with self._lock:
            if line not in self.waiting and len(self.waiting) < MOST:
                self.waiting.append(line)
        self.flush()

    def flush(self) -> None:
        """Send what waits, as far as the service reads. An ended service is noticed by the input of this process."""
        with self._lock, suppress(OSError):  # BlockingIOError: it does not read; BrokenPipeError: it has ended
            while self.waiting:
                os.write(self._pipe, self.waiting[0])
                self.waiting.popleft()
