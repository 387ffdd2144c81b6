"""The tutorials word for word, on free ports: what their reader types, and the figures that they tell."""

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from service.cli.virtual_cell import drive_profile, running
from service.web.client import Json
from tests.ports import free_port
from tests.programs import needs
from tests.system.rest_bench import CONFIG, serving, until

pytestmark = needs("bash", "curl")
TUTORIALS = CONFIG.parent / "docs" / "tutorials"
TIMEOUT = 600.0  # s, of a command on a busy computer
NUMBER = r"\d+(?:\.\d+)?"

Typed = Callable[[str], str]


def test_the_first_campaign(tmp_path: Path) -> None:
    venv, drive, serve, measured, exported, reported = blocks("first-campaign")
    assert venv.startswith("make venv\n")
    with cell(tmp_path, drive, serve) as typed:
        assert typed(measured).split()[-1] == "1"
        told = typed(exported)
        assert "ondition number" in told
        assert all(joint in told for joint in ("joint_1", "joint_2", "joint_3"))
        typed(reported)
    assert "joint_1 against CAD" in (tmp_path / "report.html").read_text("utf-8")


def test_a_hidden_effect_is_found(tmp_path: Path) -> None:
    drive, serve, measured, diagnosed, experiment, second, accepted, truth = blocks("find-a-hidden-effect")
    page = (TUTORIALS / "find-a-hidden-effect.md").read_text("utf-8")
    first_told, second_told = (
        quote.replace("\n> ", " ") for quote in re.findall(r"^> (.*(?:\n> .*)*)", page, re.MULTILINE)
    )
    with cell(tmp_path, drive, serve) as typed:
        assert typed(measured)
        order, look = diagnosed.splitlines()
        typed(order)
        alike(ended(typed, look), first_told)
        typed(experiment)
        look, report = second.splitlines()
        alike(ended(typed, look), second_told)
        typed(report)
        assert "Coulomb friction" in (tmp_path / "diagnosis.html").read_text("utf-8")
        scenario = typed(accepted)
        alike(said(r"coulomb: ([\d.]+)", scenario), said(r"`coulomb: ([\d.]+)`", page))
        hidden = json.loads(typed(truth))
        assert (hidden["joint"], hidden["effect"]) == ("joint_3", "coulomb_friction")
        assert f"{hidden['parameters']['coulomb']:.4f}".startswith(said(r'"coulomb": ([\d.]+)\.\.\.', page))


def blocks(tutorial: str) -> list[str]:
    """What is typed, block by block."""
    text = (TUTORIALS / f"{tutorial}.md").read_text("utf-8")
    return re.findall(r"^```sh\n(.*?)\n```$", text, re.MULTILINE | re.DOTALL)


@contextmanager
def cell(folder: Path, drive: str, serve: str) -> Iterator[Typed]:
    """What the first two terminals start; what the third one prints for a block, whose last command must succeed."""
    assert serve.splitlines()[-1] == "sweepid serve"
    (folder / "config").symlink_to(CONFIG)
    program, *options = shlex.split(drive.replace("config/", f"{CONFIG}/"))
    assert program == "sweepid"
    port = free_port()
    profile = drive_profile(CONFIG / "drives" / "virtual-max100.yaml", port, folder / "profile.yaml")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    with running((*options, "--port", str(port)), folder / "drive.log"), serving(folder, profile) as service:
        environment = os.environ | {"PATH": path, "SWEEPID_URL": service.url}

        def typed(block: str) -> str:
            words = ["bash", "-ec", block.replace("curl ", "curl -sS ").replace("localhost:8642", service.url)]
            done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=TIMEOUT)
            assert done.returncode == 0, done.stderr
            return done.stdout

        yield typed


def ended(typed: Typed, look: str) -> str:
    """The summary of a diagnosis, once it is done."""
    seen: list[Json] = []

    def done() -> bool:
        seen.append(json.loads(typed(look)))
        return bool(seen[-1].get("state") == "done")

    until(done, look, TIMEOUT)
    return str(seen[-1]["document"]["axes"]["joint_3"]["summary"])


def alike(told: str, page: str) -> None:
    """The same words, and the figures of the page within a tenth."""
    assert re.sub(NUMBER, "#", told) == re.sub(NUMBER, "#", page)
    assert list(map(float, re.findall(NUMBER, told))) == pytest.approx(
        list(map(float, re.findall(NUMBER, page))), rel=0.1
    )


def said(pattern: str, text: str) -> str:
    found = re.search(pattern, text)
    assert found, text
    return found[1]
