"""The stop process: its start, its bus lost while a stop is sent, its port, and the end of it that the service has.

The port sends the frames first, answers when it is known, and serves every other connection meanwhile.
"""

import json
import os
import queue
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from types import SimpleNamespace

import httpx
import pytest

import drivers.registry
from drivers.errors import ConnectionFailed
from service.machine.stop_process import __main__ as stop_process
from service.machine.stop_process.__main__ import Telling
from service.machine.stop_process.bus import StopBus, StopOutcome
from service.machine.stop_process.handle import StopProcess
from service.machine.stop_process.listener import Answer, Answered, Listener, Request, answer_to, waiting_time
from tests.system.rest_bench import until


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
    monkeypatch.setattr(stop_process, "StopBus", BusWithNews)
    monkeypatch.setattr(stop_process, "_obey", lambda _: None)
    monkeypatch.setattr(stop_process, "Listener", lambda *_: SimpleNamespace(port=1234, serve=lambda: None))
    stop_process.main()
    os.close(writing)
    with os.fdopen(reading) as told:
        first, second = (json.loads(line) for line in told)
    assert first == {"port": 1234, "pid": os.getpid()}
    assert second == {"trouble": "no such interface"}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no wake-up descriptor for signals")
def test_signals_are_told_to_no_closed_pipe(root: Path) -> None:
    with StopProcess(root / "config" / "drives" / "virtual-max100.yaml", "127.0.0.1", 0) as process:
        process.watch_signals()
        watched = signal.set_wakeup_fd(-1)
        assert watched >= 0
        process.watch_signals()
    assert signal.set_wakeup_fd(-1) == -1


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows cannot suspend a process by a signal")
def test_a_stop_process_that_hangs_is_missed_until_it_goes_on(root: Path) -> None:
    with StopProcess(root / "config" / "drives" / "virtual-max100.yaml", "127.0.0.1", 0) as process:
        assert process.failed == ""
        os.kill(process.pid, signal.SIGSTOP)
        until(lambda: "the stop process has not answered for" in process.failed, "it is missed")
        assert process.trouble == process.failed
        os.kill(process.pid, signal.SIGCONT)
        until(lambda: process.failed == "", "it is there again")


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
    monkeypatch.setattr(StopBus, "again", 0.01)
    return sender


def test_a_stop_that_could_not_be_sent_is_sent_when_the_gateway_is_back_and_so_is_the_next(sender: Sender) -> None:
    troubles: queue.SimpleQueue[str] = queue.SimpleQueue()
    stopping = StopBus(Path("profile.yaml"), troubles.put)
    assert troubles.get(timeout=10) == ""
    sender.gone.set()
    assert stopping.stop() == StopOutcome({JOINT: "refused"}, "refused")
    assert troubles.get(timeout=10) == "refused"
    sender.gone.clear()
    sender.sent.get(timeout=10)
    assert troubles.get(timeout=10) == ""
    time.sleep(2 * StopBus.merged)
    assert stopping.stop() == StopOutcome({JOINT: ""})
    sender.sent.get(timeout=10)
    stopping.close()


PATIENCE = 10.0  # s


class Pressed:
    """Stops that arrive, and how they are answered later."""

    def __init__(self) -> None:
        self.stops: list[tuple[Request, Answered]] = []
        self.arrived = threading.Semaphore(0)

    def __call__(self, wanted: Request, answered: Answered) -> None:
        self.stops.append((wanted, answered))
        self.arrived.release()


class Ended(BaseException):
    """Ends the thread of a listener."""


@pytest.fixture
def pressed() -> Pressed:
    return Pressed()


@pytest.fixture
def port(pressed: Pressed) -> Iterator[int]:
    ending = threading.Event()

    def alive() -> None:
        if ending.is_set():
            raise Ended

    def status() -> Answer:
        return 200, {"trouble": ""}

    listener = Listener("127.0.0.1", 0, pressed, status, alive=alive)

    def serve() -> None:
        with suppress(Ended):
            listener.serve()

    thread = threading.Thread(target=serve)
    thread.start()
    yield listener.port
    ending.set()
    thread.join(PATIENCE)
    listener.close()


def asked(port: int, line: bytes = b"POST /stop?by=Ada HTTP/1.1\r\n\r\n") -> socket.socket:
    client = socket.create_connection(("127.0.0.1", port), timeout=PATIENCE)
    client.sendall(line)
    return client


