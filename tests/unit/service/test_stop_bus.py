"""The connection of the stop process to the bus: lost while a stop is sent, and there again."""

import queue
import threading
import time
from collections.abc import Mapping
from pathlib import Path

import pytest

import drivers.registry
from drivers.errors import ConnectionFailed
from service.stop_process import bus
from service.stop_process.bus import Bus, Outcome

JOINT = "joint_1"


class Sender:
    """As that of Modbus: it opens nothing, so only a stop notices that the gateway is gone."""

    joints = (JOINT,)

    def __init__(self) -> None:
        self.gone = threading.Event()
        self.sent: queue.SimpleQueue[float] = queue.SimpleQueue()

    def stop_sender(self) -> "Sender":
        return self

    def open(self) -> None:
        pass

    def listen(self, within: float) -> None:
        time.sleep(min(within, 0.01))

    def send(self) -> Mapping[str, str]:
        if self.gone.is_set():
            raise ConnectionFailed("refused")
        self.sent.put(time.monotonic())
        return {JOINT: ""}

    def confirm(self, within: float) -> Mapping[str, str]:
        del within
        return {JOINT: ""}

    def insist(self) -> None:
        pass

    def close(self) -> None:
        pass


@pytest.fixture
def sender(monkeypatch: pytest.MonkeyPatch) -> Sender:
    sender = Sender()
    monkeypatch.setattr(drivers.registry, "open_profile", lambda _: ({}, sender))
    monkeypatch.setattr(bus, "_AGAIN", 0.01)
    return sender


def test_a_stop_that_could_not_be_sent_is_sent_when_the_gateway_is_back_and_so_is_the_next(sender: Sender) -> None:
    troubles: queue.SimpleQueue[str] = queue.SimpleQueue()
    stopping = Bus(Path("profile.yaml"), troubles.put)
    assert troubles.get(timeout=10) == ""
    sender.gone.set()
    assert stopping.stop() == Outcome({JOINT: "refused"}, "refused")
    assert troubles.get(timeout=10) == "refused"
    sender.gone.clear()
    sender.sent.get(timeout=10)
    assert troubles.get(timeout=10) == ""
    time.sleep(2 * bus.MERGED)
    assert stopping.stop() == Outcome({JOINT: ""})
    sender.sent.get(timeout=10)
    stopping.close()
