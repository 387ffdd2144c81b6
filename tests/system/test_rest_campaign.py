"""From a plan to an estimate: the command line over REST, a virtual machine over CAN, a worker that dies."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.client import ServiceClient
from service.estimation import estimate_document
from service.identification import spectrum
from service.store.files.bundle import read_bundle
from tests.system.rest_bench import (
    ROBOT,
    Service,
    VirtualMachine,
    add_plan,
    differences,
    release,
    run,
    serving,
    until,
    virtual_machine,
)

# a background job of a shell hands an ignored Ctrl-C down; whoever tests it must have it
INTERRUPTIBLE = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from service.cli import main; main()"
)


@pytest.fixture
def machine(tmp_path: Path, speed_factor: float) -> Iterator[VirtualMachine]:
    with virtual_machine(tmp_path, speed_factor) as machine:
        yield machine


@pytest.fixture
def service(tmp_path: Path, machine: VirtualMachine) -> Iterator[Service]:
    with serving(tmp_path, machine.profile) as service:
        yield service


@pytest.fixture
def client(service: Service) -> Iterator[ServiceClient]:
    with ServiceClient(service.url) as client:
        yield client


@pytest.mark.parametrize("speed_factor", [20.0])
def test_a_worker_that_is_killed_in_the_middle_changes_nothing(
    service: Service, machine: VirtualMachine, client: ServiceClient, tmp_path: Path
) -> None:
    """6 sweeps; the estimate is the one that the exported bundle gives without the service."""
    plan = add_plan(client, axes=["joint_1", "joint_2", "joint_3"], poses=2)
    campaign = int(client.add_campaign(plan)["id"])
    client.start(campaign)
    killed: list[int] = []
    for event in client.events(campaign):
        if event["kind"] == "sweep" and event["data"] | {"number": 3, "state": "recorded"} == event["data"]:
            for worker in service.workers():
                worker.kill()
                killed.append(worker.pid)
        if event["kind"] == "campaign":
            assert event["data"]["state"] in ("planned", "running", "measured", "completed"), event
            if event["data"]["state"] == "completed":
                break
    assert killed
    assert not set(killed) & {worker.pid for worker in service.workers()}
    assert machine.stands()
    assert {sweep["state"] for sweep in client.sweeps(campaign)} == {"identified"}
    latest = client.estimate(campaign)
    assert latest["revision"] == 6

    written = run("report", str(campaign), str(tmp_path / "report.html"), url=service.url)
    assert (written.returncode, written.stderr) == (0, "")
    drives = client.drives()["axes"]
    page = (tmp_path / "report.html").read_text("utf-8").partition("<main>")[2].partition("</main>")[0]
    for drive in drives:
        row = [drive["joint"], drive["identity"]["address"], str(drive["identity"]["serial"])]
        assert all(f">{cell}</td>" in page for cell in row), row
    exported = run("export", str(campaign), str(tmp_path / "bundle"), url=service.url)
    assert (exported.returncode, exported.stderr) == (0, "")
    bundle = read_bundle(tmp_path / "bundle")
    offline = estimate_document(bundle.robot, [spectrum(bundle.robot, sweep) for sweep in bundle.sweeps]).as_json()
    worst = max(differences(latest["document"], offline), key=lambda found: found[1])
    assert worst[1] <= 1e-9, worst


@pytest.mark.parametrize("speed_factor", [2.0])  # slow enough to be interrupted
def test_the_command_line_measures_and_ctrl_c_stops_the_machine(
    service: Service, machine: VirtualMachine, client: ServiceClient
) -> None:
    planned = run(
        *("plan", str(ROBOT), "--axes", "joint_1", "--varied", "joint_2,joint_3", "--poses", "1"),
        *("--step", "15"),
        url=service.url,
    )
    assert planned.returncode == 0, planned.stderr
    plan = planned.stdout.strip()
    environment = os.environ | {"SWEEPID_URL": service.url}
    known = len(client.campaigns())
    command = [sys.executable, "-c", INTERRUPTIBLE, "measure", plan]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as measuring:
        until(lambda: len(client.campaigns()) > known, "campaign added")
        campaign = client.campaigns()[-1]["id"]
        until(lambda: machine.axes()["joint_1"]["velocity"] != 0, "joint_1 moves")
        measuring.send_signal(signal.SIGINT)
        out, err = measuring.communicate(timeout=60)
    assert (measuring.returncode, out) == (1, ""), err
    assert f"campaign {campaign}: machine stopped" in err.splitlines()[-1]
    until(machine.stands, "the axes stand")
    only_the_stop = ["stopped by sweepid measure: Ctrl-C"]  # once the end of the campaign is stored as well
    until(lambda: client.ready()["causes"] == only_the_stop, f"of the causes {only_the_stop} alone is left")
    until(lambda: client.campaign(campaign)["state"] == "paused", "campaign paused")

    release(client)
    client.resume(campaign, repeat=True)
    until(lambda: client.campaign(campaign)["state"] == "completed", "campaign completed")
    assert client.estimate(campaign)["revision"] == 1