def told(client: socket.socket) -> bytes:
    with client:
        return b"".join(iter(lambda: client.recv(65536), b""))


def test_it_serves_others_while_a_stop_waits_for_its_confirmation(pressed: Pressed, port: int) -> None:
    """Also a client that has ended its half of the connection gets its answer."""
    first = asked(port)
    assert pressed.arrived.acquire(timeout=PATIENCE)
    second = asked(port)
    assert pressed.arrived.acquire(timeout=PATIENCE)
    second.shutdown(socket.SHUT_WR)
    assert httpx.get(f"http://127.0.0.1:{port}/stop", timeout=PATIENCE, trust_env=False).json() == {"trouble": ""}
    for number, (_, answered) in enumerate(reversed(pressed.stops)):
        answered((200, {"number": number}))
    assert b'{"number": 1}' in told(first)
    assert b'{"number": 0}' in told(second)


def test_more_stops_than_connections_are_all_executed_and_the_oldest_is_told_at_once(
    pressed: Pressed, port: int
) -> None:
    with ExitStack() as stack:
        clients = [stack.enter_context(asked(port)) for _ in range(Listener.most_connections + 1)]
        for _ in clients:
            assert pressed.arrived.acquire(timeout=PATIENCE)
        assert b"too many stops at once: sent, not confirmed" in told(clients[0])


def test_a_stop_that_comes_after_its_connection_has_a_place_among_too_many(pressed: Pressed, port: int) -> None:
    with ExitStack() as stack:
        clients = [stack.enter_context(asked(port)) for _ in range(Listener.most_connections)]
        for _ in clients:
            assert pressed.arrived.acquire(timeout=PATIENCE)
        late = stack.enter_context(asked(port, b""))
        assert b"too many stops at once: sent, not confirmed" in told(clients[0])  # the late one has been accepted
        late.sendall(b"POST /stop?by=Berta HTTP/1.1\r\n\r\n")
        assert pressed.arrived.acquire(timeout=PATIENCE)
        assert pressed.stops[-1][0].by == "Berta"


def test_a_service_that_does_not_read_blocks_nothing_and_costs_bounded_memory() -> None:
    reading, writing = os.pipe()
    try:
        telling = Telling(writing)
        for number in range(10_000):
            telling.tell({"stop": {"by": f"somebody {number}", "why": "x" * 500, "press": "", "address": "::1"}})
        assert len(telling.waiting) <= Telling.most  # the memory is what is tested
        while telling.waiting:
            assert os.read(reading, 1 << 16).startswith(b'{"stop"')
            telling.flush()
    finally:
        os.close(reading)
        os.close(writing)


@pytest.mark.parametrize(
    ("word", "wait"), [("", 1.0), ("0", 0.0), ("0.5", 0.5), ("7", 1.0), ("-1", 0.0), ("soon", 1.0), ("nan", 1.0)]
)
def test_a_stop_is_not_refused_for_a_badwaiting_time(word: str, wait: float) -> None:
    assert waiting_time(word) == wait


SENT = StopOutcome({"joint_1": "", "joint_2": ""})
NOT_SENT = StopOutcome({"joint_1": "x"}, "x")
ONE_MOVES = StopOutcome({"joint_1": "turns", "joint_2": ""})


@pytest.mark.parametrize(
    ("sent", "confirmed", "status", "detail"),
    [
        (SENT, SENT, 200, ""),
        (SENT, None, 202, ""),  # not waited for
        (SENT, ONE_MOVES, 503, "stop sent, not confirmed within 1 s: joint_1: turns; use the emergency stop"),
        (StopOutcome(trouble="x"), StopOutcome(trouble="x"), 503, "stop not sent: stop process: x; use"),
        (NOT_SENT, NOT_SENT, 503, "stop not sent: joint_1: x"),
        (NOT_SENT, None, 503, "stop not sent: joint_1: x; use"),
    ],
)
def test_the_answer_says_what_was_sent_and_what_is_confirmed(
    sent: StopOutcome, confirmed: StopOutcome | None, status: int, detail: str
) -> None:
    found = answer_to(Request("Ada", "smoke", "", "::1"), sent, confirmed)
    assert found[0] == status
    assert str(found[1].get("detail", "")).startswith(detail)
