"""The service and its workers identify a machine without ever opening the file that says what it really is.

An audit hook (PEP 578) in every Python process under test writes down each file of a scenarios folder that is opened.
"""

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from service.client import ServiceClient
from tests.system.rest_bench import CONFIG, VirtualMachine, add_plan, run, serving, until, virtual_machine

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


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[VirtualMachine]:
    """The virtual machine; it may read its scenario, so it is started before the hook is set."""
    with virtual_machine(tmp_path) as machine:
        yield machine


@pytest.fixture
def seal(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the hook of the processes started from now on writes."""
    folder = tmp_path / "hook"
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(HOOK, "utf-8")
    log = tmp_path / "seal.log"
    monkeypatch.setenv("SEAL_LOG", str(log))
    monkeypatch.setenv("PYTHONPATH", str(folder))
    return log


def test_service_and_workers_never_open_a_scenario(tmp_path: Path, machine: VirtualMachine, seal: Path) -> None:
    with serving(tmp_path, machine.profile) as service, ServiceClient(service.url) as client:
        campaign = int(client.add_campaign(add_plan(client, axes=["joint_3"], poses=2))["id"])
        client.start(campaign)
        until(lambda: client.campaign(campaign)["state"] not in ("running", "measured"), "the campaign's end")
        assert client.campaign(campaign)["state"] == "completed"
        assert client.estimate(campaign)["document"]["axes"]["joint_3"]["inertia"]
        watched = {worker.pid for worker in service.workers()}
    words = seal.read_text("utf-8").splitlines()
    processes = {int(word.split()[1]) for word in words if word.startswith("process")}
    assert watched
    assert watched <= processes
    assert [word for word in words if word.startswith("opened")] == []


def test_the_hook_sees_who_does(tmp_path: Path, seal: Path) -> None:
    poses = tmp_path / "poses.json"
    poses.write_text(json.dumps([[0.0] * 6]), "utf-8")
    scenario = CONFIG / "scenarios" / "max100-full.yaml"
    done = run("drive", "truth", str(scenario), "--poses", str(poses), url=os.environ.get("SWEEPID_URL", ""))
    assert done.returncode == 0, done.stderr
    assert f"opened {scenario}" in seal.read_text("utf-8").splitlines()
