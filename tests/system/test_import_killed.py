"""SIGKILL of the service while it identifies an imported campaign whose sweeps share revisions."""

from pathlib import Path
from shutil import make_archive

import pytest

from service.client import Json, ServiceClient
from service.configuration import read_robot
from service.store.files.bundle import write_bundle
from tests.rigid_sweep import rigid_bundle
from tests.system.rest_bench import ROBOT, SHORT_LEASE, Service, serving, until, virtual_machine

SWEEPS, REVISIONS = 90, 45
KILLED_AFTER = (5, 20, 35)  # revisions


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("import")
    bundle = rigid_bundle(read_robot(ROBOT), SWEEPS)
    write_bundle(folder / "bundle", bundle.robot, bundle.sweeps)
    return Path(make_archive(str(folder / "bundle"), "zip", folder / "bundle"))


def test_three_kills_lose_no_sweep_and_double_none(tmp_path: Path, archive: Path) -> None:
    with virtual_machine(tmp_path) as machine, serving(tmp_path, machine.profile, SHORT_LEASE) as service:
        with ServiceClient(service.url) as client:
            killed = int(client.import_bundle(archive)["id"])
        for revisions in KILLED_AFTER:
            _wait_for(revisions, service, killed)
            service.kill()
            service.start()
        expected = _result(service, killed)
        with ServiceClient(service.url) as client:
            undisturbed = int(client.import_bundle(archive)["id"])
        assert _result(service, undisturbed) == expected
    states, revisions, _ = expected
    assert states == ["identified"] * SWEEPS
    assert revisions == [(n, 2 * n) for n in range(1, REVISIONS + 1)]


def _wait_for(revisions: int, service: Service, campaign: int) -> None:
    with ServiceClient(service.url) as client:
        until(lambda: len(client.estimates(campaign)) >= revisions, f"{revisions} revisions")


def _result(service: Service, campaign: int) -> tuple[list[str], list[tuple[int, int]], list[Json]]:
    """Once it is complete: states of the sweeps, revisions with their sweeps, and what the revisions say."""
    with ServiceClient(service.url) as client:
        until(lambda: client.campaign(campaign)["state"] == "completed", "everything is identified")
        estimates = client.estimates(campaign)
        states = [str(sweep["state"]) for sweep in client.sweeps(campaign)]
    return states, [(one["revision"], one["number"]) for one in estimates], [one["document"] for one in estimates]
