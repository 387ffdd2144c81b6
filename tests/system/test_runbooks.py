"""The operators' runbooks on one virtual machine: each well and with a fault; what they leave, the protocol tells.

The tests go through a machine's life in their order: nothing yet, commissioned, reference, check, fault, stop, backup,
repair, another load.
"""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

from service.store.files.bundle import read_bundle
from service.web.client import Json, ServiceClient
from tests.system.rest_bench import (
    CONFIG,
    PATIENCE,
    ROBOT,
    SCENARIO,
    Service,
    VirtualMachine,
    run,
    serving,
    until,
    virtual_machine,
)
from tests.unit.service.api.conftest import bundle, robot  # noqa: F401 - three sweeps of joint_1

RUNBOOKS = Path(__file__).parents[2] / "docs" / "how-to" / "runbooks"
PLAN = ("max100-class", "--axes", "joint_2,joint_3", "--varied", "joint_3", "--step", "15")
OVERNIGHT = ("overnight", *PLAN, "--confidence", "2")
DONE, FAILED, BAD_INPUT, STOPPED, AMBER = range(5)
CELL = CONFIG / "cells" / "workshop.yaml"
COMMISSION = (str(ROBOT), str(CELL), "--axes", "joint_2,joint_3", "--varied", "joint_3")
NOBODY = ("--url", "http://127.0.0.1:9")  # no service listens there
PAYLOAD = 25.0  # kg, instead of 1.2


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runbooks")


