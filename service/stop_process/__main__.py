"""``python -m service.stop_process PROFILE HOST PORT [CERTIFICATE KEY]``: started by `sweepid serve`, ends with it."""

import json
import os
import signal
import ssl
import sys
import threading
from dataclasses import asdict
from pathlib import Path

from service.stop_process import END, ORDER, TAKEN_OVER
from service.stop_process.bus import Bus
from service.stop_process.listener import Answer, Listener, Request

_SIGNALS = tuple(bytes([getattr(signal, name)]) for name in ("SIGHUP", "SIGINT", "SIGTERM") if hasattr(signal, name))
_telling = threading.Lock()


def main() -> None:
    profile, host, port, *tls = sys.argv[1:]
    try:
        listener = Listener(host, int(port), lambda wanted: _stop(bus, wanted), lambda: _status(bus), _context(tls))
    except OSError as error:
        _tell({"error": f"cannot listen at {host}:{port} for the stop: {error.strerror or error}"})
        raise SystemExit(1) from None
    bus = Bus(Path(profile), lambda trouble: _tell({"trouble": trouble}))
    _tell({"port": listener.port, "pid": os.getpid()})
    threading.Thread(target=_obey, args=[bus], name="stop-orders", daemon=True).start()
    listener.serve()


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


def _stop(bus: Bus, wanted: Request) -> Answer:
    outcome = bus.stop()
    _tell({"stop": asdict(wanted)})
    if outcome.told:
        return 200, {"told": outcome.told, "doubtful": {j: doubt for j, doubt in outcome.joints.items() if doubt}}
    reasons = outcome.trouble or "; ".join(f"{joint}: {doubt}" for joint, doubt in outcome.joints.items())
    return 503, {
        "type": "urn:sweepid:problem:stop-not-confirmed",
        "title": "Service Unavailable",
        "status": 503,
        "detail": f"the stop process could not reach any drive: {reasons}",
        "axes": dict(outcome.joints),
    }


def _status(bus: Bus) -> Answer:
    return 200, {"trouble": bus.trouble}


def _obey(bus: Bus) -> None:
    """Run until the service ends or crashes; a crash stops the machine."""
    while word := os.read(0, 1):
        if word == TAKEN_OVER:
            bus.taken_over()
        elif word == END:
            os._exit(0)
        elif word == ORDER:  # from a running service, which monitors its drives
            bus.stop()
            bus.taken_over()
        elif word in _SIGNALS:
            bus.stop()
    bus.stop()
    bus.insist()
    os._exit(0)


def _tell(message: dict[str, object]) -> None:
    """Hardly ever blocks: the pipe has room for thousands of lines if the service does not read for a while."""
    try:
        with _telling:
            os.write(1, json.dumps(message).encode() + b"\n")
    except OSError:  # the service has ended; this process learns it from its input
        return


if __name__ == "__main__":
    main()
