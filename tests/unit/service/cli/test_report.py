"""`sweepid report` of what lies in files."""

import csv
import json
from pathlib import Path

import pytest
from pypdf import PdfReader

from tests.command import refused, sweepid
from tests.programs import needs

pytestmark = pytest.mark.slow

STORED = Path(__file__).resolve().parents[3] / "stored"


@needs("pango")
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("estimate", ("Not confirmed.", "Inertia of the axes, sweep by sweep", "Base parameters")),
        ("estimate-free-motion", ("Sweeps and trajectories together",)),
        ("analysis", ("Initial analysis", "Figure 1.", "locked rotor in Hz")),
        ("diagnosis-named", ("the model lacks Coulomb friction", "The rigid model", "noise floor")),
        ("diagnosis-open", ("What to measure next", "noise floor")),
    ],
)
def test_every_result_has_a_report(name: str, words: tuple[str, ...], tmp_path: Path) -> None:
    result = STORED / f"{name}.json"
    page, pdf, tables = tmp_path / "a.html", tmp_path / "a.pdf", tmp_path / "tables"
    done = sweepid("report", str(result), str(page), "--pdf", str(pdf), "--tables", str(tables))
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{page}\n{pdf}\n{tables}\n", "")
    text = " ".join(" ".join(one.extract_text() for one in PdfReader(pdf).pages).split())
    html = page.read_text("utf-8")
    for word in words:
        assert word in text
        assert word.rstrip(".") in html or word.startswith("Figure")  # figures have numbers on paper
    assert "SHA-256" in text
    stored = json.loads((tables / "tables.json").read_text("utf-8"))["tables"]
    files = sorted(tables.glob("*.csv"))
    assert len(files) == len(stored) > 0
    for file, table in zip(files, stored, strict=True):
        assert list(csv.reader(file.read_text("utf-8").splitlines())) == [table["head"], *table["rows"]]


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("{}", "is not a result of `sweepid identify --json` or `sweepid diagnose --json`"),
        ('{"axes": {"a": {"verdict": 3}}}', "axes"),
        ("no JSON", "cannot be read as JSON"),
        ('{"axes": 7}', "axes"),
    ],
)
def test_what_is_no_result_is_refused(content: str, told: str, tmp_path: Path) -> None:
    file = tmp_path / "result.json"
    file.write_text(content)
    assert told in refused("report", str(file), str(tmp_path / "report.html"))
    assert not (tmp_path / "report.html").exists()


def test_a_report_needs_somewhere_to_go(tmp_path: Path) -> None:
    done = sweepid("report", str(STORED / "estimate.json"))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "sweepid: FILE: is missing: name a file, or one with --pdf, or a folder with --tables\n"
    assert "nothing.json" in refused("report", str(STORED / "nothing.json"), str(tmp_path / "report.html"))