@pytest.fixture(scope="module")
def machine(folder: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(folder) as machine:
        yield machine


@pytest.fixture(scope="module")
def service(folder: Path, machine: VirtualMachine) -> Iterator[Service]:
    with serving(folder, machine.profile) as service:
        yield service


@pytest.fixture(scope="module")
def client(service: Service) -> Iterator[ServiceClient]:
    with ServiceClient(service.url) as client:
        yield client


class Books:
    """Runs runbooks as a shell does."""

    def __init__(self, folder: Path, url: str) -> None:
        self._folder, self._url = folder, url
        self._runs = 0

    def begin(self, name: str, *arguments: str) -> tuple[subprocess.Popen[str], Path]:
        """The process, and the file of its protocol."""
        self._runs += 1
        protocol = self._folder / f"protocol-{self._runs}.json"
        command = [sys.executable, str(RUNBOOKS / f"{name}.py"), "--by", "Ada", "--protocol", str(protocol), *arguments]
        pipe, environment = subprocess.PIPE, os.environ | {"SWEEPID_URL": self._url}
        run = subprocess.Popen(command, text=True, env=environment, stdin=pipe, stdout=pipe, stderr=pipe)
        return run, protocol

    def run(self, name: str, *arguments: str, typed: str = "") -> tuple[int, Json, str]:
        """Exit code, protocol and what was printed."""
        process, protocol = self.begin(name, *arguments)
        out, err = process.communicate(typed, timeout=4 * PATIENCE)
        assert "Traceback" not in err, err
        return process.returncode, read(protocol, process.returncode), out + err


def read(protocol: Path, code: int) -> Json:
    """The protocol, which is whole."""
    content = json.loads(protocol.read_text("utf-8"))
    assert (content["by"], content["exit_code"]) == ("Ada", code)
    assert content["begun"] < content["ended"]
    assert all(step["result"] for step in content["steps"])
    return content


def results(protocol: Json, key: str) -> dict[str, Json]:
    """The steps that have `key`, by the step's name; the worst of an axis stands last or alone."""
    return {step["step"]: step for step in protocol["steps"] if key in step}


@pytest.fixture(scope="module")
def books(folder: Path, service: Service) -> Books:
    return Books(folder, service.url)


@pytest.fixture(scope="module")
def reference(books: Books) -> Json:
    """The protocol of a night that reached its confidence."""
    code, protocol, printed = books.run(*OVERNIGHT, "--yes")
    assert code == DONE, printed
    return protocol


def test_a_dry_run_tells_every_axis_and_moves_nothing(
    books: Books, client: ServiceClient, machine: VirtualMachine
) -> None:
    code, protocol, printed = books.run(*OVERNIGHT, "--dry-run")
    assert code == DONE, printed
    motion = {joint: step["motion"] for joint, step in results(protocol, "motion").items()}
    assert motion.keys() == {"joint_2", "joint_3"}
    for joint, move in motion.items():
        assert move["lowest_deg"] < move["highest_deg"]
        assert move["arm_mm"] > 0
        assert move["seconds"] > 0
        assert f"{joint}: {move['lowest_deg']:.1f} to {move['highest_deg']:.1f} deg" in printed
    assert client.campaigns() == []
    assert machine.stands()


def test_bad_input_is_told_before_anything_moves(books: Books, client: ServiceClient) -> None:
    known = len(client.campaigns())
    code, protocol, printed = books.run("overnight", "nobody", *PLAN[1:], "--confidence", "2", "--yes", "--dry-run")
    assert (code, "has no robot nobody" in printed) == (BAD_INPUT, True)
    assert "has no robot nobody" in protocol["result"]
    code, protocol, printed = books.run(*OVERNIGHT, "--cell", "nowhere", "--yes", "--dry-run")
    assert (code, "there is no cell nowhere in" in printed and "there is: workshop" in printed) == (BAD_INPUT, True)
    assert len(client.campaigns()) == known


def test_an_output_that_nobody_reads_is_told_without_a_traceback(books: Books, client: ServiceClient) -> None:
    process, file = books.begin(*OVERNIGHT, "--dry-run")
    with process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()  # as by "| head", before the first line
        told = process.stderr.read()
    assert process.returncode == FAILED
    assert told == "overnight: the output was closed, nobody reads it\n"
    assert read(file, process.returncode)["result"] == "the output was closed, nobody reads it"
    assert client.campaigns() == []


def test_a_robot_or_cell_that_is_none_is_told_before_anything(
    books: Books, client: ServiceClient, tmp_path: Path
) -> None:
    side = yaml.safe_load(ROBOT.read_text("utf-8"))
    side["axes"][1]["rated_effort"] = -5
    side["urdf"] = str(ROBOT.with_suffix(".urdf"))
    (wrong := tmp_path / "wrong.yaml").write_text(yaml.safe_dump(side), "utf-8")
    for arguments, reason in (
        ((str(wrong), str(CELL)), "rated_effort"),
        ((str(ROBOT), str(CELL.with_name("nowhere.yaml"))), "there is no cell nowhere"),
    ):
        code, protocol, printed = books.run("commission", *arguments, *COMMISSION[2:], "--yes")
        assert (code, reason in printed) == (BAD_INPUT, True), printed
        assert reason in protocol["result"]
    assert client.campaigns() == []


def test_a_machine_is_commissioned(books: Books, client: ServiceClient, machine: VirtualMachine) -> None:
    code, protocol, printed = books.run("commission", *COMMISSION, "--dry-run")
    assert code == DONE, printed
    assert results(protocol, "motion").keys() == {"joint_2", "joint_3"}
    assert client.campaigns() == []

    code, protocol, printed = books.run("commission", *COMMISSION, "--yes")
    told = [step["finding"]["severity"] for step in protocol["steps"] if "finding" in step]
    assert code == (FAILED if "wrong" in told else AMBER if told else DONE), printed
    assert "wrong" not in told, printed
    for joint, step in results(protocol, "axis").items():
        assert len(step["inertia"]) == 2, joint
        assert all(sweep["value"] > 0 for sweep in step["inertia"])
    assert results(protocol, "axis").keys() == {"joint_2", "joint_3"}
    assert machine.stands()


def test_a_night_ends_with_the_confidence(reference: Json, machine: VirtualMachine) -> None:
    assert "confidence of 2 % reached" in reference["steps"][-1]["result"]
    assert reference["robot"]["name"] == "max100-class"
    assert reference["versions"]["service"]
    assert reference["versions"]["drives"]["joint_1"]["serial"]
    recorded = [step for step in reference["steps"] if "sweep" in step]
    assert len(recorded) == 6
    assert all(step["left_s"] is not None for step in recorded)
    assert machine.stands()


Ran = tuple[int, Json, str]  # exit code, protocol, what was printed


@pytest.fixture(scope="module")
def unchanged(books: Books, reference: Json) -> Ran:
    """The daily check after the campaign of the first night."""
    return books.run("daily_check", "max100-class", "--yes")


def test_an_unchanged_machine_passes_the_daily_check(reference: Json, unchanged: Ran, machine: VirtualMachine) -> None:
    code, protocol, printed = unchanged
    axes = results(protocol, "colour")
    assert axes.keys() == {"joint_2", "joint_3"}, printed
    assert code == (AMBER if any(axis["colour"] == "amber" for axis in axes.values()) else DONE), printed
    for axis in axes.values():
        assert abs(axis["significance"]) <= 4  # one in twenty is amber by chance
        assert abs(axis["deviation_percent"]) < 5
        own, stored = axis["measured"], axis["estimate"]
        both = (own["std"] ** 2 + stored["std"] ** 2) ** 0.5
        assert axis["significance"] == pytest.approx((own["value"] - stored["value"]) / both)
    assert protocol["steps"][0]["campaign"] == reference["campaign"]
    assert machine.stands()


def test_a_fault_ends_the_night_and_nothing_is_resumed(
    books: Books, client: ServiceClient, machine: VirtualMachine
) -> None:
    machine.order("fault", joint="joint_2", code=0x4310, at_sample=50)
    code, protocol, printed = books.run(*OVERNIGHT, "--yes")
    assert code == FAILED, printed
    assert protocol["steps"][-1]["result"] == "a fault"
    assert "4310h" in protocol["steps"][-1]["cause"]
    until(machine.stands, "the axes stand")
    campaign = protocol["campaign"]
    assert client.campaign(campaign)["state"] == "paused"

    code, protocol, printed = books.run("after_a_stop", typed="no\n")
    assert code == STOPPED, printed
    told = [step["result"] for step in protocol["steps"] if step["step"] == "next"]
    assert told == ["acknowledge joint_2 (error 4310h, history 00004310h); moves nothing"]
    assert client.campaign(campaign)["state"] == "paused"
    (faulty,) = [axis["joint"] for axis in client.drives()["axes"] if axis["fault"]]
    client.acknowledge(faulty)
    client.abort(campaign, "the test goes on")


def test_sigterm_stops_the_machine_and_after_a_stop_leads_on(
    books: Books, reference: Json, client: ServiceClient, machine: VirtualMachine
) -> None:
    process, file = books.begin("before_and_after", "max100-class", "--before", str(reference["campaign"]), "--yes")
    with process:
        until(lambda: any(abs(axis["velocity"]) > 1e-3 for axis in machine.axes().values()), "an axis moves")
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=PATIENCE)
    protocol = read(file, process.returncode)
    assert process.returncode == STOPPED, err
    assert protocol["result"].startswith("stopped: SIGTERM; machine stopped")
    until(machine.stands, "the axes stand")
    after = protocol["campaign"]
    until(lambda: client.campaign(after)["state"] == "paused", "campaign paused")
    assert [stop["by"] for stop in client.stops()] == ["before_and_after"]

    code, protocol, printed = books.run("after_a_stop", "--dry-run")
    assert (code, "to do: release stop" in printed) == (DONE, True), printed
    assert results(protocol, "motion").keys() == {"joint_2", "joint_3"}
    assert len(client.stops()) == 1

    code, protocol, printed = books.run("after_a_stop", typed="release\nresume\n")
    assert (code, client.stops()) == (DONE, []), printed
    assert "latched by before_and_after" in printed
    assert client.campaign(after)["state"] == "completed"

    numbers = ("--before", str(reference["campaign"]), "--after", str(after))
    code, protocol, printed = books.run("before_and_after", "max100-class", *numbers)
    assert code in (DONE, AMBER), printed
    axes = results(protocol, "significance")
    assert axes.keys() == {"joint_2", "joint_3"}
    assert all(axis["poses"] == 3 and axis["std"] > 0 for axis in axes.values())
    assert protocol["steps"][-1]["step"] == "verdict"


