"""The operator of `sweepid demo`: continues after this computer was suspended, but not after a stop by a person."""

from collections.abc import Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import psutil
import pytest
import yaml

from service.client import ServiceClient
from service.demo.operator import CampaignFailed, Operator
from tests.system.rest_bench import Service, VirtualMachine, add_plan, serving, until, virtual_machine

HOST_TIMEOUT = 1.0  # s, of the profile
SUSPENDED = 3.0  # s


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(tmp_path, 4.0) as machine:
        profile = yaml.safe_load(machine.profile.read_text("utf-8"))
        profile["bus"] |= {"host_timeout": HOST_TIMEOUT, "silence": 0.5}
        machine.profile.write_text(yaml.safe_dump(profile), "utf-8")
        yield machine


@pytest.fixture
def service(tmp_path: Path, machine: VirtualMachine) -> Iterator[Service]:
    with serving(tmp_path, machine.profile) as service:
        yield service


def operated(service: Service, campaign: int, notes: list[str]) -> None:
    with ServiceClient(service.url) as client:
        Operator(client, progress=lambda _: None, say=notes.append).run(campaign)


@contextmanager
def moving(
    service: Service, machine: VirtualMachine, client: ServiceClient, notes: list[str]
) -> Generator[tuple[int, Future[None]]]:
    """A campaign under way, and the run of its operator, which ends within."""
    campaign = int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=1))["id"])
    with ThreadPoolExecutor(1) as operator:
        run = operator.submit(operated, service, campaign, notes)
        until(lambda: any(axis["velocity"] != 0 for axis in machine.axes().values()), "it moves")
        yield campaign, run


def test_a_suspended_computer_is_released_and_the_campaign_ends(service: Service, machine: VirtualMachine) -> None:
    notes: list[str] = []
    with ServiceClient(service.url) as client, moving(service, machine, client, notes) as (campaign, run):
        process = psutil.Process(service.running().pid)
        process.suspend()
        with pytest.raises(psutil.TimeoutExpired):
            process.wait(SUSPENDED)
        process.resume()
        run.result()
        assert client.campaign(campaign)["state"] == "completed"
        assert client.stops() == []
    assert any("the host was suspended for" in note for note in notes), notes


def test_a_stop_by_a_person_is_not_released(service: Service, machine: VirtualMachine) -> None:
    with ServiceClient(service.url) as client, moving(service, machine, client, []) as (_, run):
        client.stop("Ada", "a noise")
        with pytest.raises(CampaignFailed, match=r"cannot go on: .*stopped by Ada: a noise"):
            run.result()
        assert "Ada" in [stop["by"] for stop in client.stops()]
        assert machine.stands()
