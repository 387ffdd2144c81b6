"""Twelve machines of a plant that shares no code with the service: names, verdicts and gaps as their truth says."""

import json
from pathlib import Path
from typing import Any

import pytest

from service.diagnosis import axis_document, diagnose_axis
from service.diagnosis.effects import CATALOGUE
from service.store.files.bundle import read_bundle

AT_FLOOR = 1.5  # times the noise floor: most that may be left where all is named


@pytest.mark.parametrize("number", [f"{k:02}" for k in range(1, 13)])
def test_what_a_foreign_machine_hides_is_found(number: str, shared: Path) -> None:
    truth = json.loads((shared / "data/foreign/truth.json").read_text())[number]
    bundle = read_bundle(shared / "data/foreign" / number)
    found: Any = axis_document(diagnose_axis(bundle.robot, truth["axis"], bundle.sweeps, twin=False)).as_json()
    named, hidden = {effect["effect"] for effect in found["effects"]}, set(truth["hidden"])
    if not hidden <= set(CATALOGUE):  # nobody can name what is in no catalogue
        assert (found["verdict"], named) == ("unknown", set())
        return
    undecided = "payload" in hidden  # a torque gain would do the same
    assert found["verdict"] == ("ambiguous" if undecided else "named" if hidden else "none")
    assert hidden <= named <= hidden | set(truth["companions"])
    if undecided:
        assert found["next_experiment"]["kind"] == "test_mass"
    assert found["gap"]["after_rms"] <= AT_FLOOR * found["gap"]["noise_floor_rms"]
