"""A service that asks who it is, with a key of each role."""

import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path

import httpx
import pytest

from service.people.permissions import Role
from service.store.database import Database, open_database
from service.store.people.keys import KeyStore
from tests.unit.service.api.conftest import CONFIG, serving

Calling = Callable[[str], httpx.Client]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("people")


@pytest.fixture(scope="module")
def profile(folder: Path) -> Path:
    """The virtual machine's profile with a port at which nobody listens."""
    text = (CONFIG / "drives" / "virtual-max100.yaml").read_text(encoding="utf-8")
    path = folder / "nobody.yaml"
    eds = CONFIG / "eds" / "virtual-axis.eds"
    path.write_text(text.replace("port: 29536", "port: 1").replace("../eds/virtual-axis.eds", str(eds)), "utf-8")
    return path


@pytest.fixture(scope="module")
def url(folder: Path, profile: Path) -> Iterator[str]:
    with serving(folder, profile, login=True, wrong_keys=1000) as url:
        yield url


@pytest.fixture(scope="module")
def database(folder: Path, url: str) -> Iterator[Database]:
    """The running service's."""
    with open_database(f"sqlite:///{folder / 'data' / 'sweepid.sqlite'}") as database:
        yield database


@pytest.fixture(scope="module")
def keys(database: Database) -> dict[str, str]:
    """By the word of each role, and `expired` and `revoked` ones of admins."""
    store, who, days = KeyStore(database), {"actor": "test"}, timedelta(days=1)
    found = {role.word: store.add(f"the-{role.word}", role, days, who)[1] for role in Role}
    found["expired"] = store.add("too-late", Role.ADMIN, timedelta(), who)[1]
    found["revoked"] = store.add("no-more", Role.ADMIN, days, who)[1]
    store.revoke("no-more", who)
    return found


@contextmanager
def calling(url: str, key: str | None, address: str | None = None) -> Iterator[httpx.Client]:
    """`address`: of this computer, from which it calls."""
    headers = None if key is None else {"Authorization": f"Bearer {key}"}
    way = httpx.HTTPTransport(local_address=address)
    with httpx.Client(base_url=url, headers=headers, timeout=30, trust_env=False, transport=way) as client:
        yield client


def certificate(folder: Path, name: str, *options: str) -> tuple[Path, Path]:
    """A self-signed one for this computer, and its key."""
    pem, key = folder / f"{name}.pem", folder / f"{name}.key"
    words = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-days", "2", "-subj", "/CN=cell7"]
    names = ["-addext", "subjectAltName=IP:127.0.0.1,DNS:localhost"]
    command = [
        "openssl",
        "req",
        "-x509",
        *words,
        *names,
        *(options or ("-nodes",)),
        "-out",
        str(pem),
        "-keyout",
        str(key),
    ]
    subprocess.run(command, check=True, capture_output=True)
    return pem, key
