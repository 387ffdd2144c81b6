"""Someone on the network, without a key or with a viewer's, attacks a service that measures.

Every attack is refused and is in the audit where it named a command; the sweeps under way do not notice.
"""

import socket
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from datetime import timedelta
from pathlib import Path
from urllib.parse import urlsplit

import httpx
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from service.store.access import Role, new_key
from service.store.database import open_database
from service.store.people.audit import AuditStore, verify
from service.store.people.users import KeyStore
from service.web.client import ServiceClient
from tests.system.rest_bench import Service, add_plan, serving, until, virtual_machine
from tests.system.test_stop import stop_url

ATTACKER = "127.0.0.2"
COMMANDS = ("start", "pause", "resume", "abort")
IDLE = 200  # connections that send nothing, to the service and to the stop process
ROUNDS = 3  # of all attacks, at least
SPEED = 4.0

Attack = Callable[[httpx.Client, int], Iterator[int]]
"""What the attacker does to a campaign; yields the status of each answer."""


def without_a_key(http: httpx.Client, campaign: int) -> Iterator[int]:
    for command in COMMANDS:
        yield http.post(f"/api/v1/campaigns/{campaign}/{command}").status_code
    yield http.post("/api/v1/connect").status_code
    yield http.post("/api/v1/stop/reset", json={"by": "Ada", "stops": [1]}).status_code


def with_guessed_keys(http: httpx.Client, campaign: int) -> Iterator[int]:
    for _ in range(15):
        headers = {"Authorization": f"Bearer {new_key()}"}
        yield http.post(f"/api/v1/campaigns/{campaign}/abort", headers=headers).status_code


def with_guessed_passwords(http: httpx.Client, campaign: int) -> Iterator[int]:
    for password in ("admin", "sinumerik", "SUNRISE", "12345678"):
        yield http.post("/api/v1/login", json={"name": "admin", "password": password}).status_code


def with_a_forged_session(http: httpx.Client, campaign: int) -> Iterator[int]:
    for name in ("sweepid-session", "session", "__Host-sweepid-session"):
        headers = {"Cookie": f"{name}={new_key()}"}
        yield http.post(f"/api/v1/campaigns/{campaign}/abort", headers=headers).status_code


def from_a_foreign_page(http: httpx.Client, campaign: int) -> Iterator[int]:
    for header, value in (("Origin", "http://evil.example"), ("Host", "evil.example")):
        yield http.post(f"/api/v1/campaigns/{campaign}/abort", headers={header: value}).status_code


def out_of_the_folder(http: httpx.Client, campaign: int) -> Iterator[int]:
    for path in ("/../../etc/passwd", "/assets/..%2f..%2f..%2fetc%2fpasswd", "/api/v1/..%2f..%2fsweepid.sqlite"):
        yield http.get(path).status_code


def with_large_bodies(http: httpx.Client, campaign: int) -> Iterator[int]:
    yield http.post("/api/v1/plans", content=b"[" * 2**22).status_code
    yield http.post("/api/v1/campaigns", content=b'{"plan_id":' + b"[" * 200_000).status_code


ATTACKS: tuple[Attack, ...] = (
    without_a_key,
    with_guessed_passwords,
    with_a_forged_session,
    from_a_foreign_page,
    out_of_the_folder,
    with_large_bodies,
    with_guessed_keys,  # last: from then on the address has to wait
)


def live(url: str, campaign: int) -> int:
    """Status with which a stranger's socket is refused."""
    try:
        with connect(f"ws{url.removeprefix('http')}/api/v1/campaigns/{campaign}/live", proxy=None):
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code


def first_line(url: str, request: bytes) -> bytes:
    """What a server answers to bytes that no client would send; empty: it hung up."""
    place = (urlsplit(url).hostname, urlsplit(url).port)
    with suppress(ConnectionError), socket.create_connection(place, 10, (ATTACKER, 0)) as connection:
        connection.sendall(request)
        return connection.recv(200).partition(b"\r\n")[0]
    return b""


