"""A real database of each kind, a store on it, and a robot."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from service.model import Robot, SweepSpec
from service.model.configuration import read_robot
from service.store.database import Database, open_database
from service.store.store import Store
from tests.postgresql_server import PostgresqlServer, running_server

ROBOT = Path(__file__).parents[4] / "config" / "robots" / "max100-class.yaml"


@pytest.fixture(scope="session")
def postgresql() -> Iterator[PostgresqlServer]:
    """A real server, for tests that leave it running; each takes a `new_database`.

    `PGPASSFILE` leads to its password, here and in the processes that tests start.
    """
    with running_server(durable=False) as server, pytest.MonkeyPatch.context() as environment:
        environment.setenv("PGPASSFILE", str(server.passfile))
        yield server


@pytest.fixture
def sqlite_url(tmp_path: Path) -> str:
    return f"sqlite:///{tmp_path / 'sweepid.sqlite'}"


@pytest.fixture
def postgresql_url(postgresql: PostgresqlServer) -> str:
    """Of an empty database."""
    return postgresql.new_database()


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest) -> str:
    return str(request.getfixturevalue(f"{request.param}_url"))


@pytest.fixture
def database(url: str) -> Iterator[Database]:
    with open_database(url) as database:
        yield database


@pytest.fixture
def store(database: Database) -> Store:
    return Store(database)


@pytest.fixture(scope="session")
def robot() -> Robot:
    return read_robot(ROBOT)


Specs = tuple[SweepSpec, ...]


@pytest.fixture
def specs() -> Specs:
    return tuple(
        SweepSpec(id=f"{n:04d}", axis="joint_1", pose=(0.0,) * 6, offset_velocity=0.01, sample_rate=1000.0)
        for n in (1, 2, 3)
    )


def must_not_wait(_: float) -> None:
    pytest.fail("waited for a lease that is free")
