"""The runbooks of the first day, of a trace from elsewhere and of the backup: well, dry, and with something wrong."""

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

from service.client import ServiceClient
from service.store.files.bundle import read_bundle
from tests.system.rest_bench import (
    CONFIG,
    ROBOT,
    Service,
    VirtualMachine,
    serving,
    virtual_machine,
)
from tests.system.test_runbooks import AMBER, BAD_INPUT, DONE, FAILED, STOPPED, Books, results
from tests.unit.service.api.conftest import bundle, robot  # noqa: F401 - three sweeps of joint_1

CELL = CONFIG / "cells" / "workshop.yaml"
COMMISSION = (str(ROBOT), str(CELL), "--axes", "joint_2,joint_3", "--varied", "joint_3")


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
def books(folder: Path, service: Service) -> Books:
    return Books(folder, service.url)


def test_a_robot_or_cell_that_is_none_is_told_before_anything(books: Books, service: Service, tmp_path: Path) -> None:
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
    with ServiceClient(service.url) as client:
        assert client.campaigns() == []


def test_a_machine_is_commissioned(books: Books, service: Service, machine: VirtualMachine) -> None:
    code, protocol, printed = books.run("commission", *COMMISSION, "--dry-run")
    assert code == DONE, printed
    assert results(protocol, "motion").keys() == {"joint_2", "joint_3"}
    with ServiceClient(service.url) as client:
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


def test_a_backup_is_made_and_rehearsed(books: Books, service: Service, tmp_path: Path) -> None:
    target, data = tmp_path / "backup", ("--data-dir", str(service.data))
    code, _, printed = books.run("back_up", str(target), *data, "--dry-run")
    assert (code, target.exists(), "would be copied" in printed) == (DONE, False, True), printed
    code, protocol, printed = books.run("back_up", str(target), *data)
    assert code == DONE, printed
    assert [step["step"] for step in protocol["steps"]] == [
        *("data folder", "backup", "restored", "rehearsal", "rehearsal")
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["backup"]  # the rehearsal is gone
    code, _, printed = books.run("back_up", str(target), *data)
    assert (code, "exists already; nothing is overwritten" in printed) == (BAD_INPUT, True), printed
    code, _, printed = books.run("back_up", str(tmp_path / "no-disk" / "backup"), *data)
    assert (code, "is the disk mounted?" in printed) == (BAD_INPUT, True), printed


def test_damage_is_told_and_not_backed_up(books: Books, service: Service, tmp_path: Path) -> None:
    restored, target = tmp_path / "damaged", tmp_path / "backup"
    assert books.run("back_up", str(target), "--data-dir", str(service.data))[0] == DONE
    (target / "data").rename(restored)
    recording = next(restored.rglob("*.parquet"))
    recording.write_bytes(recording.read_bytes()[:-1])
    code, protocol, printed = books.run("back_up", str(tmp_path / "second"), "--data-dir", str(restored))
    assert code == FAILED, printed
    assert [step["finding"] for step in protocol["steps"]] == [str(recording)]
    assert not (tmp_path / "second").exists()


NOBODY = ("--url", "http://127.0.0.1:9")  # no service listens there


def test_a_backup_is_restored_once_the_service_has_ended(books: Books, service: Service, tmp_path: Path) -> None:
    backup, target = tmp_path / "backup", tmp_path / "restored"
    assert books.run("back_up", str(backup), "--data-dir", str(service.data))[0] == DONE
    for arguments, typed, expected, reason in (
        (("--dry-run",), "", DONE, "would be restored into"),
        (("--yes",), "", FAILED, "two services would command one machine"),  # it still runs
        (NOBODY, "no\n", STOPPED, "restore: declined"),
        (NOBODY, "", STOPPED, "restore: declined"),  # nobody at the keyboard
    ):
        code, _, printed = books.run("restore", str(backup), str(target), *arguments, typed=typed)
        assert (code, reason in printed, target.exists()) == (expected, True, False), printed
    code, protocol, printed = books.run("restore", str(backup), str(target), *NOBODY, typed="ended\n")
    assert code == DONE, printed
    assert [step["step"] for step in protocol["steps"]] == [
        *("backup", "service", "restored", "check", "campaigns", "next")
    ]
    with ServiceClient(service.url) as client:
        states = [campaign["state"] for campaign in client.campaigns()]
    (campaigns,) = results(protocol, "campaigns").values()
    assert campaigns["campaigns"] == {state: states.count(state) for state in set(states)}
    code, _, printed = books.run("restore", str(backup), str(target), *NOBODY, "--yes")
    assert (code, "is not an empty folder" in printed) == (BAD_INPUT, True), printed


def test_a_damaged_backup_is_not_restored(books: Books, service: Service, tmp_path: Path) -> None:
    backup, target = tmp_path / "backup", tmp_path / "restored"
    assert books.run("back_up", str(backup), "--data-dir", str(service.data))[0] == DONE
    file = next(path for path in sorted((backup / "data").rglob("*")) if path.is_file())
    file.write_bytes(file.read_bytes() + b" ")
    code, _, printed = books.run("restore", str(backup), str(target), *NOBODY, "--yes")
    assert (code, "the backup is not complete" in printed, target.exists()) == (BAD_INPUT, True, False), printed
    code, _, printed = books.run("restore", str(tmp_path / "none"), str(target), *NOBODY, "--yes")
    assert (code, "is not a complete backup" in printed, target.exists()) == (BAD_INPUT, True, False), printed
    code, _, printed = books.run("restore", str(backup), str(tmp_path / "no-disk" / "data"), *NOBODY, "--yes")
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
