"""Documents that come back from a file: whatever stands in it, one BadInput says why it is none."""

import json
from pathlib import Path
from typing import Any

import pytest

from service import BadInput
from service.cli.commands.campaigns import plan_number
from service.model.results.estimate import Estimate
from sweepid.files import read_document

ESTIMATE = Path(__file__).parents[3] / "stored/estimate.json"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "cannot be read as JSON"),
        ("[1]", "is not a JSON object"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a": ' + "9" * 5000 + "}", "cannot be read as JSON"),
        ('{"axes": {' + ",".join(f'"{key}": 0' for key in range(500_001)) + "}}", "has more than 500000 values"),
        ("[" + "[]," * (2**25 // 3) + "[]]", "is larger than 33554432 bytes"),
    ],
)
def test_what_is_no_document(text: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "estimate.json"
    path.write_text(text, "utf-8")
    with pytest.raises(BadInput, match=told):
        read_document(path, Estimate)


@pytest.mark.parametrize(
    ("path", "value", "told"),
    [
        (("axes", "joint_2", "inertia", 0, "value"), 1e308, "less than or equal to 1000000000000000, got 1e\\+308"),
        (("axes", "joint_2", "inertia", 0, "identified"), float("nan"), "finite number, got nan"),
        (("base_parameters", 0, "value"), -1e300, r"base_parameters.0.value: .*got -1e\+300"),
        (("standard_parameters", "motor_inertias", "Jm(joint_1)"), 1e308, "motor_inertias.*got 1e"),
    ],
)
def test_numbers_that_no_robot_has_are_refused_at_the_border(
    path: tuple[str | int, ...], value: object, told: str, tmp_path: Path
) -> None:
    document: Any = json.loads(ESTIMATE.read_text("utf-8"))
    *way, last = path
    holder = document
    for key in way:
        holder = holder[key]
    holder[last] = value
    file = tmp_path / "estimate.json"
    file.write_text(json.dumps(document), "utf-8")
    with pytest.raises(BadInput, match=told):
        read_document(file, Estimate)


@pytest.mark.parametrize("text", ["[" * 100_000, '{"id": Infinity}', '{"id": null}', "7"])
def test_what_is_no_plan(text: str, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    path.write_text(text, "utf-8")
    with pytest.raises(BadInput, match="is not a plan"):
        plan_number(str(path))


def test_a_plan_file_has_a_limit_of_size(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    with path.open("wb") as file:
        file.truncate(2**26 + 1)
    with pytest.raises(BadInput, match="is larger than 67108864 bytes"):
        plan_number(str(path))