def malformed(campaign: int) -> Iterator[bytes]:
    abort = f"POST /api/v1/campaigns/{campaign}/abort HTTP/1.1\r\nHost: 127.0.0.1\r\n".encode()
    yield abort + b"Content-Length: 4\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\nPOST"
    yield abort + b"Content-Length: 4\r\nContent-Length: 40\r\n\r\nabcd"
    yield abort + b"X: " + b"a" * 2**20 + b"\r\n\r\n"
    yield b"\x16\x03\x01\x02\x00\x01\x00" + b"\x00" * 200  # a TLS handshake where none is spoken
    yield bytes(range(256)) * 16


@contextmanager
def idle_connections(*urls: str) -> Iterator[None]:
    with ExitStack() as stack:
        for url in urls:
            for _ in range(IDLE):
                place = (urlsplit(url).hostname, urlsplit(url).port)
                connection = stack.enter_context(socket.create_connection(place, 10, (ATTACKER, 0)))
                connection.sendall(b"GET /api/v1/ro")  # and never more
        yield


def attacked(service: Service, campaign: int, viewer: str, over: threading.Event) -> Counter[int]:
    """How often which status was answered, until `over` and for `ROUNDS` at least."""
    answers: Counter[int] = Counter()
    way = httpx.HTTPTransport(local_address=ATTACKER)
    rounds = 0
    with (
        httpx.Client(base_url=service.url, timeout=60, trust_env=False, transport=way) as http,
        idle_connections(service.url, stop_url(service)),
    ):
        while rounds < ROUNDS or not over.is_set():
            rounds += 1
            for command in COMMANDS:  # who may look may not command
                headers = {"Authorization": f"Bearer {viewer}"}
                status = http.post(f"/api/v1/campaigns/{campaign}/{command}", headers=headers).status_code
                answers[status] += 1
            for attack in ATTACKS:
                answers.update(attack(http, campaign))
            answers[live(service.url, campaign)] += 1
            for request in malformed(campaign):
                for url in (service.url, stop_url(service)):
                    line = first_line(url, request)
                    answers[int(line.split()[1]) if line.startswith(b"HTTP/1.1 ") else 400] += 1
    return answers


def test_an_attack_from_outside_is_refused_and_the_sweeps_do_not_notice(tmp_path: Path) -> None:
    with (
        virtual_machine(tmp_path, SPEED) as machine,
        serving(tmp_path, machine.profile, login=True) as service,
        open_database(f"sqlite:///{service.data / 'sweepid.sqlite'}") as database,
    ):
        day = timedelta(days=1)
        keys = {
            role: KeyStore(database).add(f"the-{role.word}", role, day, {"actor": "test"})[1]
            for role in (Role.VIEWER, Role.ENGINEER)
        }
        over, found = threading.Event(), Counter[int]()
        with ServiceClient(service.url, keys[Role.ENGINEER]) as client:
            campaign = int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=3, modes="drive_side"))["id"])
            client.start(campaign)
            until(lambda: any(axis["velocity"] != 0 for axis in machine.axes().values()), "it moves")
            attacker = threading.Thread(
                target=lambda: found.update(attacked(service, campaign, keys[Role.VIEWER], over)), name="attacker"
            )
            attacker.start()
            try:
                until(lambda: client.campaign(campaign)["state"] != "running", "the sweeps have ended")
                until(lambda: client.campaign(campaign)["state"] in ("completed", "paused"), "and are identified")
            finally:
                over.set()
                attacker.join()
            told = client.campaign(campaign)
            assert (told["state"], told["progress"]["done"]) == ("completed", 3), told
            sweeps = client.sweeps(campaign)
            assert client.stops() == []
        assert [sweep["state"] for sweep in sweeps] == ["identified"] * 3
        assert [sweep["attempt"] for sweep in sweeps] == [1] * 3
        assert machine.stands()

        assert found
        assert not {status for status in found if status < 400 or status >= 500}, found
        store = AuditStore(database)
        verify(store.links())
        entries = [one.entry for one in store.documents(limit=10000)]
    attempts = [one for one in entries if one.get("address") == ATTACKER]
    refused = Counter(int(str(one["status"])) for one in attempts if one["event"] == "outcome")
    assert refused.keys() == {401, 403, 413, 429}, refused
    assert not [one for one in attempts if one["event"] != "outcome"]  # nothing of theirs was begun
    assert "the-viewer" in {str(one["actor"]) for one in attempts}
