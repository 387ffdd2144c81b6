"""The how-to from a maker's URDF to the first plan, word for word, in a copy of the project's configuration."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from service.demo.processes import running

ROOT = Path(__file__).parents[2]
DOCUMENT = ROOT / "docs/how-to/from-a-makers-urdf.md"
TIMEOUT = 300.0  # s, of a command


def test_the_commands_lead_to_a_plan(tmp_path: Path) -> None:
    commands = re.findall(r"^```sh\n(.*?)\n```$", DOCUMENT.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    assert [command.split()[0] for command in commands] == ["ln", "sweepid", "sweepid", "sed", "sweepid", "sweepid"]
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


def run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    done = subprocess.run(
        command, shell=True, cwd=folder, env=environment, capture_output=True, text=True, timeout=TIMEOUT
    )
    assert done.returncode == 0, done.stderr
    return done
