"""The documents say what is so: commands and targets exist, links lead somewhere, marked snippets run.

A fenced block after ``<!-- run -->`` is executed: ``console`` line by line (``$ command``; the other lines must appear
in its output), ``python`` as a script. Both start in an empty folder with the project's ``config`` in it.
"""

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import pytest

from service.cli import build
from service.cli.commands.campaigns import tell_plan
from service.cli.virtual_cell import CELL, ROBOT
from service.formats.traces.trace_import import Mapping
from service.model.configuration import read_cell, read_robot, read_yaml
from service.planning.campaigns.stored_plan import planned_times
from service.planning.documents import PlanRequest
from service.planning.plan import build_plan
from service.store.documents import PlanRecord
from service.web.api.campaigns import expected_time

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
BLOCK = re.compile(r"(<!-- run -->\n+)?^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    place: str
    run: bool
    kind: str
    text: str


def blocks() -> list[Block]:
    return [
        Block(
            f"{path.relative_to(ROOT)}:{text[: found.start()].count(chr(10)) + 1}", bool(found[1]), found[2], found[3]
        )
        for path in DOCUMENTS
        for text in [path.read_text()]
        for found in BLOCK.finditer(text)
    ]


@pytest.fixture
def desk(tmp_path: Path) -> Path:
    (tmp_path / "config").symlink_to(ROOT / "config")
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("block", [pytest.param(block, id=block.place) for block in blocks() if block.run])
def test_a_marked_snippet_runs(block: Block, desk: Path) -> None:
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    if block.kind == "python":
        done = subprocess.run([sys.executable, "-c", block.text], cwd=desk, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        return
    assert block.kind == "console", f"{block.kind} cannot be run"
    output = ""
    for line in block.text.splitlines():
        if line.startswith("$ "):
            done = subprocess.run(
                line[2:], shell=True, cwd=desk, env=environment, capture_output=True, text=True, timeout=120
            )
            assert done.returncode == 0, done.stderr
            output = done.stdout + done.stderr
        else:
            assert line in output


def commands() -> list[str]:
    """Every command line that a document shows."""
    shell = [block for block in blocks() if block.kind in ("console", "sh", "bash", "powershell")]
    lines = (line for block in shell for line in block.text.replace("\\\n", " ").splitlines())
    return [line.removeprefix("$ ").strip() for line in lines if line.strip()]


def test_every_command_and_option_shown_exists() -> None:
    options = {name: {word for one in command.params for word in one.opts} for name, command in build().every()}
    names = set(options)
    command = re.compile(r"(?:\S*/|\w+=\$\()?sweepid ([a-z][a-z-]*)(?: ([a-z][a-z-]*)(?![\w./-]))?")
    shown = [(match[1], match[2]) for line in commands() if (match := command.match(line))]
    assert shown
    assert {words for words in shown if words[0] not in names and " ".join(map(str, words)) not in names} == set()
    for line in commands():
        for name, rest in re.findall(r"\bsweepid ([a-z][a-z-]*(?: [a-z][a-z-]*)?)([^|;&#]*)", line):
            known = options.get(name) or options.get(name.partition(" ")[0])
            if known is not None:
                assert set(re.findall(r"(?<=\s)--[a-z][a-z-]*", rest)) <= known | {"--help"}, line


def test_every_make_target_shown_exists() -> None:
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    shown = {match[1] for line in commands() if (match := re.match(r"make ([a-z-]+)", line))}
    assert shown >= {"demo", "test"}
    assert shown - targets == set()


def test_make_demo_tells_what_it_installs() -> None:
    """What takes minutes shows its progress: it is told before it begins, and uv is not quiet."""
    words = ["make", "--dry-run", "--always-make", "--no-print-directory", "demo"]
    told = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    first, _, after = told.partition("-m venv")
    assert "echo 'Installing into .venv, once; this takes a minute or two.'" in first
    (install,) = [line for line in after.splitlines() if "uv pip install" in line]
    assert "--quiet" not in install
    assert told.splitlines()[-1].split() == [".venv/bin/sweepid", "demo", "--out", "demo-out"]


@pytest.mark.parametrize("budget", [{"confidence": 0.5}, {"poses": 7}])
def test_the_guide_tells_of_a_plan_what_the_command_prints(
    budget: dict[str, float], capsys: pytest.CaptureFixture[str]
) -> None:
    axes = ("joint_1", "joint_2", "joint_3")
    wanted = PlanRequest.model_validate({"robot_id": 1, "axes": axes, "varied": axes[1:], **budget})
    made = build_plan(read_robot(ROOT / ROBOT), wanted, read_cell(ROOT / CELL)).model_dump(mode="json")
    stored = PlanRecord(id=1, robot_id=1, document=made, created_at=datetime.now(UTC))
    tell_plan(made, expected_time(planned_times(stored)))
    told = capsys.readouterr().err
    assert f"```text\n{told}```" in (ROOT / "docs/how-to/plan-a-campaign.md").read_text("utf-8"), told


def test_links_between_documents_lead_somewhere() -> None:
    broken = [
        f"{path.relative_to(ROOT)}: {target}"
        for path in DOCUMENTS
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", path.read_text())
        if not (path.parent / target).exists()
    ]
    assert broken == []


def test_the_readme_opens_with_the_two_commands() -> None:
    first = next(block for block in blocks() if block.place.startswith("README.md"))
    assert [line.split("#")[0].removeprefix("$ ").strip() for line in first.text.splitlines()] == [
        "make demo",
        "make test",
    ]


@pytest.mark.parametrize("path", sorted((ROOT / "config/robots").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_example_robot_is_one(path: Path) -> None:
    assert read_robot(path).name == path.stem


@pytest.mark.parametrize("path", sorted((ROOT / "config/traces").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_example_mapping_is_one(path: Path) -> None:
    assert read_yaml(path, Mapping).sweeps


PICTURE = re.compile(r"!\[([^\]]+)\]\(([^)\s]+\.png)\)")  # its text in words, and its file
LARGEST_PICTURE = 150_000  # bytes


def test_every_picture_is_shown_with_words_and_small() -> None:
    """A picture that no page shows is out of date unnoticed; one without words is nothing to who cannot see it."""
    shown = {
        (path.parent / place).resolve(): words
        for path in DOCUMENTS
        for words, place in PICTURE.findall(path.read_text("utf-8"))
    }
    pictures = {path: path.stat().st_size for path in (ROOT / "docs" / "images").iterdir()}
    assert set(pictures) == set(shown)
    assert {path.name: size for path, size in pictures.items() if size > LARGEST_PICTURE} == {}
    assert [path.name for path, words in shown.items() if len(words.split()) < 4] == []


def test_decisions_have_number_date_and_status_and_are_in_the_list() -> None:
    """One that is replaced in part names the one that replaces it; replaced completely, it is gone with its number."""
    folder = ROOT / "docs/explanation/decisions"
    records = sorted(folder.glob("[0-9]*.md"))
    form = re.compile(
        r"# (\d{4}) .+\n\nDate: \d{4}-\d\d-\d\d\. Status: (?:in force\.|replaced(?: in part)?\b.*?\((\d{4})-)"
    )
    for record in records:
        found = form.match(record.read_text("utf-8"))
        assert found, f"{record.name} begins with: # NNNN Title, an empty line, Date: YYYY-MM-DD. Status: in force."
        assert found[1] == record.name[:4]
        assert found[2] is None or list(folder.glob(f"{found[2]}-*.md")), f"{record.name}: no record {found[2]}"
    assert len({record.name[:4] for record in records}) == len(records) > 0
    listed = re.findall(r"^- \[\d{4} .+\]\((.+)\)$", (folder / "README.md").read_text("utf-8"), re.MULTILINE)
    assert listed == [record.name for record in records]
