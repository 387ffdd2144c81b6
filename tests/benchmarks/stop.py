"""How long from the request for a stop to the quick stop on the bus, while the service is attacked.

``python -m tests.benchmarks.stop [--times N]`` prints a table: for each attack the shortest, the median and the longest
time, s, of the stop process' port. Measured from just before the request is sent to the first quick stop that another
client of the bus hears; its own delay is in it. A virtual machine and the service run in processes of their own.
"""

import argparse
import signal
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

from service.client import ServiceClient
from tests.system.bus_listener import QUICK_STOP, Ear, listening
from tests.system.rest_bench import Service, VirtualMachine, serving, until, virtual_machine
from tests.system.rest_bench import release as release_stops
from tests.system.test_stop import JOINTS, NODES, service_process, stop_url

IDLE = 1100  # connections
SETTLE = 1.0  # s that an attack has before the stop


@contextmanager
def nothing(service: Service, machine: VirtualMachine) -> Iterator[None]:
    yield


@contextmanager
def large_plan(service: Service, machine: VirtualMachine) -> Iterator[None]:
    """4 MB of axes in one POST."""
    body = b'{"robot_id": 1, "axes": [' + b"{}," * (4 * 2**20 // 3 - 20) + b"{}]}"
    with repeated(
        lambda http: http.post("/plans", content=body, headers={"Content-Type": "application/json"}), service
    ):
        yield


@contextmanager
def listing(service: Service, machine: VirtualMachine) -> Iterator[None]:
    """Five clients that list without a pause."""
    with ExitStack() as stack:
        for _ in range(5):
            stack.enter_context(repeated(lambda http: http.get("/campaigns?limit=200"), service))
        yield


@contextmanager
def idle_connections(service: Service, machine: VirtualMachine) -> Iterator[None]:
    """As many to the service, and to the port of the stop itself."""
    ports = [urlsplit(service.url).port, urlsplit(stop_url(service)).port]
    with ExitStack() as stack:
        for _ in range(IDLE // 2):
            for port in ports:
                with suppress(OSError):
                    stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=1))
        yield


@contextmanager
def mute_nodes(service: Service, machine: VirtualMachine) -> Iterator[None]:
    """Nodes that hear and do not answer."""
    for joint in JOINTS:
        machine.order("silence", joint=joint, on=True)
    try:
        yield
    finally:
        for joint in JOINTS:
            machine.order("silence", joint=joint, on=False)


@contextmanager
def suspended(service: Service, machine: VirtualMachine) -> Iterator[None]:
    """The service does not run at all."""
    service_process(service).suspend()
    try:
        yield
    finally:
        service_process(service).resume()


@contextmanager
def bus_was_off(service: Service, machine: VirtualMachine) -> Iterator[None]:
    """The service has lost the bus and has not come back to it; the bus has."""
    machine.order("bus_off")
    with httpx.Client(base_url=f"{service.url}/api/v1", trust_env=False, timeout=60) as http:
        until(lambda: not http.get("/drives").json().get("connected", True), "the service has lost the bus")
        machine.order("bus_on")
        yield
        http.post("/drives/connect")


ATTACKS = (nothing, large_plan, listing, idle_connections, mute_nodes, suspended, bus_was_off)


@contextmanager
def repeated(request: Callable[[httpx.Client], object], service: Service) -> Iterator[None]:
    """A client that asks again as soon as it has its answer."""
    ended = threading.Event()

    def ask() -> None:
        with httpx.Client(base_url=f"{service.url}/api/v1", trust_env=False, timeout=60) as http:
            while not ended.is_set():
                with suppress(httpx.TransportError):
                    request(http)

    thread = threading.Thread(target=ask)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def press(url: str) -> None:
    """By hand: an HTTP client takes longer to come to life than the stop does."""
    address = urlsplit(url)
    with socket.create_connection((address.hostname, address.port), timeout=30) as connection:
        connection.sendall(b"POST /stop?by=benchmark HTTP/1.1\r\nHost: stop\r\n\r\n")
        while connection.recv(4096):
            pass


def to_the_wire(ear: Ear, stop: Callable[[], object]) -> float:
    """From the request to the quick stop of the last node, s."""
    ear.forget()
    begun = time.monotonic()
    asking = threading.Thread(target=stop)
    asking.start()
    while not ear.quick_stops() >= set(NODES):
        if time.monotonic() - begun > 30:
            raise TimeoutError(f"{QUICK_STOP.hex()} did not come for every node")
        time.sleep(0.0005)
    needed = time.monotonic() - begun
    asking.join()
    return needed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=5)
    times = parser.parse_args().times
    print(f"{'attack':18} {'shortest':>9} {'median':>9} {'longest':>9}  s to the wire, {times} stops each")
    with tempfile.TemporaryDirectory() as name, virtual_machine(Path(name), 1.0) as machine:
        with serving(Path(name), machine.profile) as service, listening(machine) as ear:
            url = stop_url(service)
            for attack in ATTACKS:
                needed: list[float] = []
                for _ in range(times):
                    with attack(service, machine):
                        time.sleep(SETTLE)
                        needed.append(to_the_wire(ear, lambda: press(url)))
                tell(attack.__name__, needed)
                release(service)
        needed = []
        for _ in range(times):
            service = Service(Path(name), machine.profile)
            service.start()
            stop_url(service)
            with large_plan(service, machine), listening(machine) as ear:
                time.sleep(SETTLE)
                process = service_process(service)
                needed.append(to_the_wire(ear, lambda process=process: process.send_signal(signal.SIGTERM)))
            service.close()
        tell("SIGTERM, 4 MB plan", needed)


def tell(attack: str, needed: list[float]) -> None:
    print(f"{attack:18} {min(needed):9.4f} {statistics.median(needed):9.4f} {max(needed):9.4f}", flush=True)


def release(service: Service) -> None:
    with ServiceClient(service.url) as client:
        until(lambda: all(stop["id"] > 0 for stop in client.stops()), "every stop is latched")
        release_stops(client, "benchmark")


if __name__ == "__main__":
    main()