@pytest.fixture(scope="module")
def backup(books: Books, service: Service, folder: Path) -> tuple[Path, Json]:
    """With the protocol of its making."""
    code, protocol, printed = books.run("back_up", str(folder / "backup"), "--data-dir", str(service.data))
    assert code == DONE, printed
    return folder / "backup", protocol


def test_a_backup_is_made_and_rehearsed(
    books: Books, service: Service, backup: tuple[Path, Json], tmp_path: Path
) -> None:
    target, data = tmp_path / "backup", ("--data-dir", str(service.data))
    code, _, printed = books.run("back_up", str(target), *data, "--dry-run")
    assert (code, target.exists(), "would be copied" in printed) == (DONE, False, True), printed
    assert [step["step"] for step in backup[1]["steps"]] == [
        *("data folder", "backup", "restored", "rehearsal", "rehearsal")
    ]
    assert not list(backup[0].parent.glob("*rehears*"))  # it is gone
    code, _, printed = books.run("back_up", str(backup[0]), *data)
    assert (code, "exists already; nothing is overwritten" in printed) == (BAD_INPUT, True), printed
    code, _, printed = books.run("back_up", str(tmp_path / "no-disk" / "backup"), *data)
    assert (code, "is the disk mounted?" in printed) == (BAD_INPUT, True), printed


