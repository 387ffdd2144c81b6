"""What a page may still say of the machine (`fresh.js`, under Node.js)."""

import json
import shutil
import subprocess
from importlib.resources import files
from pathlib import Path

import pytest

from tests.npm import NODE

RUN = """import { asOf } from "./fresh.mjs";
console.log(JSON.stringify(asOf(...JSON.parse(process.argv[2]))));"""


@pytest.mark.parametrize(
    ("state", "age", "waited", "said"),
    [
        ("stands", 0.1, 0.0, "stands"),
        ("stands", 0.1, 2.8, "stands"),
        ("stands", 0.1, 3.0, "unknown"),  # the drives were asked 0.1 s before, the answer took 3 s
        ("stands", 1.9, 1.2, "unknown"),
        ("moves", 1.9, 1.2, "unknown"),
        ("stands", None, 0.0, "unknown"),
        ("unknown", None, 0.0, "unknown"),
        (None, None, 0.0, "unknown"),
    ],
)
def test_the_whole_time_since_the_drives_were_asked_counts(
    tmp_path: Path, state: str | None, age: float | None, waited: float, said: str
) -> None:
    """`waited`: s since the page sent its request."""
    shutil.copy(str(files("service.web.hmi") / "static" / "fresh.js"), tmp_path / "fresh.mjs")
    (tmp_path / "run.mjs").write_text(RUN, "utf-8")
    statement: dict[str, object] = {"state": state, "age": age, "reason": "why", "axes": {}}
    report = {"statement": statement, "asked": 5000.0} if state else None
    given = json.dumps([report, 5000.0 + 1000.0 * waited])
    run = subprocess.run([NODE, tmp_path / "run.mjs", given], capture_output=True, check=True, timeout=60)
    answer = json.loads(run.stdout)
    assert answer["state"] == said
    assert answer["reason"] == ("why" if state == said else "")
    assert answer["age"] == (None if age is None else pytest.approx(age + waited))
