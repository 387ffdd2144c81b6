"""Documents that come back from a file: whatever stands in it, one BadInput says why it is none."""

from pathlib import Path

import pytest

from service.cli.campaign.measure import plan_number
from service.cli.documents import read_document
from service.errors import BadInput
from service.results.estimate import Estimate


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "cannot be read as JSON"),
        ("[1]", "is not a JSON object"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a": ' + "9" * 5000 + "}", "cannot be read as JSON"),
    ],
)
def test_what_is_no_document(text: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "estimate.json"
    path.write_text(text, "utf-8")
    with pytest.raises(BadInput, match=told):
        read_document(path, Estimate)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"id": Infinity}', '{"id": null}', "7"])
def test_what_is_no_plan(text: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.write_text(text, "utf-8")
    with pytest.raises(BadInput, match="is not a plan"):
        plan_number(str(path))
