"""The habits of a well-kept repository that no tool checks: versions and decisions are told."""

import re
import tomllib
from pathlib import Path

import pytest

DECISIONS = Path(__file__).resolve().parents[2] / "docs/explanation/decisions"
RECORDS = sorted(DECISIONS.glob("[0-9]*.md"))
FORM = re.compile(
    r"# (?P<number>\d{4}) .+\n\nDate: (?P<date>\d{4}-\d\d-\d\d)\. "
    r"Status: (in force\.|replaced( in part)?\b.*?\((?P<by>\d{4})-)"
)


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.stem)
def test_a_decision_has_number_date_and_status(record: Path) -> None:
    """A replaced one names the one that replaces it."""
    found = FORM.match(record.read_text("utf-8"))
    assert found is not None, "begins with: # NNNN Title, an empty line, Date: YYYY-MM-DD. Status: in force."
    assert found["number"] == record.stem[:4]
    if found["by"]:
        assert [other.stem[:4] for other in RECORDS].count(found["by"]) == 1


def test_decisions_are_numbered_without_gaps_and_in_order_of_their_dates() -> None:
    assert [int(record.stem[:4]) for record in RECORDS] == list(range(1, len(RECORDS) + 1))
    dates = [found["date"] for record in RECORDS if (found := FORM.match(record.read_text("utf-8")))]
    assert dates == sorted(dates)


def test_every_decision_is_in_the_list() -> None:
    listed = re.findall(r"^- \[\d{4} .+\]\((.+)\)$", (DECISIONS / "README.md").read_text("utf-8"), re.MULTILINE)
    assert listed == [record.name for record in RECORDS]


def test_the_changelog_begins_with_the_version_that_this_is(root: Path) -> None:
    version = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    told = re.findall(r"^## (\S+) \(\d{4}-\d\d-\d\d\)$", (root / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert told[0] == version
    assert told == sorted(told, key=lambda text: [int(part) for part in text.split(".")], reverse=True)
