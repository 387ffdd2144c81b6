"""``python -m service.machine.stop_process PROFILE HOST PORT [CERTIFICATE KEY]``: child of `sweepid serve`."""

import json
import os
import signal
import ssl
import sys
import threading
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from service.machine.stop_process import END, ORDER, TAKEN_OVER
from service.machine.stop_process.bus import StopBus
from service.machine.stop_process.listener import Answer, Answered, Listener, Request, answer_to


class Telling:
    """What the service is told by the standard output, from any thread. Never blocks, whether or not it reads."""

    most = 256  # messages that wait for the service; of stops the oldest are kept, and one of them is enough to hold it
    longest = 4096  # bytes that a pipe takes at once (PIPE_BUF of Linux)

    def __init__(self, pipe: int) -> None:
        """`pipe`: descriptor, made non-blocking."""
        os.set_blocking(pipe, False)
        self._pipe = pipe
        self.waiting: deque[bytes] = deque()
        self._lock = threading.Lock()

    def tell(self, message: dict[str, object]) -> None:
        """One line, now or when the service reads again. A message that waits already is not repeated."""
        line = json.dumps(message, ensure_ascii=False).encode("utf-8", "replace") + b"\n"
        if len(line) > self.longest:
            raise ValueError(f"a message of {len(line)} bytes, at most {self.longest}")
        with self._lock:
            if line not in self.waiting and len(self.waiting) < self.most:
                self.waiting.append(line)
        self.flush()

    def flush(self) -> None:
        """Send what waits, as far as the service reads. An ended service is noticed by the input of this process."""
        with self._lock, suppress(OSError):  # BlockingIOError: it does not read; BrokenPipeError: it has ended
            while self.waiting:
                os.write(self._pipe, self.waiting[0])
                self.waiting.popleft()


def main() -> None:
    profile, host, port, *tls = sys.argv[1:]
    telling = Telling(1)
    stopping = ThreadPoolExecutor(16, thread_name_prefix="stop")  # the listener waits for no drive; more are merged

    def stop(wanted: Request, answered: Answered) -> None:
        stopping.submit(carry_out, wanted, time.monotonic() + wanted.wait, answered)

    def carry_out(wanted: Request, until: float, answered: Answered) -> None:
        sent = bus.stop()
        telling.tell({"stop": wanted.words()})
        if wanted.wait:
            bus.confirm(until, lambda confirmed: answered(answer_to(wanted, sent, confirmed)))
        else:
            answered(answer_to(wanted, sent, None))

    def status() -> Answer:
        return 200, {"trouble": bus.trouble}

    try:
        listener = Listener(host, int(port), stop, status, _context(tls), lambda: _beat(telling))
    except OSError as error:
        telling.tell({"error": f"cannot listen at {host}:{port} for the stop: {error.strerror or error}"})
        raise SystemExit(1) from None
    telling.tell({"port": listener.port, "pid": os.getpid()})  # the service reads this first: the bus has no news yet
    bus = StopBus(Path(profile), lambda trouble: telling.tell({"trouble": trouble[:1000]}))
    threading.Thread(target=_obey, args=[bus], name="stop-orders", daemon=True).start()
    listener.serve()


def _beat(telling: Telling) -> None:
    telling.tell({"alive": True})
    telling.flush()


def _context(tls: list[str]) -> ssl.SSLContext | None:
    """None if the files are unusable: the stop then works without TLS."""
    if not tls:
        return None
    certificate, key = tls
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(certificate, key, password=lambda: "")
    except OSError as error:
        sys.stderr.write(f"TLS of the stop process failed: {error}\n")
        return None
    return context


def _obey(bus: StopBus) -> None:
    """Run until the service ends or crashes; a crash stops the machine."""
    names = ("SIGHUP", "SIGINT", "SIGTERM")
    signals = [bytes([getattr(signal, name)]) for name in names if hasattr(signal, name)]
    while word := os.read(0, 1):
        if word == TAKEN_OVER:
            bus.taken_over()
        elif word == END:
            os._exit(0)
        elif word == ORDER:  # from a running service, which monitors its drives
            bus.stop()
            bus.taken_over()
        elif word in signals:
            bus.stop()
    bus.stop()
    bus.insist()
    os._exit(0)


if __name__ == "__main__":
    main()
