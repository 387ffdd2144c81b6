"""Once for real what tests/virtual_time shows over interleavings: signals of the kernel, sockets, a bus of other hosts.

All tests share a machine; who ends its service starts another.
"""

import io
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import numpy as np
import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from websockets.sync.client import connect

from drivers.canopen import frames
from service.store.database import open_database
from service.store.people.audit import AuditStore, verify
from service.web.client import ServiceClient, ServiceProblem
from tests.forked import fork, heard, tell
from tests.system.bus_listener import Ear, listening
from tests.system.rest_bench import (
    PATIENCE,
    SHORT_LEASE,
    Fieldbus,
    Service,
    VirtualMachine,
    add_plan,
    release,
    serving,
    until,
    virtual_machine,
)

AXIS = "joint_1"
NODES = range(1, 7)
JOINTS = {f"joint_{number}" for number in NODES}
FLOOD = 1000  # stops
ANSWERED = 1.2  # s
KEPT = 4900  # bytes that each stop kept before repeated ones were merged
GAP = 4.0  # s, longer than the drives wait for their host
WATCHED = 1.0  # s
SIGN_OF_LIFE = 1.0  # s, the shortest that is taken
# a background job of a shell hands an ignored Ctrl-C down; whoever tests it must have it
INTERRUPTIBLE = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from service.cli import main; main()"
)