def test_a_backup_is_restored_once_the_service_has_ended(
    books: Books, client: ServiceClient, backup: tuple[Path, Json], tmp_path: Path
) -> None:
    made, target = backup[0], tmp_path / "restored"
    for arguments, typed, expected, reason in (
        (("--dry-run",), "", DONE, "would be restored into"),
        (("--yes",), "", FAILED, "two services would command one machine"),  # it still runs
        (NOBODY, "no\n", STOPPED, "restore: declined"),
        (NOBODY, "", STOPPED, "restore: declined"),  # nobody at the keyboard
    ):
        code, _, printed = books.run("restore", str(made), str(target), *arguments, typed=typed)
        assert (code, reason in printed, target.exists()) == (expected, True, False), printed
    code, protocol, printed = books.run("restore", str(made), str(target), *NOBODY, typed="ended\n")
    assert code == DONE, printed
    assert [step["step"] for step in protocol["steps"]] == [
        *("backup", "service", "restored", "check", "campaigns", "next")
    ]
    states = [campaign["state"] for campaign in client.campaigns()]
    (campaigns,) = results(protocol, "campaigns").values()
    assert campaigns["campaigns"] == {state: states.count(state) for state in set(states)}
    code, _, printed = books.run("restore", str(made), str(target), *NOBODY, "--yes")
    assert (code, "is not an empty folder" in printed) == (BAD_INPUT, True), printed


def test_a_damaged_backup_is_not_restored(books: Books, backup: tuple[Path, Json], tmp_path: Path) -> None:
    made, target = tmp_path / "backup", tmp_path / "restored"
    shutil.copytree(backup[0], made)
    file = next(path for path in sorted((made / "data").rglob("*")) if path.is_file())
    file.write_bytes(file.read_bytes() + b" ")
    code, _, printed = books.run("restore", str(made), str(target), *NOBODY, "--yes")
    assert (code, "the backup is not complete" in printed, target.exists()) == (BAD_INPUT, True, False), printed
    code, _, printed = books.run("restore", str(tmp_path / "none"), str(target), *NOBODY, "--yes")
    assert (code, "is not a complete backup" in printed, target.exists()) == (BAD_INPUT, True, False), printed
    code, _, printed = books.run("restore", str(made), str(tmp_path / "no-disk" / "data"), *NOBODY, "--yes")
    assert (code, "is the disk mounted?" in printed) == (BAD_INPUT, True), printed


