"""What holds for the house as a whole: its rooms, its lock, its container files, its version."""

import importlib
import re
import tomllib
from importlib.metadata import metadata
from pathlib import Path
from typing import Any

import pytest

ROOMS = ("sweepid", "service", "drivers", "simulator")


@pytest.fixture(scope="module")
def project(root: Path) -> dict[str, Any]:
    return tomllib.loads((root / "pyproject.toml").read_text())


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_is_the_one_of_this_checkout(root: Path, room: str) -> None:
    """The names are generic: another distribution's package of that name must not be imported in its place."""
    assert importlib.import_module(room).__file__ == str(root / room / "__init__.py")


def test_the_distribution_is_for_its_own_environment() -> None:
    assert "Private :: Do Not Upload" in (metadata("sweepid").get_all("Classifier") or [])


def test_no_lock_names_a_host(root: Path) -> None:
    text = (root / "requirements.lock").read_text()
    assert re.findall(r"\S*://\S*|--(?:extra-)?index-url.*|--find-links.*", text) == []
    locks = list((root / "tests").glob("*/package-lock.json"))
    assert len(locks) == 3
    assert [path for path in locks if "://" in path.read_text("utf-8")] == []


def test_the_lock_has_all_that_pyproject_asks_for(root: Path, project: dict[str, Any]) -> None:
    locked = set(re.findall(r"^([a-z0-9-]+)(?:\[[a-z,]+\])?==", (root / "requirements.lock").read_text(), re.MULTILINE))
    groups = project["dependency-groups"]
    wanted = [*project["project"]["dependencies"], *project["project"]["optional-dependencies"]["pdf"]]
    wanted += [each for group in groups.values() for each in group if isinstance(each, str)]
    names = {re.split(r"[^A-Za-z0-9-]", requirement)[0].lower() for requirement in wanted}
    assert names - locked == set(), "run: make lock"


def test_the_image_is_built_of_what_there_is(root: Path) -> None:
    """Every file that the Dockerfile copies from here exists and passes .dockerignore."""
    allowed = {line[1:] for line in (root / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = re.findall(r"^COPY (?!--from)(.+) \S+$", (root / "Dockerfile").read_text(), re.MULTILINE)
    names = {name for names in copied for name in names.split()}
    assert names == allowed
    assert all((root / name).exists() for name in names)


def test_docker_and_docker_compose_build_on_one_base(root: Path) -> None:
    default = re.findall(r"^ARG BASE=(\S+)$", (root / "Dockerfile").read_text(), re.MULTILINE)
    assert re.findall(r"\$\{SWEEPID_BASE:-(\S+)\}", (root / "docker-compose.yml").read_text()) == default != []


def test_the_changelog_begins_with_the_version_that_this_is(root: Path, project: dict[str, Any]) -> None:
    told = re.findall(r"^## (\S+) \(\d{4}-\d\d-\d\d\)$", (root / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert told[0] == project["project"]["version"]
