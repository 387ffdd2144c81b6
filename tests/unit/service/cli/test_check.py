"""`sweepid check` as a person and as a program call it."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from service.model import Sweep
from service.store.files.bundle import write_bundle
from tests.command import carried_out
from tests.unit.service.data_check.conftest import lift_sweep, pair


@pytest.fixture
def reversed_torque(tmp_path: Path) -> Path:
    sweeps = [lift_sweep(number, repeat=number) for number in range(2)]
    turned = [Sweep(s.spec, replace(s.recording, effort=-s.recording.effort)) for s in sweeps]
    write_bundle(tmp_path / "bundle", pair(), turned)
    return tmp_path / "bundle"


def test_a_table_for_people_or_json_alone_and_zero_whatever_was_found(reversed_torque: Path) -> None:
    told = carried_out("check", str(reversed_torque))
    for word in ("Check of 2 sweeps", "effort_sign", "wrong"):
        assert word in told
    document = json.loads(carried_out("check", str(reversed_torque), "--json", "-"))
    assert [one["code"] for one in document["findings"]] == ["effort_sign"]
    assert document["axes"]["lift"] == {"sweeps": 2, "trustworthy": False, "codes": ["effort_sign"]}


def test_nothing_found_is_said(tmp_path: Path) -> None:
    write_bundle(tmp_path / "bundle", pair(), [lift_sweep(1)])
    assert "Nothing found in 1 sweep." in carried_out("check", str(tmp_path / "bundle"))