@pytest.fixture
def trace(bundle: Path, tmp_path: Path) -> Path:  # noqa: F811
    """The mapping of three traces as a control writes them: ms, motor revolutions a minute."""
    measured, entries = read_bundle(bundle), []
    for sweep in measured.sweeps:
        source, recording = f"trace-{sweep.spec.id}.csv", sweep.recording
        rows = np.column_stack([1e3 * recording.time, recording.effort, recording.velocity, recording.position])
        with (tmp_path / source).open("w", newline="") as file:
            csv.writer(file, delimiter=";").writerows([["CYCLE", "TORQUE", "SPEED", "ENC"], *rows.tolist()])
        entries.append(sweep.spec.model_dump(mode="json", exclude_none=True) | {"source": source})
    columns = {"time": {"source": "CYCLE", "scale": 0.001}}
    columns |= {name: {"source": source} for name, source in (("effort", "TORQUE"), ("velocity", "SPEED"))}
    content = {"robot": str(ROBOT), "columns": columns | {"position": {"source": "ENC"}}, "csv": {"delimiter": ";"}}
    (place := tmp_path / "mapping.yaml").write_text(yaml.safe_dump(content | {"sweeps": entries}), "utf-8")
    return place


def test_a_trace_becomes_an_inertia(books: Books, trace: Path, tmp_path: Path) -> None:
    out = tmp_path / "made"
    code, _, printed = books.run("from_a_trace", str(trace), "--out", str(out), "--dry-run")
    assert (code, out.exists()) == (DONE, False), printed
    code, protocol, printed = books.run("from_a_trace", str(trace), "--out", str(out))
    told = [step["finding"]["severity"] for step in protocol["steps"] if "finding" in step]
    assert code == (FAILED if "wrong" in told else AMBER if told else DONE), printed
    found = [step["inertia"]["value"] for step in protocol["steps"] if "inertia" in step]
    assert found == pytest.approx([275.0, 300.0, 325.0], rel=0.01)  # as the traces were made
    assert len(read_bundle(out).sweeps) == 3
    assert (tmp_path / "made-estimate.json").exists()
    code, _, printed = books.run("from_a_trace", str(trace), "--out", str(out))
    assert (code, "nothing is overwritten" in printed) == (BAD_INPUT, True), printed


@pytest.fixture(scope="module")
def heavier(
    books: Books, reference: Json, unchanged: Ran, client: ServiceClient, machine: VirtualMachine, folder: Path
) -> str:
    """The power fails, and the machine comes back with another load; the number of the campaign before."""
    scenario = yaml.safe_load(SCENARIO.read_text("utf-8")) | {"robot": str(ROBOT)}
    (payload,) = scenario["links"]["tool"]["added"]
    payload["mass"] = PAYLOAD
    heavy = folder / "heavy.yaml"
    heavy.write_text(yaml.safe_dump(scenario), "utf-8")
    machine.power_off()
    machine.power_on(heavy)
    until(lambda: not client.drives()["connected"] or client.stops(), "the power cut is noticed")
    code, _, printed = books.run("after_a_stop", "--yes")
    assert code == DONE, printed
    assert client.ready()["ready"], client.ready()["causes"]
    return str(reference["campaign"])


@pytest.fixture(scope="module")
def checked(books: Books, heavier: str) -> Ran:
    """The daily check of the heavier machine."""
    return books.run("daily_check", "max100-class", "--campaign", heavier, "--yes")


def test_another_load_is_red(checked: Ran) -> None:
    code, protocol, printed = checked
    assert code == FAILED, printed
    axis = results(protocol, "colour")["joint_3"]
    assert axis["colour"] == "red"
    assert axis["significance"] > 4
    assert axis["deviation_percent"] > 20