@pytest.fixture(scope="module", autouse=True)
def heard_hang_up() -> Iterator[None]:
    """What is started hears SIGHUP, though it ignores it where the tests themselves were started by nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory, heard_hang_up: None) -> Iterator[VirtualMachine]:
    with virtual_machine(tmp_path_factory.mktemp("machine"), 4.0) as machine:
        yield machine


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory, machine: VirtualMachine) -> Iterator[Service]:
    with serving(tmp_path_factory.mktemp("service"), machine.profile, SHORT_LEASE) as service:
        yield service


@pytest.fixture
def service(running: Service) -> Service:
    """Which runs, whatever the test before did to it, on drives that nothing holds."""
    if not running.runs:
        running.start()
    with ServiceClient(running.url) as client:
        released(client)
    return running


@pytest.fixture
def client(service: Service) -> Iterator[ServiceClient]:
    with ServiceClient(service.url) as client:
        yield client


@pytest.fixture
def ear(machine: VirtualMachine) -> Iterator[Ear]:
    with listening(machine) as ear:
        yield ear


def released(client: ServiceClient) -> None:
    """As by a person who has looked at the machine."""
    if client.stops():
        release(client)
    if not client.drives()["connected"]:
        client.connect()
    for axis in client.drives()["axes"]:
        if axis["fault"]:
            client.acknowledge(axis["joint"])


def added(client: ServiceClient, modes: str = "drive_side") -> int:
    return int(client.add_campaign(add_plan(client, axes=[AXIS], poses=1, modes=modes))["id"])


def moving(client: ServiceClient, machine: VirtualMachine, modes: str = "drive_side") -> int:
    """A campaign under way: an axis moves to the pose, or (host_streamed) joint_1 along its sweep."""
    campaign = added(client, modes)
    client.start(campaign)
    streamed = [AXIS] if modes == "host_streamed" else JOINTS

    def moves() -> bool:
        return any(machine.axes()[joint]["velocity"] != 0 for joint in streamed)

    until(lambda: moves() or client.campaign(campaign)["state"] != "running", "it moves", 3 * PATIENCE)
    found = client.campaign(campaign)
    assert found["state"] == "running", found["cause"]
    return campaign


def paused(client: ServiceClient, campaign: int) -> str:
    """The cause."""
    until(lambda: client.campaign(campaign)["state"] == "paused", "campaign paused")
    return str(client.campaign(campaign)["cause"])


def stop_url(service: Service) -> str:
    """Where the stop process listens, once it is on the bus."""
    with httpx.Client(base_url=f"{service.url}/api/v1", timeout=60, trust_env=False) as http:
        until(lambda: http.get("/stop").json()["process_trouble"] == "", "the stop process is on the bus")
        return f"http://127.0.0.1:{http.get('/stop').json()['port']}/stop"


def press(url: str, **words: str) -> httpx.Response:
    return httpx.post(url, params=words, timeout=PATIENCE, trust_env=False)


def service_process(service: Service) -> psutil.Process:
    return psutil.Process(service.running().pid)


@contextmanager
def suspended(service: Service) -> Iterator[None]:
    """No thread of it does anything."""
    process = service_process(service)
    process.suspend()
    try:
        yield
    finally:
        process.resume()


def stop_process(service: Service) -> psutil.Process:
    children = service_process(service).children()
    (beside,) = (each for each in children if "service.machine.stop_process" in each.cmdline())
    return beside


def told(service: Service) -> tuple[str, str]:
    """Way and why of the newest stop that the service tells of itself in the audit, whose chain holds."""
    with open_database(f"sqlite:///{service.data / 'sweepid.sqlite'}") as database:
        store = AuditStore(database)
        verify(store.links())
        entries = [one.entry for one in store.documents(limit=10_000)]
    stops = sorted((one for one in entries if one["event"] == "stop"), key=lambda entry: str(entry["at"]))
    return str(stops[-1]["way"]), str(stops[-1]["why"])


def keeps_standing(machine: VirtualMachine, ear: Ear) -> None:
    """No axis has energy, and nothing is said on the bus that could move one."""
    ear.forget()
    end = time.monotonic() + WATCHED
    while time.monotonic() < end:
        assert machine.stands()
        time.sleep(0.02)
    assert ear.words_of_motion() == []


@pytest.mark.alone
def test_a_flood_at_the_open_port_is_bounded_and_delays_no_other_stop(
    service: Service, machine: VirtualMachine, client: ServiceClient
) -> None:
    url = stop_url(service)
    moving(client, machine)
    processes = (service_process(service), stop_process(service))

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

    memory: list[list[int]] = []
    for _ in range(4):
        flood(3)
        memory.append([each.memory_info().rss for each in processes])
    child, pipe = fork()  # threads of this process would hold up who measures
    if child == 0:
        tell(pipe, lambda: flood(3) or b"flooded")
    begun = time.monotonic()
    status = stopped(urlsplit(service.url).port, "/api/v1/stop?", "Ada", 1)
    took = time.monotonic() - begun
    assert heard(child, pipe) == (b"flooded", 0)
    assert status in (200, 503)  # a busy computer may confirm it later, and says so in time
    assert took <= ANSWERED
    memory.append([each.memory_info().rss for each in processes])
    grown = np.diff(memory, axis=0).min(axis=0)  # what stops leave grows with each flood, what a new service needs once
    assert grown.max() < 3 * FLOOD * KEPT / 2
    assert machine.stands()
    assert [stop["by"] for stop in client.stops()] == ["nobody", "Ada"]
    stopped(urlsplit(url).port, "/stop?", "Eve", 0)  # the last: what is still on its way would stop the next test
    until(lambda: "Eve" in [stop["by"] for stop in client.stops()], "the flood has passed")


def test_a_press_that_comes_by_both_ways_is_one_stop_and_both_answers_are_good(
    service: Service, machine: VirtualMachine, client: ServiceClient, ear: Ear
) -> None:
    url = stop_url(service)
    campaign = moving(client, machine)
    ear.forget()
    assert press(url, by="Ada", press="1").status_code == 200
    answer = press(f"{service.url}/api/v1/stop/", by="Ada", press="1")  # the slash makes no redirection of it
    assert answer.status_code == 200, answer.text
    assert set(answer.json()["confirmed"]) == JOINTS
    assert machine.stands()
    assert ear.quick_stops() == set(NODES)
    assert ear.nmt_stops() == set()  # a service that answers needs its drives to
    assert len(client.stops()) == 1
    assert paused(client, campaign).startswith("stopped by Ada")
    assert client.drives()["connected"]


def test_a_service_that_does_not_run_at_all_is_no_hindrance(
    service: Service, machine: VirtualMachine, client: ServiceClient, ear: Ear
) -> None:
    url = stop_url(service)
    campaign = moving(client, machine, "host_streamed")
    with suspended(service):
        ear.forget()
        answer = press(url, by="Ada", why="smoke")
        assert (answer.status_code, set(answer.json()["confirmed"])) == (200, JOINTS), answer.text
        until(lambda: ear.quick_stops() == set(NODES), "the quick stop is on the bus")
        until(lambda: ear.nmt_stops() == set(NODES), "nobody took the stop over: the drives are made deaf")
        until(machine.stands, "the axes stand")
    assert paused(client, campaign).startswith("stopped by Ada: smoke")
    until(lambda: [stop["id"] > 0 for stop in client.stops()] == [True], "latched in the database")
    (stop,) = client.stops()
    assert (stop["by"], stop["why"]) == ("Ada", "smoke")


def test_on_modbus_it_writes_the_registers_by_a_connection_of_its_own(tmp_path: Path) -> None:
    with (
        virtual_machine(tmp_path, 4.0, Fieldbus.MODBUS_TCP) as machine,
        serving(tmp_path, machine.profile, SHORT_LEASE) as service,
        ServiceClient(service.url) as client,
    ):
        url = stop_url(service)
        moving(client, machine)
        with suspended(service):
            answer = press(url, by="Ada", press="1")
            assert (answer.status_code, set(answer.json()["confirmed"])) == (200, JOINTS), answer.text
            assert machine.stands()
        until(lambda: [stop["by"] for stop in client.stops()] == ["Ada"], "latched")


def test_after_a_gap_nothing_moves_until_a_person_resumes(
    service: Service, machine: VirtualMachine, client: ServiceClient, ear: Ear
) -> None:
    campaign = moving(client, machine, "host_streamed")
    with suspended(service):
        since = time.monotonic()
        until(machine.stands, "the drives miss their host")
        until(lambda: time.monotonic() > since + GAP, "and it comes late")
    cause = paused(client, campaign)
    until(lambda: [stop["id"] > 0 for stop in client.stops()] == [True], "latched")
    keeps_standing(machine, ear)
    (stop,) = client.stops()
    assert "the host was suspended for" in stop["why"]
    assert "resume" in stop["why"]
    assert stop["why"] in cause
    assert client.ready()["causes"][-1].endswith(stop["why"])
    assert client.drives()["held"].endswith(stop["why"])
    released(client)
    client.resume(campaign, repeat=True)
    until(lambda: client.campaign(campaign)["state"] == "completed", "a person has resumed it")


def test_a_word_of_another_host_stops_what_moves(machine: VirtualMachine, client: ServiceClient, ear: Ear) -> None:
    """Which words: `tests/unit/drivers/test_foreign_frames.py`."""
    campaign = moving(client, machine, "host_streamed")
    ear.say(frames.Cob.SYNC)
    until(lambda: [stop["id"] > 0 for stop in client.stops()] == [True], "latched")
    (stop,) = client.stops()
    assert stop["by"] == "host watch"
    assert stop["why"].startswith("another host is on the bus: SYNC (COB-ID 080h); ")
    assert "SYNC (COB-ID 080h)" in paused(client, campaign)
    until(machine.stands, "the axes stand")
    keeps_standing(machine, ear)


def test_a_stop_process_that_ends_is_started_anew_at_its_port(service: Service, client: ServiceClient) -> None:
    url = stop_url(service)
    stop_process(service).kill()
    until(lambda: any("stop process" in cause for cause in client.ready()["causes"]), "it is missed")
    until(lambda: client.ready()["ready"], "it is there again")
    assert stop_url(service) == url
    assert press(url).status_code == 200


def test_a_missed_sign_of_life_is_standstill(service: Service, machine: VirtualMachine, client: ServiceClient) -> None:
    campaign = added(client)
    client.start(campaign, attended=3600)
    assert (client.sign_of_life(campaign) or {})["within_s"] == 3600
    client.abort(campaign, "now with the shortest patience")
    campaign = added(client)
    client.start(campaign, attended=SIGN_OF_LIFE)
    cause = paused(client, campaign)
    assert cause.startswith("no sign of life within 1 s")
    until(machine.stands, "the axes stand")
    assert (client.campaign(campaign)["attended"], client.stops()) == (None, [])
    with pytest.raises(ServiceProblem, match="is not running"):
        client.sign_of_life(campaign)
    until(lambda: told(service) == (f"campaign {campaign}", cause), "it is in the audit")


@pytest.mark.parametrize(
    ("name", "why"), [("SIGINT", "Ctrl-C"), ("SIGTERM", "SIGTERM"), ("SIGHUP", "the terminal was lost")]
)
def test_measure_told_to_end_stops_the_machine(
    service: Service, machine: VirtualMachine, client: ServiceClient, name: str, why: str
) -> None:
    plan = add_plan(client, axes=[AXIS], poses=1, modes="drive_side")
    environment = os.environ | {"SWEEPID_URL": service.url}
    command = [sys.executable, "-c", INTERRUPTIBLE, "measure", str(plan)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment) as measuring:
        until(lambda: any(axis["velocity"] != 0 for axis in machine.axes().values()), "it moves")
        measuring.send_signal(signal.Signals[name])
        out, words = measuring.communicate(timeout=PATIENCE)
    assert b"machine stopped" in words.splitlines()[-1]
    assert (measuring.returncode, out) == (1, b"")
    until(machine.stands, "the axes stand")
    stopped = [f"stopped by sweepid measure: {why}"]
    until(lambda: client.ready()["causes"] == stopped, "it is held by that stop alone")  # the campaign's end is stored


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
def test_told_to_end_the_machine_comes_before_open_requests(
    service: Service, machine: VirtualMachine, client: ServiceClient, ear: Ear, name: str
) -> None:
    stop_url(service)
    campaign = moving(client, machine)
    address = urlsplit(service.url)
    with socket.create_connection((address.hostname, address.port), timeout=PATIENCE) as open_request:
        open_request.sendall(
            b"POST /api/v1/plans HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
            b"Content-Length: 10\r\n\r\n{"
        )
        ear.forget()
        service_process(service).send_signal(signal.Signals[name])
        until(lambda: ear.quick_stops() == set(NODES), "the quick stop is on the bus")
        until(machine.stands, "the axes stand")
        with suppress(ConnectionResetError):
            open_request.recv(1)  # let go only when the service gives up waiting for it
    assert service.end() == 0, service.log()
    why = f"the service ended by {name} while campaign {campaign} was in progress"
    assert told(service) == ("end of the service", why)


def test_the_death_of_the_service_is_a_stop(
    service: Service, machine: VirtualMachine, client: ServiceClient, ear: Ear
) -> None:
    """SIGKILL in a sweep: the axis stands, the samples so far are there, nothing moves until a person says so."""
    stop_url(service)
    beside = stop_process(service)
    campaign = added(client, "host_streamed")
    live = f"{service.url.replace('http', 'ws')}/api/v1/campaigns/{campaign}/live"
    with connect(live, max_size=None, proxy=None) as samples:
        client.start(campaign)
        _read(samples.recv, 20)
        ear.forget()
        service_process(service).kill()
    until(lambda: ear.quick_stops() == set(NODES), "the quick stop is on the bus")
    beside.wait(PATIENCE)
    until(machine.stands, "the axes stand")
    before = machine.axes()
    service.end()

    service.start()
    with ServiceClient(service.url) as anew:
        held = anew.campaign(campaign)
        assert (held["state"], held["cause"]) == ("paused", "the service was restarted")
        assert held["progress"]["done"] == 0
        (sweep,) = anew.sweeps(campaign)
        assert (sweep["state"], sweep["attempt"]) == ("interrupted", 1)
        with httpx.Client(base_url=f"{service.url}/api/v1/campaigns/{campaign}", timeout=60, trust_env=False) as http:
            recording = http.get("/sweeps/1/recording").json()
            file = http.get("/sweeps/1/recording/file")
        assert recording["state"] == file.headers["x-recording-state"] == "partial"
        assert pq.read_table(io.BytesIO(file.content)).num_rows == recording["samples"] > 0
        assert told(service) == (f"campaign {campaign}", "the previous service process ended without a shutdown")
        assert machine.stands()
        assert _positions(machine.axes()) == _positions(before)

        released(anew)  # the drive that lost its host waits for a person, too
        anew.resume(campaign, repeat=True)
        until(lambda: anew.sweeps(campaign)[0]["attempt"] == 2, "the sweep is measured again")
        anew.abort(campaign, "enough seen")
        until(machine.stands, "the axes stand")


def _read(receive: Callable[..., str | bytes], rows: int) -> None:
    """So many live samples of joint_1."""
    while rows > 0:
        message = receive(timeout=PATIENCE)
        assert isinstance(message, bytes)
        (batch,) = pa.ipc.open_stream(message)
        assert batch.schema.names == ["time", "effort", "velocity", "position"]
        assert batch.schema.metadata[b"joint"] == AXIS.encode()
        rows -= batch.num_rows


def _positions(axes: dict[str, dict[str, Any]]) -> dict[str, float]:
    return {joint: axis["position"] for joint, axis in axes.items()}
