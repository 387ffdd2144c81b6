"""The stop while the service cannot: blocked, told to end, killed, or before drives that hear and do not answer."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import psutil
import pytest

from service.client import ServiceClient, ServiceProblem
from tests.system.bus_listener import listening
from tests.system.rest_bench import (
    PATIENCE,
    SHORT_LEASE,
    SWEEPID,
    Fieldbus,
    Service,
    VirtualMachine,
    add_plan,
    serving,
    until,
    virtual_machine,
)

NODES = range(1, 7)
JOINTS = {f"joint_{number}" for number in NODES}
FLOOD = 1000  # stops
ANSWERED = 1.2  # s
KEPT = 4900  # bytes that each stop kept before repeated ones were merged


@pytest.fixture(autouse=True)
def heard_hang_up() -> Iterator[None]:
    """What is started hears SIGHUP, though it ignores it where the tests themselves were started by nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture(params=[Fieldbus.CANOPEN], ids=lambda fieldbus: fieldbus.value)
def machine(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[VirtualMachine]:
    with virtual_machine(tmp_path, 4.0, request.param) as machine:
        yield machine


@pytest.fixture
def service(tmp_path: Path, machine: VirtualMachine) -> Iterator[Service]:
    with serving(tmp_path, machine.profile, SHORT_LEASE) as service:
        yield service


@pytest.fixture
def client(service: Service) -> Iterator[ServiceClient]:
    with ServiceClient(service.url) as client:
        yield client


def moving(client: ServiceClient, machine: VirtualMachine, modes: str = "drive_side") -> int:
    """A campaign under way: an axis moves to the pose, or (host_streamed) joint_1 along its sweep."""
    campaign = int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=1, modes=modes))["id"])
    client.start(campaign)
    streamed = ["joint_1"] if modes == "host_streamed" else JOINTS

    def moves() -> bool:
        return any(machine.axes()[joint]["velocity"] != 0 for joint in streamed)

    until(lambda: moves() or client.campaign(campaign)["state"] != "running", "it moves", 3 * PATIENCE)
    found = client.campaign(campaign)
    assert found["state"] == "running", found["cause"]
    return campaign


def stop_url(service: Service) -> str:
    """Where the stop process listens, once it is on the bus."""
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60, trust_env=False) as http:
        until(lambda: http.get("/stop").json()["process_trouble"] == "", "the stop process is on the bus")
        return f"http://127.0.0.1:{http.get('/stop').json()['port']}/stop"


def press(url: str, **words: str) -> httpx.Response:
    return httpx.post(url, params=words, timeout=PATIENCE, trust_env=False)


def service_process(service: Service) -> psutil.Process:
    return psutil.Process(service.running().pid)


@pytest.mark.parametrize("modes", ["drive_side", "host_streamed"])
def test_a_service_that_does_not_run_at_all_is_no_hindrance(
    service: Service, machine: VirtualMachine, client: ServiceClient, modes: str
) -> None:
    url = stop_url(service)
    campaign = moving(client, machine, modes)
    with listening(machine) as ear:
        service_process(service).suspend()  # no thread of it does anything
        ear.forget()
        answer = press(url, by="Ada", why="smoke")
        assert (answer.status_code, set(answer.json()["confirmed"])) == (200, JOINTS)
        until(lambda: ear.quick_stops() == set(NODES), "the quick stop is on the bus")
        until(lambda: ear.nmt_stops() == set(NODES), "nobody took the stop over: the drives are made deaf")
        until(machine.stands, "the axes stand")
        service_process(service).resume()
    until(lambda: client.campaign(campaign)["state"] == "paused", "campaign paused")
    until(lambda: [stop["id"] for stop in client.stops()] == [1], "latched in the database")
    (stop,) = client.stops()
    assert (stop["by"], stop["why"]) == ("Ada", "smoke")
    assert client.campaign(campaign)["cause"].startswith("stopped by Ada: smoke")


@pytest.mark.parametrize("machine", [Fieldbus.MODBUS_TCP], indirect=True, ids=lambda fieldbus: fieldbus.value)
def test_on_modbus_it_writes_the_registers_by_a_connection_of_its_own(
    service: Service, machine: VirtualMachine, client: ServiceClient
) -> None:
    url = stop_url(service)
    moving(client, machine)
    service_process(service).suspend()
    answer = press(url, by="Ada", press="1")
    assert (answer.status_code, set(answer.json()["confirmed"])) == (200, JOINTS), answer.text
    assert machine.stands()
    service_process(service).resume()
    until(lambda: [stop["by"] for stop in client.stops()] == ["Ada"], "latched")


@pytest.mark.parametrize("modes", ["drive_side", "host_streamed"])
def test_a_press_that_comes_by_both_ways_is_one_stop_and_both_answers_are_good(
    service: Service, machine: VirtualMachine, client: ServiceClient, modes: str
) -> None:
    url = stop_url(service)
    campaign = moving(client, machine, modes)
    with listening(machine) as ear:
        assert press(url, by="Ada", press="1").status_code == 200
        answer = press(f"{service.url}/api/v1/stop/", by="Ada", press="1")  # the slash makes no redirection of it
        assert answer.status_code == 200, answer.text
        assert set(answer.json()["confirmed"]) == JOINTS
        assert machine.stands()
        assert ear.quick_stops() == set(NODES)
        assert ear.nmt_stops() == set()  # a service that answers needs its drives to
    assert len(client.stops()) == 1
    until(lambda: client.campaign(campaign)["state"] == "paused", "campaign paused")
    assert client.drives()["connected"]