def test_the_sheet_tells_the_robot_from_one_with_another_load(
    client: ServiceClient, service: Service, heavier: str, checked: Ran, folder: Path
) -> None:
    """The sheet of the first night against every campaign since: the checks before the power cut and those after it."""
    assert run("export", heavier, str(folder / "night"), url=service.url).returncode == 0
    sheet = folder / "sheet.json"
    assert run("export", "sheet", str(folder / "night"), "--json", str(sheet), url=service.url).returncode == 0
    later = [one["id"] for one in client.campaigns() if one["state"] == "completed" and one["id"] > int(heavier)]
    assert len(later) >= 2
    before, after = later[0], later[-1]  # the daily check of an unchanged machine, and that of the heavier one
    same = run("check", "sheet", str(sheet), "--campaign", str(before), url=service.url)
    assert "changed since the sheet" not in same.stdout.replace("perhaps changed", ""), same.stdout + same.stderr
    changed = run("check", "sheet", str(sheet), "--campaign", str(after), url=service.url)
    assert (changed.returncode, "max100-class: changed since the sheet" in changed.stdout) == (1, True), changed.stdout
    assert "joint_3: " in changed.stdout


def test_another_load_is_a_change(books: Books, heavier: str, machine: VirtualMachine) -> None:
    code, protocol, printed = books.run("before_and_after", "max100-class", "--before", heavier, "--yes")
    assert code == FAILED, printed
    assert "joint_3 changed (+" in protocol["steps"][-1]["result"]
    assert machine.stands()


def test_a_payload_is_known_with_its_sheet(folder: Path, tmp_path: Path) -> None:
    """From nothing, as a person does it: without the payload, the power off to mount it, with it."""
    bare = CONFIG / "scenarios" / "max100-six.yaml"
    scenario = yaml.safe_load(bare.read_text("utf-8")) | {"robot": str(ROBOT)}
    load = {"name": "load", "mass": PAYLOAD, "start": [0.1, 0.05, 0.0], "end": [0.3, 0.05, 0.0], "radius": 0.1}
    scenario["links"]["link_6"] = {"added": [load]}
    (heavy := tmp_path / "heavy.yaml").write_text(yaml.safe_dump(scenario), "utf-8")
    command = ("payload", "max100-class", "--trajectories", "1", "--velocity", "0.8")
    with virtual_machine(tmp_path, scenario=bare) as machine, serving(tmp_path, machine.profile) as service:
        books = Books(tmp_path, service.url)
        with ServiceClient(service.url) as client:
            code, protocol, printed = books.run(*command, typed="yes\n")
            assert (code, protocol["steps"][-1]["result"]) == (DONE, "payload.py max100-class --before 1"), printed
            assert machine.stands()
            machine.power_off()
            machine.power_on(heavy)
            until(lambda: not client.drives()["connected"] or client.stops(), "the power cut is noticed")
            code, _, printed = books.run("after_a_stop", "--yes")
            assert code == DONE, printed
            out = tmp_path / "loaded"
            code, protocol, printed = books.run(*command, "--before", "1", "--out", str(out), "--yes")
            assert code == DONE, printed
            figures = {name: step["figure"] for name, step in results(protocol, "figure").items()}
            for name, true in (("mass", PAYLOAD), ("centre x", 0.2), ("centre y", 0.05), ("centre z", 0.0)):
                figure = figures[name]
                assert abs(figure["value"] - true) < 4 * figure["std"], (name, figure)
            assert figures["mass"]["std"] < 0.02 * PAYLOAD
            sheet = (out / "sheet.md").read_text("utf-8")
            assert sheet == run("export", "sheet", "--payload", str(out / "payload.json"), url=service.url).stdout
            assert "set_target_payload(" in sheet
            arguments = (*command, "--before", "1", "--after", "2", "--out")
            code, _, printed = books.run(*arguments, str(tmp_path / "dry"), "--dry-run")
            assert (code, (tmp_path / "dry").exists()) == (DONE, False), printed
            code, _, printed = books.run(*arguments, str(tmp_path / "again"))  # nothing moves
            assert (code, (tmp_path / "again" / "sheet.md").read_text("utf-8")) == (DONE, sheet), printed
            code, _, printed = books.run(*arguments, str(out))
            assert (code, "nothing is overwritten" in printed) == (BAD_INPUT, True), printed
