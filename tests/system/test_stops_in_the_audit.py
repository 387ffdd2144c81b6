"""What stops moving axes and latches nothing is in the audit with its cause, also where the database was not there."""

import signal
import sqlite3
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import psutil
import pytest
import yaml

from service.client import ServiceClient
from service.people.audit_chain import verify
from service.store.database import open_database
from service.store.people.audit import AuditStore
from tests.system.rest_bench import (
    PATIENT_LEASE,
    Service,
    VirtualMachine,
    add_plan,
    serving,
    until,
    virtual_machine,
)

LEASE_TIME = 12.0  # s: the machine stands after half of it without a renewal
MISSED_CYCLES = 20  # of 8 ms: far fewer than a suspension of `SUSPENDED` brings
SUSPENDED = 0.5  # s, shorter than the drives wait for their host


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(tmp_path, 4.0) as machine:
        profile = yaml.safe_load(machine.profile.read_text("utf-8"))
        profile["bus"]["missed_cycles"] = MISSED_CYCLES
        machine.profile.write_text(yaml.safe_dump(profile), "utf-8")
        yield machine


@pytest.fixture
def lease_time() -> float:
    return LEASE_TIME


@pytest.fixture
def service(tmp_path: Path, machine: VirtualMachine, lease_time: float) -> Iterator[Service]:
    with serving(tmp_path, machine.profile, lease_time) as service:
        yield service


def moving(client: ServiceClient, machine: VirtualMachine, modes: str = "drive_side") -> int:
    campaign = int(client.add_campaign(add_plan(client, axes=["joint_1"], poses=1, modes=modes))["id"])
    client.start(campaign)
    until(lambda: any(axis["velocity"] != 0 for axis in machine.axes().values()), "it moves")
    return campaign


def stops(service: Service) -> list[dict[str, Any]]:
    """Entries of stops that the service tells of itself; the chain holds."""
    with open_database(f"sqlite:///{service.data / 'sweepid.sqlite'}") as database:
        store = AuditStore(database)
        verify(store.links())
        return [one.entry for one in store.documents(limit=1000) if one.entry["event"] == "stop"]


def locked(service: Service) -> sqlite3.Connection:
    connection = sqlite3.connect(service.data / "sweepid.sqlite", timeout=30, isolation_level=None)
    connection.execute("BEGIN IMMEDIATE")
    return connection


def test_the_end_of_the_service(service: Service, machine: VirtualMachine) -> None:
    with ServiceClient(service.url) as client:
        campaign = moving(client, machine)
    service.running().send_signal(signal.SIGTERM)
    assert service.end() == 0
    assert machine.stands()
    found = stops(service)
    assert len(found) == 1, found
    (entry,) = found
    assert (entry["way"], entry["actor"]) == ("end of the service", "end of the service")
    assert entry["why"] == f"the service ended by SIGTERM while campaign {campaign} was in progress"


def test_the_end_of_a_service_that_moves_nothing_is_no_stop(service: Service) -> None:
    service.running().send_signal(signal.SIGTERM)
    assert service.end() == 0
    assert stops(service) == []


def test_a_service_that_was_killed_is_told_by_the_next(service: Service, machine: VirtualMachine) -> None:
    with ServiceClient(service.url) as client:
        campaign = moving(client, machine)
    service.kill()
    service.start()
    (entry,) = stops(service)
    assert (entry["way"], entry["why"]) == (
        f"campaign {campaign}",
        "the previous service process ended without a shutdown",
    )


def test_a_lease_that_the_locked_database_does_not_renew(service: Service, machine: VirtualMachine) -> None:
    with ServiceClient(service.url) as client:
        campaign = moving(client, machine)
        with closing(locked(service)):
            until(machine.stands, "the axes stand")
            until(lambda: "lease" in client.drives()["held"], "and it says why")
        until(lambda: client.campaign(campaign)["state"] == "paused", "paused")
        until(lambda: stops(service), "written as soon as the database takes it")
    (entry,) = stops(service)
    assert entry["way"] == "lease"
    assert "the machine's lease could not be renewed: " in str(entry["why"])
    assert str(entry["happened"]) <= str(entry["at"])


def test_a_lease_that_another_has_taken(service: Service, machine: VirtualMachine) -> None:
    with ServiceClient(service.url) as client:
        moving(client, machine)
        with ExitStack() as stack:
            other = stack.enter_context(closing(locked(service)))
            other.execute("UPDATE lease SET owner = 'another'")
            other.execute("COMMIT")
        until(machine.stands, "the axes stand")
        until(lambda: stops(service), "it is told")
    (entry,) = stops(service)
    assert (entry["way"], entry["why"]) == ("lease", "another service has taken the machine; restart this service")


@pytest.mark.parametrize("lease_time", [PATIENT_LEASE])  # a stall of the disk is not what is to be seen here
def test_set_points_that_came_too_late(service: Service, machine: VirtualMachine) -> None:
    with ServiceClient(service.url) as client:
        plan = add_plan(client, axes=["joint_1"], poses=4, modes="host_streamed")
        campaign = int(client.add_campaign(plan)["id"])
        client.start(campaign)

        def sweeps() -> bool:
            axis = machine.axes()["joint_1"]
            return bool(axis["mode"] == 9 and axis["velocity"] != 0)

        def state() -> str:
            return str(client.campaign(campaign)["state"])

        # a suspension may fall on the end of a sweep, where no set-point is missed: then the next
        while state() == "running":
            until(lambda: sweeps() or state() != "running", "a sweep is under way, or the campaign has ended")
            process = psutil.Process(service.running().pid)
            process.suspend()
            with pytest.raises(psutil.TimeoutExpired):
                process.wait(SUSPENDED)
            process.resume()
            until(lambda: not sweeps(), "the sweep has ended, whole or not")
        assert state() == "paused", "no suspension fell into a sweep"
        until(lambda: stops(service), "it is told")
        cause = client.campaign(campaign)["cause"]
        assert client.stops() == []  # nothing is latched
    (entry,) = stops(service)
    assert (entry["way"], entry["why"]) == (f"campaign {campaign}", cause)
    assert "deadlines of 8 ms were missed" in cause