def test_a_flood_at_the_open_port_is_bounded_and_delays_no_other_stop(
    service: Service, machine: VirtualMachine, client: ServiceClient
) -> None:
    url = stop_url(service)
    moving(client, machine)
    process = service_process(service)
    (beside,) = (each for each in process.children() if "service.stop_process" in each.cmdline())

    def stopped(port: int | None, path: str, by: str, wait: int) -> int:
        """Without the certificates that a client of httpx reads."""
        with closing(HTTPConnection("127.0.0.1", port, timeout=PATIENCE)) as connection:
            connection.request("POST", f"{path}by={by}&wait={wait}")
            return connection.getresponse().status

    def flood(times: int) -> None:
        port = urlsplit(url).port
        with ThreadPoolExecutor(4) as senders:
            presses = (f"/stop?press={number}&" for number in range(times * FLOOD))
            assert set(senders.map(lambda path: stopped(port, path, "nobody", 0), presses)) <= {200, 202, 503}

    flood(1)  # what each process needs once
    before = [each.memory_info().rss for each in (process, beside)]
    with ThreadPoolExecutor(1) as apart:
        flooding = apart.submit(flood, 3)
        begun = time.monotonic()
        status = stopped(urlsplit(service.url).port, "/api/v1/stop?", "Ada", 1)
        took = time.monotonic() - begun
        flooding.result()
    assert status in (200, 503)  # a busy computer may confirm it later, and says so in time
    assert took <= ANSWERED
    grown = [each.memory_info().rss - was for each, was in zip((process, beside), before, strict=True)]
    assert max(grown) < 3 * FLOOD * KEPT / 2
    assert machine.stands()
    assert [stop["by"] for stop in client.stops()] == ["nobody", "Ada"]


def test_drives_that_hear_and_do_not_answer_are_told_all_the_same_and_named(
    service: Service, machine: VirtualMachine, client: ServiceClient
) -> None:
    moving(client, machine)
    with listening(machine) as ear:
        for joint in JOINTS:
            machine.order("silence", joint=joint, on=True)
        ear.forget()
        with pytest.raises(ServiceProblem) as told:
            client.stop("Ada", "smoke")
        assert told.value.status == 503
        assert all(joint in told.value.detail for joint in JOINTS)
        assert ear.quick_stops() == set(NODES)
    until(machine.stands, "the axes stand")
    assert [stop["by"] for stop in client.stops()] == ["Ada"]
    for joint in JOINTS:
        machine.order("silence", joint=joint, on=False)


def test_a_bus_that_is_off_is_told_by_both(service: Service, machine: VirtualMachine, client: ServiceClient) -> None:
    url = stop_url(service)
    machine.order("bus_off")
    until(lambda: press(url, by="Ada").status_code == 503, "the stop process notices")
    answer = press(f"{service.url}/api/v1/stop", by="Ada")
    assert answer.status_code == 503
    assert set(answer.json()["unconfirmed"]) == JOINTS
    machine.order("bus_on")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_told_to_end_the_machine_comes_before_open_requests(
    service: Service, machine: VirtualMachine, client: ServiceClient, number: signal.Signals
) -> None:
    stop_url(service)
    moving(client, machine)
    address = urlsplit(service.url)
    with (
        listening(machine) as ear,
        socket.create_connection((address.hostname, address.port), timeout=PATIENCE) as open_request,
    ):
        open_request.sendall(
            b"POST /api/v1/plans HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
            b"Content-Length: 10\r\n\r\n{"
        )
        process = service_process(service)
        ear.forget()
        process.send_signal(number)
        until(lambda: ear.quick_stops() == set(NODES), "the quick stop is on the bus")
        until(machine.stands, "the axes stand")
        open_request.settimeout(PATIENCE)
        with suppress(ConnectionResetError):
            open_request.recv(1)  # let go only when the service gives up waiting for it
    service.close()


def test_the_death_of_the_service_is_a_stop(service: Service, machine: VirtualMachine, client: ServiceClient) -> None:
    stop_url(service)
    moving(client, machine)
    with listening(machine) as ear:
        process = service_process(service)
        (beside,) = (each for each in process.children() if "service.stop_process" in each.cmdline())
        ear.forget()
        process.kill()
        until(lambda: ear.quick_stops() == set(NODES), "the quick stop is on the bus")
        beside.wait(PATIENCE)
    until(machine.stands, "the axes stand")
    service.end()
    service.start()


def test_a_stop_process_that_ends_is_started_anew_at_its_port(service: Service, client: ServiceClient) -> None:
    url = stop_url(service)
    (beside,) = (each for each in service_process(service).children() if "service.stop_process" in each.cmdline())
    beside.kill()
    until(lambda: any("stop process" in cause for cause in client.ready()["causes"]), "it is missed")
    until(lambda: client.ready()["ready"], "it is there again")
    assert stop_url(service) == url
    assert press(url).status_code == 200


@pytest.mark.parametrize(("number", "why"), [(signal.SIGTERM, "SIGTERM"), (signal.SIGHUP, "the terminal was lost")])
def test_measure_told_to_end_stops_the_machine(
    service: Service, machine: VirtualMachine, client: ServiceClient, number: signal.Signals, why: str
) -> None:
    plan = add_plan(client, axes=["joint_1"], poses=1, modes="drive_side")
    environment = os.environ | {"SWEEPID_URL": service.url}
    command = [sys.executable, SWEEPID, "measure", str(plan)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as measuring:
        until(lambda: any(axis["velocity"] != 0 for axis in machine.axes().values()), "it moves")
        measuring.send_signal(number)
        _, words = measuring.communicate(timeout=PATIENCE)
    assert b"machine stopped" in words.splitlines()[-1]
    assert measuring.returncode == 1
    until(machine.stands, "the axes stand")
    stopped = [f"stopped by sweepid measure: {why}"]
    until(lambda: client.ready()["causes"] == stopped, "it is held by that stop alone")  # the campaign's end is stored
