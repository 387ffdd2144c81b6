"""How long from the request for a stop to the quick stop of the last node on the bus, while the service is attacked.

The request goes to the port of the stop process. Measured is from just before it is sent until another client of the
bus has heard the quick stop of every node; that client's own delay is in it. A virtual machine and the service run in
processes of their own.
"""

import socket
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import psutil

from docs.benchmarks.measured import Measured
from service.web.client import ServiceClient
from tests.system.bus_listener import Ear, listening
from tests.system.rest_bench import Service, VirtualMachine, release, serving, until, virtual_machine

NODES = frozenset(range(1, 7))
TIMES = 5  # stops of each attack
IDLE = 1100  # connections
SETTLE = 1.0  # s that an attack has before the stop
MOST = 0.2  # s


@contextmanager
def nothing(service: Service, machine: VirtualMachine) -> Iterator[None]:
    yield


@contextmanager
def listing(service: Service, machine: VirtualMachine) -> Iterator[None]:
    """Five clients that ask again as soon as they have their answer."""
    ended = threading.Event()

    def ask() -> None:
        with httpx.Client(base_url=f"{service.url}/api/v1", trust_env=False, timeout=60) as http:
            while not ended.is_set():
                with suppress(httpx.TransportError):
                    http.get("/campaigns?limit=200")

    threads = [threading.Thread(target=ask) for _ in range(5)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in threads:
            thread.join()


@contextmanager
def idle_connections(service: Service, machine: VirtualMachine) -> Iterator[None]:
    """As many to the service, and to the port of the stop itself."""
    with ExitStack() as stack:
        for port in (urlsplit(service.url).port, stop_port(service)) * (IDLE // 2):
            with suppress(OSError):
                stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=1))
        yield


@contextmanager
def mute_nodes(service: Service, machine: VirtualMachine) -> Iterator[None]:
    """Nodes that hear and do not answer."""
    for node in NODES:
        machine.order("silence", joint=f"joint_{node}", on=True)
    try:
        yield
    finally:
        for node in NODES:
            machine.order("silence", joint=f"joint_{node}", on=False)


@contextmanager
def suspended(service: Service, machine: VirtualMachine) -> Iterator[None]:
    """The service does not run at all."""
    process = psutil.Process(service.running().pid)
    process.suspend()
    try:
        yield
    finally:
        process.resume()


ATTACKS = {
    "no other load": nothing,
    "five clients that list campaigns": listing,
    "1,100 idle connections, half of them to either port": idle_connections,
    "nodes that do not answer": mute_nodes,
    "the service is suspended": suspended,
}


def stop_port(service: Service) -> int:
    """Where the stop process listens, once it is on the bus."""
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60, trust_env=False) as http:
        until(lambda: http.get("/stop").json()["process_trouble"] == "", "the stop process is on the bus")
        return int(http.get("/stop").json()["port"])


def press(port: int) -> None:
    """By hand: an HTTP client takes longer to come to life than the stop does."""
    with socket.create_connection(("127.0.0.1", port), timeout=30) as connection:
        connection.sendall(b"POST /stop?by=benchmark HTTP/1.1\r\nHost: stop\r\n\r\n")
        while connection.recv(4096):
            pass


def to_the_wire(ear: Ear, stop: Callable[[], None]) -> float:
    """s from the request to the quick stop of the last node."""
    ear.forget()
    begun = time.monotonic()
    asking = threading.Thread(target=stop)
    asking.start()
    while not ear.quick_stops() >= NODES:
        if time.monotonic() - begun > 30:
            raise TimeoutError("a quick stop did not come for every node")
        time.sleep(0.0005)
    needed = time.monotonic() - begun
    asking.join()
    return needed


def run() -> Iterator[Measured]:
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        machine = stack.enter_context(virtual_machine(Path(name), 1.0))
        service = stack.enter_context(serving(Path(name), machine.profile))
        ear = stack.enter_context(listening(machine))
        client = stack.enter_context(ServiceClient(service.url))
        port = stop_port(service)
        for what, attack in ATTACKS.items():
            needed: list[float] = []
            for _ in range(TIMES):
                with attack(service, machine):
                    time.sleep(SETTLE)
                    needed.append(to_the_wire(ear, lambda: press(port)))
            until(lambda: all(stop["id"] > 0 for stop in client.stops()), "every stop is latched")
            release(client, "benchmark")
            yield Measured(
                name=f"{what}: longest", unit="ms", ours=1e3 * max(needed), repeats=TIMES,
                target=f"<= {1e3 * MOST:g} ms", met=max(needed) <= MOST,
                note=f"shortest {1e3 * min(needed):.1f}, median {1e3 * statistics.median(needed):.1f} ms",
            )  # fmt: skip
