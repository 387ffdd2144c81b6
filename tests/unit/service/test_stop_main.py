"""The order in which the stop process begins, without a process."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from service.stop_process import __main__ as stop_process
from service.stop_process.telling import Telling


class BusWithNews:
    """Its bus is open, or cannot be opened, before the constructor has returned."""

    def __init__(self, profile: Path, tell: Callable[[str], None]) -> None:
        del profile
        tell("no such interface")


def test_the_port_is_told_before_the_bus_has_news(monkeypatch: pytest.MonkeyPatch) -> None:
    """The service waits for the port: with any other line first it took the process for one that did not start."""
    reading, writing = os.pipe()
    monkeypatch.setattr(stop_process.sys, "argv", ["stop", "profile.yaml", "127.0.0.1", "0"])
    monkeypatch.setattr(stop_process, "Telling", lambda _: Telling(writing))
    monkeypatch.setattr(stop_process, "Bus", BusWithNews)
    monkeypatch.setattr(stop_process, "_obey", lambda _: None)
    monkeypatch.setattr(stop_process, "Listener", lambda *_: SimpleNamespace(port=1234, serve=lambda: None))
    stop_process.main()
    os.close(writing)
    with os.fdopen(reading) as told:
        first, second = (json.loads(line) for line in told)
    assert first == {"port": 1234, "pid": os.getpid()}
    assert second == {"trouble": "no such interface"}
