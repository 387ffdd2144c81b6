"""The how-to from a maker's URDF to the first plan, word for word, in a copy of the project's configuration."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pinocchio as pin

from service.cli.virtual_cell import running
from tests.ports import free_port

ROOT = Path(__file__).parents[2]
DOCUMENT = ROOT / "docs/how-to/from-a-makers-urdf.md"
TIMEOUT = 300.0  # s, of a command


def test_the_commands_lead_to_a_plan(tmp_path: Path) -> None:
    commands = re.findall(r"^```sh\n(.*?)\n```$", DOCUMENT.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    assert [command.split()[0] for command in commands] == ["ln", *["sweepid"] * 3, "sed", *["sweepid"] * 2]
    shutil.copytree(ROOT / "config", tmp_path / "config")
    *before, serve, plan = commands
    for command in before:
        run(command, tmp_path)
    assert serve == "sweepid serve"
    drafts = tmp_path / "config"
    folders = f"data_dir: {tmp_path / 'var'}\nrobots_dir: {drafts / 'robots'}\ncells_dir: {drafts / 'cells'}\n"
    settings = tmp_path / "service.yaml"
    settings.write_text(f"{folders}drive: {drafts / 'drives/virtual-max100.yaml'}\n", "utf-8")
    with running(("serve", "--config", str(settings), "--port", "0"), tmp_path / "serve.log") as service:
        told = run(f"{plan} --url {service.url}", tmp_path)
    assert "24 poses, 72 sweeps" in told.stderr
    document = json.loads((tmp_path / "plan.json").read_text("utf-8"))["document"]
    assert document["robot"] == "ur5"
    assert document["dropped"] == []


def test_a_virtual_machine_of_it_is_measured(tmp_path: Path) -> None:
    """What a user types in section 3, on free ports; Pinocchio reads the exported robot, the sheet has its axes."""
    text = DOCUMENT.read_text("utf-8")
    shutil.copytree(ROOT / "config", tmp_path / "config")
    for command in re.findall(r"^```sh\n(.*?)\n```$", text, re.MULTILINE | re.DOTALL)[:4]:
        run(command, tmp_path)
    plan, measure = re.findall(r"^\$ (sweepid (?:plan|measure) .*)$", text, re.MULTILINE)
    folder, port = tmp_path / "config/ur5-virtual", free_port()
    profile, settings = folder / "drives/ur5-virtual.yaml", folder / "service.yaml"
    profile.write_text(profile.read_text().replace("port: 29536", f"port: {port}"))
    settings.write_text(settings.read_text().replace("config/", f"{tmp_path / 'config'}/"))
    scenario, eds = str(folder / "scenarios/ur5-virtual.yaml"), str(tmp_path / "config/eds/virtual-axis.eds")
    drives = running(("drive", "--scenario", scenario, "--eds", eds, "--port", str(port)), tmp_path / "drive.log")
    with drives, running(("serve", "--config", str(settings), "--port", "0"), tmp_path / "serve.log") as service:
        told = run(f"{plan.replace('--poses 5', '--poses 1')} --url {service.url}", tmp_path)
        assert " 3 sweeps" in told.stderr
        told = run(f"{measure} --url {service.url}", tmp_path)
        assert "3/3 completed" in told.stderr
        run(f"sweepid export 1 my-bundle --url {service.url}", tmp_path)
    run("sweepid export model my-bundle model", tmp_path)
    measured = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
    assert set(measured) < set(pin.buildModelFromUrdf(str(tmp_path / "model/model.urdf")).names)
    sheet = run("sweepid export sheet my-bundle", tmp_path).stdout
    assert all(axis in sheet for axis in measured)


def run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        command, shell=True, cwd=folder, env=environment, capture_output=True, text=True, timeout=TIMEOUT
    )
    assert done.returncode == 0, done.stderr
    return done
