"""A host that was suspended for longer than its drives wait for it moves nothing until a person resumes."""

import random
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import psutil
import pytest
import yaml

from service.client import ServiceClient
from tests.system.bus_listener import Ear, listening
from tests.system.rest_bench import (
    PATIENCE,
    Service,
    VirtualMachine,
    add_plan,
    release,
    serving,
    until,
    virtual_machine,
)

HOST_TIMEOUT = 1.0  # s, of the profile
SUSPENDED = 3.0  # s
WATCHED = 2.0  # s after waking: before, an axis had energy again within 0.7 s
AXIS = "joint_1"

Phase = Callable[[dict[str, dict[str, object]]], bool]

PHASES: dict[str, Phase] = {
    "move": lambda axes: any(axis["mode"] == 1 and axis["velocity"] != 0 for axis in axes.values()),
    "settle": lambda axes: any(axis["energised"] and axis["velocity"] == 0 for axis in axes.values()),
    "sweep": lambda axes: axes[AXIS]["mode"] == 9 and axes[AXIS]["velocity"] != 0,
    "own sweep": lambda axes: axes[AXIS]["measuring"] == "running",
    "between": lambda axes: not any(axis["energised"] for axis in axes.values()),
}


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(tmp_path, 4.0) as machine:
        profile = yaml.safe_load(machine.profile.read_text("utf-8"))
        profile["bus"] |= {"host_timeout": HOST_TIMEOUT, "silence": 0.5}
        profile["maker_settings"][0]["value"] = 800  # ms that a drive waits for SYNC
        machine.profile.write_text(yaml.safe_dump(profile), "utf-8")
        yield machine


@pytest.mark.parametrize(
    ("modes", "phases"),
    [
        ("host_streamed", ("sweep", "between", "move", "settle", "sweep")),
        ("drive_side", ("own sweep", "between", "move")),
    ],
    ids=["host_streamed", "drive_side"],
)
def test_nothing_moves_after_a_gap_until_a_person_resumes(
    tmp_path: Path, machine: VirtualMachine, modes: str, phases: tuple[str, ...]
) -> None:
    with serving(tmp_path, machine.profile) as service, ServiceClient(service.url) as client, listening(machine) as ear:
        suspend_in_each(phases, modes, service, machine, client, ear)


def test_a_start_that_waits_for_the_first_connection_over_a_gap_moves_nothing(
    tmp_path: Path, machine: VirtualMachine
) -> None:
    machine.power_off()
    with serving(tmp_path, machine.profile) as service, ServiceClient(service.url) as client:
        campaign = int(client.add_campaign(add_plan(client, axes=[AXIS], poses=2))["id"])
        assert not client.drives()["connected"]
        machine.power_on()
        with ThreadPoolExecutor(1) as person, listening(machine) as ear:
            started = person.submit(
                httpx.post, f"{service.url}/api/v1/campaigns/{campaign}/start", timeout=PATIENCE, trust_env=False
            )
            until(lambda: client.drives()["trouble"] == "connecting", "the start waits for the drives")
            suspend(service, machine, ear)
            answer = started.result()
            assert answer.status_code == 409, answer.text
            until(lambda: [stop["id"] for stop in client.stops() if stop["id"] > 0], "latched")
            assert "the host was suspended for" in client.stops()[0]["why"]
            release(client)
            watched(machine, ear, "after the release")
        assert client.campaign(campaign)["state"] == "planned"
        if not client.drives()["connected"]:
            httpx.post(f"{service.url}/api/v1/drives/connect", timeout=PATIENCE, trust_env=False).raise_for_status()
        client.start(campaign)
        until(lambda: not machine.stands(), "it moves when a person says so again")
        client.abort(campaign, "enough seen")


def suspend_in_each(
    phases: Sequence[str],
    modes: str,
    service: Service,
    machine: VirtualMachine,
    client: ServiceClient,
    ear: Ear,
) -> None:
    """One campaign, suspended once in each of these and resumed by a person after each."""
    chance = random.Random(modes)
    plan = add_plan(client, axes=[AXIS, "joint_2"], step=30.0, poses=6, modes=modes)
    campaign = int(client.add_campaign(plan)["id"])
    client.start(campaign)
    for name in phases:
        until(lambda name=name: PHASES[name](machine.axes()), f"no {name}")
        time.sleep(chance.uniform(0.0, 0.3))  # any moment of it
        assert client.campaign(campaign)["state"] == "running"
        suspend(service, machine, ear)
        until(lambda: client.campaign(campaign)["state"] == "paused", f"{name}: the campaign is paused")
        until(lambda: [stop["id"] for stop in client.stops() if stop["id"] > 0], f"{name}: latched")
        watched(machine, ear, name)
        (stop,) = client.stops()
        assert "the host was suspended for" in stop["why"], name
        assert "resume" in stop["why"]
        assert stop["why"] in client.campaign(campaign)["cause"]
        assert client.ready()["causes"][-1].endswith(stop["why"])
        assert client.drives()["held"].endswith(stop["why"])
        a_person_resumes(service, client, campaign)
    client.abort(campaign, "enough seen")


def suspend(service: Service, machine: VirtualMachine, ear: Ear) -> None:
    """No thread of the service does anything until the drives have taken the energy, and for a while after that."""
    process = psutil.Process(service.running().pid)
    process.suspend()
    since = time.monotonic()
    until(machine.stands, "the drives miss their host")
    time.sleep(max(0.0, since + SUSPENDED - time.monotonic()))
    ear.forget()
    process.resume()


def watched(machine: VirtualMachine, ear: Ear, phase: str) -> None:
    """Nothing but what stops is said on the bus, and no axis has energy."""
    end = time.monotonic() + WATCHED
    while time.monotonic() < end:
        assert machine.stands(), phase
        time.sleep(0.02)
    assert ear.words_of_motion() == [], phase


def a_person_resumes(service: Service, client: ServiceClient, campaign: int) -> None:
    """Also connects anew: an answer that was under way came too late."""
    release(client)
    if not client.drives()["connected"]:
        httpx.post(f"{service.url}/api/v1/drives/connect", timeout=PATIENCE, trust_env=False).raise_for_status()
    for axis in client.drives()["axes"]:
        if axis["fault"]:
            client.acknowledge(axis["joint"])
    client.resume(campaign, repeat=True)
