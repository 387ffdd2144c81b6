"""A service that asks who it is, with a key of each role."""

import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.store.access import Role
from service.store.database import Database, open_database
from service.store.people.audit import AuditStore
from service.store.people.users import KeyStore
from tests.unit.service.api.conftest import profile
from tests.unit.service.hosting import HERE, From, hosting

__all__ = ["profile"]  # of a machine that does not answer


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("people")


@pytest.fixture(scope="module")
def url(folder: Path, profile: Path) -> Iterator[str]:
    with hosting(folder, profile, login=True, wrong_keys=1000) as url:
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
def calling(url: str, key: str | None, address: str = HERE) -> Iterator[httpx.Client]:
    """`address`: of this computer, from which it calls."""
    headers = None if key is None else {"Authorization": f"Bearer {key}"}
    with httpx.Client(base_url=url, headers=headers, timeout=60, trust_env=False, transport=From(address)) as client:
        yield client


Since = Callable[[], list[dict[str, Any]]]


@pytest.fixture
def since(database: Database) -> Since:
    """What the audit has since the test began; stops of earlier tests are written by then."""
    store = AuditStore(database)
    before = len(store.documents(0, 100000))
    return lambda: [dict(one.entry) for one in store.documents(before, 100000)]


def stored_in(folder: Path) -> bytes:
    """What a service has in its database and its log."""
    stored = b"".join(path.read_bytes() for path in (folder / "data").glob("sweepid.sqlite*"))
    return stored + (folder / "service.log").read_bytes()


def certificate(folder: Path, name: str, *options: str) -> tuple[Path, Path]:
    """A self-signed one for this computer, and its key."""
    pem, key = folder / f"{name}.pem", folder / f"{name}.key"
    new = ["-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-days", "2", "-subj", "/CN=cell7"]
    new += ["-addext", "subjectAltName=IP:127.0.0.1,DNS:localhost", *(options or ("-nodes",))]
    files = ["-out", str(pem), "-keyout", str(key)]
    subprocess.run(["openssl", "req", "-x509", *new, *files], check=True, capture_output=True)
    return pem, key
