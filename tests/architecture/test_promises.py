"""What is promised of motion is shown by tests that are there; its figures are those of the example machine."""

import ast
import re
from pathlib import Path

import pytest

from drivers.canopen.profile import BusProfile
from drivers.registry import load_profile
from service.planning.documents import PlanRequest

PAGE = Path("docs/explanation/safety.md")
THREATS = Path("docs/explanation/threat-model.md")
ROW = re.compile(r"^\| (.+?) \| `(tests/\S+\.py)::(\w+)` \|$", re.MULTILINE)
SPEED = re.compile(r"^\| ([\d.]+) rad/s, .+? \| ([\d.]+) rad \| ([\d.]+) rad \|$", re.MULTILINE)
VERDICTS = {"met", "partly", "not", "not applicable"}


def names_in(path: Path) -> set[str]:
    found = ast.walk(ast.parse(path.read_text("utf-8")))
    return {node.name for node in found if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)}


def test_each_promise_has_its_test(root: Path) -> None:
    page = (root / PAGE).read_text("utf-8")
    table = page.partition("| promise | shown by |\n|---|---|\n")[2].strip().splitlines()
    assert len(ROW.findall(page)) == len(table) >= 20
    for _, file, name in ROW.findall(page):
        assert name.startswith("test_")
        assert name in names_in(root / file), f"{file}::{name}"


def test_the_travel_after_the_death_of_the_host_is_that_of_the_example_machine(root: Path) -> None:
    profile = load_profile(root / "config" / "drives" / "virtual-max100.yaml")
    bus, axes = profile["bus"], profile["axes"]
    assert isinstance(bus, dict)
    assert isinstance(axes, list)
    ((limit, braking),) = {(axis["velocity_limit"], axis["quick_stop_deceleration"]) for axis in axes}
    times = (bus["host_timeout"], BusProfile.model_fields["host_timeout"].default)
    rows = [tuple(map(float, row)) for row in SPEED.findall((root / PAGE).read_text("utf-8"))]
    assert [speed for speed, *_ in rows][1:] == [PlanRequest.model_fields["move_velocity"].default, limit]
    for speed, *told in rows:
        assert told == pytest.approx([speed * time + speed**2 / (2 * braking) for time in times], abs=5e-4)


def test_what_the_threat_model_names_is_there(root: Path) -> None:
    page = (root / THREATS).read_text("utf-8")
    named = re.findall(r"`((?:service|tests)/[\w/.]+)`", page)
    assert len(named) > 10
    assert [name for name in named if not (root / name).exists()] == []
    rows = re.findall(r"^\| CR [^|]+\| ([^|]+) \|", page, re.MULTILINE)
    assert len(rows) > 30
    assert set(rows) <= VERDICTS


def test_who_finds_something_is_told_where_to_go(root: Path) -> None:
    page = (root / "SECURITY.md").read_text("utf-8")
    for title in ("How to report", "Supported versions", "What is promised"):
        assert f"## {title}\n" in page
