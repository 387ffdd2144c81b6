"""Campaigns of one service over REST, CAN and processes: stopped, a worker that dies, and what is seen of it elsewhere.

An audit hook (PEP 578) in every Python process under test writes down each file of a scenarios folder that is opened:
service and workers never open the file that says what the machine really is.
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from service.identification.estimation import estimate_document
from service.identification.spectra.frequency_response import spectrum
from service.store.files.bundle import read_bundle
from service.web.client import Json, ServiceClient
from tests.otlp_collector import Collector, Received, collecting
from tests.system.rest_bench import (
    PATIENT_LEASE,
    SCENARIO,
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

pytestmark = pytest.mark.slow

CALLER = "0af7651916cd43dd8448eb211c80319c"  # a trace of the client's own
HOOK = """
import os, sys
_log, _opening = os.open(os.environ["SEAL_LOG"], os.O_WRONLY | os.O_APPEND | os.O_CREAT), []
os.write(_log, f"process {os.getpid()}\\n".encode())

def _watch(event, arguments):
    if event == "open" and not _opening and "scenarios" in str(arguments[0]):
        _opening.append(1)
        os.write(_log, f"opened {arguments[0]}\\n".encode())
        _opening.clear()

sys.addaudithook(_watch)
"""


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[VirtualMachine]:
    """It may read its scenario, so it is started before the hook is set."""
    with virtual_machine(tmp_path_factory.mktemp("machine")) as machine:
        yield machine


@pytest.fixture(scope="module")
def seal(tmp_path_factory: pytest.TempPathFactory, machine: VirtualMachine) -> Iterator[Path]:
    """Where the hook of the processes started from now on writes."""
    folder = tmp_path_factory.mktemp("hook")
    (folder / "sitecustomize.py").write_text(HOOK, "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SEAL_LOG", str(folder / "seal.log"))
        patch.setenv("PYTHONPATH", str(folder))
        yield folder / "seal.log"


@pytest.fixture(scope="module")
def collector() -> Iterator[Collector]:
    with collecting() as collector:
        yield collector


@pytest.fixture(scope="module")
def service(
    tmp_path_factory: pytest.TempPathFactory, machine: VirtualMachine, seal: Path, collector: Collector
) -> Iterator[Service]:
    """It logs at DEBUG: libraries speak too."""
    settings = {"machine_name": "cell 7", "otel": {"endpoint": collector.endpoint}, "log_level": "DEBUG"}
    with serving(tmp_path_factory.mktemp("service"), machine.profile, PATIENT_LEASE, **settings) as service:
        yield service


@pytest.fixture
def client(service: Service) -> Iterator[ServiceClient]:
    with ServiceClient(service.url) as client:
        yield client


def test_a_stop_and_a_worker_that_is_killed_change_nothing(
    service: Service, machine: VirtualMachine, client: ServiceClient, seal: Path, tmp_path: Path
) -> None:
    """The estimate is the one that the exported bundle gives without the service; each line of the log has its sweep"""
    begun = len(service.log().splitlines())
    campaign = int(client.add_campaign(add_plan(client, axes=["joint_1", "joint_2", "joint_3"], poses=2))["id"])
    client.start(campaign)
    until(lambda: client.campaign(campaign)["progress"]["current"], "a sweep runs")
    client.stop("Ada", "a test")
    until(lambda: client.campaign(campaign)["state"] == "paused", "the campaign is paused")
    until(machine.stands, "the machine stands")
    release(client)
    client.resume(campaign, repeat=True)
    killed: set[int] = set()
    for event in client.events(campaign):
        if event["kind"] == "sweep" and event["data"] | {"number": 3, "state": "recorded"} == event["data"]:
            for worker in service.workers():
                worker.kill()
                killed.add(worker.pid)
        if event["kind"] == "campaign":
            now = client.campaign(campaign)
            assert now["state"] != "paused", now["cause"]
        if event["kind"] == "campaign" and event["data"]["state"] == "completed":
            break
    workers = {worker.pid for worker in service.workers()}
    assert killed
    assert not killed & workers
    assert machine.stands()
    assert {sweep["state"] for sweep in client.sweeps(campaign)} == {"identified"}
    latest = client.estimate(campaign)
    assert latest["revision"] == 6
    check_log([json.loads(line) for line in service.log().splitlines()[begun:]], campaign, 6)

    words = seal.read_text("utf-8").splitlines()
    assert killed | workers <= {int(word.split()[1]) for word in words if word.startswith("process")}
    assert [word for word in words if word.startswith("opened")] == []

    written = run("report", str(campaign), str(tmp_path / "report.html"), url=service.url)
    assert (written.returncode, written.stderr) == (0, "")
    page = (tmp_path / "report.html").read_text("utf-8").partition("<main>")[2].partition("</main>")[0]
    for drive in client.drives()["axes"]:
        row = [drive["joint"], drive["identity"]["address"], str(drive["identity"]["serial"])]
        assert all(f">{cell}</td>" in page for cell in row), row
    exported = run("export", str(campaign), str(tmp_path / "bundle"), url=service.url)
    assert (exported.returncode, exported.stderr) == (0, "")
    bundle = read_bundle(tmp_path / "bundle")
    offline = estimate_document(bundle.robot, [spectrum(bundle.robot, sweep) for sweep in bundle.sweeps]).as_json()
    worst = max(differences(latest["document"], offline), key=lambda found: found[1])
    assert worst[1] <= 1e-9, worst


def check_log(lines: list[Json], campaign: int, sweeps: int) -> None:
    """Each line from the beginning of a sweep up to its end has its campaign and its sweep."""
    lines = [line for line in lines if not line["logger"].startswith("urllib3")]  # of spans that are sent
    found: list[Json] = []
    inside = False
    for line in lines:
        inside = inside or line["event"] == "sweep_begun"
        if inside:
            found.append(line)
        inside = inside and line["event"] not in ("recorded", "sweep_given_up")
    assert {"sweep_begun", "check_move", "sweep_given_up", "recorded"} <= {line["event"] for line in found}
    assert {"stop", "worker_replaced"} <= {line["event"] for line in lines}  # maybe after the sweep's end
    numbers = range(1, sweeps + 1)
    assert [line for line in found if line.get("campaign") != campaign or line.get("sweep") not in numbers] == []
    assert {line["sweep"] for line in found} == set(numbers)
    estimates = [line for line in lines if line["event"] == "estimate"]
    assert [(line["campaign"], line["sweep"]) for line in estimates] == [(campaign, number) for number in numbers]
    assert [line for line in lines[: lines.index(found[0])] if "sweep" in line] == []


def test_the_hook_sees_who_opens_a_scenario(tmp_path: Path, seal: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SEAL_LOG", str(tmp_path / "seal.log"))
    poses = tmp_path / "poses.json"
    poses.write_text(json.dumps([[0.0] * 6]), "utf-8")
    done = run("drive", "truth", str(SCENARIO), "--poses", str(poses), url=os.environ.get("SWEEPID_URL", ""))
    assert done.returncode == 0, done.stderr
    assert f"opened {SCENARIO}" in (tmp_path / "seal.log").read_text("utf-8").splitlines()


def test_one_trace_leads_from_request_to_estimate(
    service: Service, client: ServiceClient, collector: Collector
) -> None:
    campaign = int(client.add_campaign(add_plan(client, axes=["joint_2", "joint_3"], poses=1))["id"])
    headers = {"traceparent": f"00-{CALLER}-b7ad6b7169203331-01"}
    url = f"{service.url}/api/v1/campaigns/{campaign}/start"
    httpx.post(url, headers=headers, timeout=60, trust_env=False).raise_for_status()

    def named(name: str) -> list[Received]:
        return [span for span in collector.named(name) if span.trace == CALLER]

    until(lambda: client.campaign(campaign)["state"] == "completed", "the campaign is over")
    until(lambda: len(named("store estimate")) == 2, "the service's spans come")
    until(lambda: len(named("Job")) == 2, "the worker's spans come")
    until(lambda: named("campaign"), "the campaign's span comes")
    spans = {span.span: span for span in tuple(collector.spans) if span.trace == CALLER}

    def ancestors(span: Received) -> list[str]:
        found = [span.name]
        while span.parent in spans:
            span = spans[span.parent]
            found.append(span.name)
        return found

    (request,) = named("POST /api/v1/campaigns/{id}/start")
    assert request.parent == "b7ad6b7169203331"
    assert request.attributes["http.response.status_code"] == 200
    way = ["identification", "sweep", "campaign", request.name]
    for estimate in named("store estimate"):
        assert ancestors(estimate) == ["store estimate", *way]
    for job in named("Job"):
        assert ancestors(job) == ["Job", *way]
        assert (job.part, job.machine) == ("worker", "cell 7")
    for part in ("approach", "record"):
        assert [ancestors(span) for span in named(part)] == [[part, *way[1:]]] * 2
    assert not any(span.failed for span in spans.values())
    assert [span.attributes["sweepid.sweep"] for span in named("sweep")] == [1, 2]
    assert all(span.attributes["sweepid.campaign"] == campaign for span in named("identification"))
    for sweep in named("sweep"):
        inside = [span for span in spans.values() if span.parent == sweep.span and span.name in ("approach", "record")]
        assert all(sweep.begin <= span.begin <= span.end <= sweep.end for span in inside)
    assert not [span for span in tuple(collector.spans) if span.name.startswith("GET")]
