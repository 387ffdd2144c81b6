"""What a person reads after STOP, from the answers of two ways (`pressed.js`, under Node.js)."""

import json
import shutil
import subprocess
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

from tests.npm import NODE

SCRIPT = Path(__file__).parents[3] / "virtual_time" / "page.mjs"
Answer = dict[str, Any]


def answer(way: str, at: float, *confirmed: str, **unconfirmed: str) -> Answer:
    """`at`: s after the press."""
    body = {"confirmed": confirmed, "unconfirmed": unconfirmed}
    return {"way": way, "at": at, "status": 503 if unconfirmed else 200, "body": body}


@pytest.mark.parametrize(
    ("answers", "read", "axes"),
    [
        ([], "stop.late", []),
        ([answer("port", 0.2, "joint_1", "joint_2")], "stop.confirmed", []),
        ([answer("port", 1.0, "joint_1", joint_2="silent")], "stop.unconfirmed", ["joint_2"]),
        (
            [answer("port", 1.0, "joint_1", joint_2="silent"), answer("api", 1.0, joint_1="late", joint_2="late")],
            "stop.unconfirmed",
            ["joint_2"],
        ),
        (
            [answer("api", 1.0, joint_1="late", joint_2="late"), answer("port", 1.1, "joint_1", "joint_2")],
            "stop.confirmed",
            [],
        ),
        (
            [answer("api", 1.0, "joint_2", joint_1="late"), answer("port", 1.0, "joint_1", joint_2="late")],
            "stop.confirmed",
            [],
        ),
        ([{"way": "api", "at": 0.1, "status": 403, "body": {"detail": "no"}}], "stop.refused", []),
    ],
)
def test_an_axis_that_a_way_confirmed_is_not_named(
    tmp_path: Path, answers: list[Answer], read: str, axes: list[str]
) -> None:
    module, presses, place = tmp_path / "pressed.mjs", tmp_path / "presses.json", tmp_path / "told.json"
    shutil.copy(str(files("service.web.hmi") / "static" / "pressed.js"), module)
    presses.write_text(json.dumps([{"until": 1.2, "answers": answers}]), "utf-8")
    subprocess.run([NODE, SCRIPT, module, presses, place], check=True, timeout=60)
    (told,) = json.loads(place.read_text("utf-8"))
    assert told[-1] == {"at": 1.2, "text": read, "axes": axes}
    assert all(now["text"] == "stop.sent" for now in told if now["at"] < min([1.0, *(each["at"] for each in answers)]))
