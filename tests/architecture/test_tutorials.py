"""What the tutorials name as hidden is what the program hides, and what they tell of it agrees with it."""

import json
import re
from pathlib import Path

import pytest

from tests.command import sweepid


def test_the_hidden_effect_is_the_one_of_the_tutorial(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (root / "docs" / "tutorials" / "find-a-hidden-effect.md").read_text("utf-8")
    command = re.search(r"^sweepid (drive truth .*)$", page, re.MULTILINE)
    assert command
    monkeypatch.chdir(root)
    done = sweepid(*command[1].split())
    assert (done.returncode, done.stderr) == (0, "")
    told = re.search(r"prints `(\{.*?)\.\.\.\}\}`", page)
    assert told
    assert done.stdout.startswith(told[1])  # as many digits as the page has
    truth = json.loads(done.stdout)
    assert f'"hidden_in": "{truth["joint"]}"' in page
    measured = re.search(r"the diagnosis said ([\d.]+) ± ([\d.]+) N m", page)
    assert measured
    assert f"`coulomb: {measured[1]}`" in page
    assert abs(float(measured[1]) - truth["parameters"]["coulomb"]) < 2 * float(measured[2])


@pytest.mark.parametrize("name", ["first-campaign", "find-a-hidden-effect"])
def test_every_file_that_a_tutorial_names_is_there(name: str, root: Path) -> None:
    page = (root / "docs" / "tutorials" / f"{name}.md").read_text("utf-8")
    files = set(re.findall(r"\bconfig/[\w./-]+", page))
    assert files
    assert [file for file in sorted(files) if not (root / file).exists()] == []
