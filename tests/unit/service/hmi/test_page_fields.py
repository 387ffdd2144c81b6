"""Each field that a script of the pages reads of an answer is one of docs/reference/openapi.json."""

import re
from pathlib import Path

import pytest

from tests.page_types.compiler import check
from tests.unit.service.hmi.page_words import SCRIPTS

pytestmark = pytest.mark.slow

# one field that each script reads of an answer of the API
READ = {
    "api.js": "detail",
    "app.js": "remaining",
    "approval.js": "sha256",
    "axes.js": "emergency_stop",
    "commands.js": "latched",
    "diagnosis.js": "next_experiment",
    "experiment.js": "approved_by",
    "figures.js": "sentences",
    "findings.js": "sentence",
    "fleet.js": "measured_at",
    "intent.js": "within_s",
    "live.js": "robot_id",
    "login.js": "refused",
    "machine.js": "stops",
    "motion.js": "urdf_text",
    "moving.js": "check_move",
    "oidc.js": "url",
    "picture.js": "floor",
    "plan.js": "expected_time",
    "record.js": "accepted_by",
    "results.js": "confidence_percent",
    "statement.js": "reason",
    "stop.js": "unconfirmed",
    "subject.js": "missing",
    "verdicts.js": "alternatives",
    "wayout.js": "emergency_stop",
}
# they know no answer
NONE = {
    "causes.js",
    "drawing.js",
    "elements.js",
    "events.js",
    "following.js",
    "plots.js",
    "pressed.js",  # what the ways of STOP answer, in types of its own
    "refresh.js",
    "stream.js",
    "words.js",
}


def test_each_field_is_one_of_the_api(tmp_path: Path) -> None:
    assert check(SCRIPTS, tmp_path) == []


def planted(script: str, field: str) -> str:
    """The script with the first reading of that field misspelt, as `created_at` was for `at`."""
    code = re.compile(rf"(?m)^(?!\s*/?\*)(?:(?!//).)*?(?:[.{{]\s*|, ){field}\b")
    found = code.search(script)
    assert found, field
    return f"{script[: found.end()]}_planted{script[found.end() :]}"


def test_a_wrong_field_is_found_in_each_script(tmp_path: Path) -> None:
    assert {*READ} | NONE == {*SCRIPTS}
    wrong = SCRIPTS | {name: planted(SCRIPTS[name], field) for name, field in READ.items()}
    found = {one.file for one in check(wrong, tmp_path) if "_planted" in one.text}
    assert {*READ} - found == set()


def test_a_field_of_a_value_without_a_type_is_found(tmp_path: Path) -> None:
    """The compiler alone lets it pass."""
    code = "export function shown(one) { return one.created_at; }\n"
    found = check({"planted.js": code}, tmp_path)
    assert [(one.file, one.line, one.text) for one in found] == [
        ("planted.js", 1, "a field of a value without a type: one.created_at")
    ]
