"""The service by TLS, with a certificate of its own that OpenSSL made; and pages of other origins."""

import re
import socket
import ssl
from collections.abc import Iterator
from datetime import timedelta
from functools import partial
from pathlib import Path

import httpx
import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from service import BadInput
from service.process.settings import Settings
from service.store.access import Role
from service.store.database import open_database
from service.store.people.users import KeyStore, UserStore
from service.web.client import ServiceClient, ServiceUnreachable
from tests.programs import needs
from tests.system.rest_bench import until
from tests.unit.service.api.conftest import serving
from tests.unit.service.people.conftest import certificate, stored_in

pytestmark = [pytest.mark.slow, needs("openssl")]

PASSWORD = "a horse and a battery"
LINE = "https://line.example"


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    return certificate(tmp_path_factory.mktemp("tls"), "cell7")


@pytest.fixture(scope="module")
def trusting(pair: tuple[Path, Path]) -> ssl.SSLContext:
    return ssl.create_default_context(cafile=str(pair[0]))


@pytest.fixture(scope="module")
def secure(folder: Path, profile: Path, pair: tuple[Path, Path]) -> Iterator[str]:
    pem, key = (str(path) for path in pair)
    with serving(folder, profile, login=True, tls_certificate=pem, tls_key=key, cors_origins=[LINE]) as url:
        with open_database(f"sqlite:///{folder / 'data' / 'sweepid.sqlite'}") as database:
            UserStore(database).add("anna", Role.OPERATOR, PASSWORD, {"actor": "test"})
        yield url
    stored = stored_in(folder)
    assert PASSWORD.encode() not in stored
    assert not re.search(rb"sweepid-[0-9a-f]{64}", stored)  # no key, no session


@pytest.fixture
def http(secure: str, trusting: ssl.SSLContext) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=secure, verify=trusting, timeout=30, trust_env=False) as client:
        yield client


def test_a_login_by_tls(secure: str, http: httpx.Client, trusting: ssl.SSLContext) -> None:
    assert secure.startswith("https://")
    logged_in = http.post("/api/v1/login", json={"name": "anna", "password": PASSWORD})
    assert logged_in.status_code == 200
    assert "secure" in logged_in.headers["set-cookie"].lower().replace(" ", "").split(";")
    assert logged_in.headers["strict-transport-security"] == "max-age=31536000"
    assert http.get("/api/v1/me").json()["name"] == "anna"
    assert http.post("/api/v1/logout", headers={"Origin": secure}).status_code == 200
    with (
        pytest.raises(InvalidStatus),
        connect(f"wss{secure.removeprefix('https')}/api/v1/campaigns/1/live", ssl=trusting, proxy=None),
    ):
        pass


def test_without_tls_nobody_is_answered(secure: str) -> None:
    with pytest.raises(httpx.TransportError):
        httpx.get(f"http{secure.removeprefix('https')}/api/v1/health/live", trust_env=False, timeout=30)
    with pytest.raises(httpx.ConnectError, match="CERTIFICATE_VERIFY_FAILED"):
        httpx.get(f"{secure}/api/v1/health/live", trust_env=False, timeout=30)


def test_the_client_trusts_what_it_is_told_to(
    secure: str, folder: Path, pair: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_database(f"sqlite:///{folder / 'data' / 'sweepid.sqlite'}") as database:
        key = KeyStore(database).add("client", Role.VIEWER, timedelta(days=1), {"actor": "test"})[1]
    with ServiceClient(secure, key) as client, pytest.raises(ServiceUnreachable):
        client.robots()
    monkeypatch.setenv("SSL_CERT_FILE", str(pair[0]))
    with ServiceClient(secure, key) as client:
        assert client.robots()


def test_the_stop_process_takes_both(http: httpx.Client, trusting: ssl.SSLContext) -> None:
    """A page that came by TLS may send to nothing else; and whoever has no TLS may stop as well."""
    port = http.get("/api/v1/stop").json()["port"]
    for scheme, by in (("https", "by TLS"), ("http", "without")):
        answer = httpx.post(
            f"{scheme}://127.0.0.1:{port}/stop", params={"by": by}, verify=trusting, timeout=30, trust_env=False
        )
        assert answer.json()["type"] == "urn:sweepid:problem:stop-not-confirmed"  # there is no machine
        until(partial(_stopped_by, http, by), f"a stop {by}")  # the service hears of it by a pipe
    for words in (b"\x16\x03\x01\x00\x05hello", b"\x16", b"\x15\x03", b""):  # what breaks off ends nothing
        with socket.create_connection(("127.0.0.1", port), timeout=30) as broken:
            broken.sendall(words)
    assert httpx.get(f"https://127.0.0.1:{port}/stop", verify=trusting, timeout=30, trust_env=False).status_code == 200


def _stopped_by(http: httpx.Client, by: str) -> bool:
    return by in [stop["by"] for stop in http.get("/api/v1/stop").json()["stops"]]


def test_a_page_of_an_origin_that_is_listed_calls_with_a_key(http: httpx.Client, folder: Path) -> None:
    asked = {"Origin": LINE, "Access-Control-Request-Method": "POST", "Access-Control-Request-Headers": "authorization"}
    allowed = http.options("/api/v1/campaigns", headers=asked)
    assert allowed.status_code == 200
    assert allowed.headers["access-control-allow-origin"] == LINE
    assert "access-control-allow-credentials" not in allowed.headers
    assert http.options("/api/v1/campaigns", headers={**asked, "Origin": "https://evil.example"}).status_code == 400
    with open_database(f"sqlite:///{folder / 'data' / 'sweepid.sqlite'}") as database:
        key = KeyStore(database).add("line", Role.OPERATOR, timedelta(days=1), {"actor": "test"})[1]
    called = {"Authorization": f"Bearer {key}"}
    start = "/api/v1/campaigns/987654/start"
    assert http.post(start, headers={**called, "Origin": LINE}).status_code == 404
    assert http.post(start, headers={**called, "Origin": "https://evil.example"}).status_code == 403
    http.post("/api/v1/login", json={"name": "anna", "password": PASSWORD})
    assert http.post(start, headers={"Origin": LINE}).status_code == 403  # not with a session of its browser


def test_files_that_do_not_fit_are_refused(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    pem, other = pair[0], certificate(tmp_path, "other")[1]
    locked = certificate(tmp_path, "locked", "-passout", "pass:secret")
    for tls_certificate, tls_key in ((pem, other), locked, (other, pem)):
        with pytest.raises(BadInput, match=r"^tls_certificate: .* cannot be used: "):
            Settings(tls_certificate=tls_certificate, tls_key=tls_key).check_tls()
    Settings(tls_certificate=pair[0], tls_key=pair[1]).check_tls()
