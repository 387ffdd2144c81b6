"""What is stored today is read, and comes out byte for byte; what is not a result is refused by place and field."""

import json
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from service import BadInput
from service.diagnosis import experiments, verdict
from service.model.results.diagnosis import TEST_MASS, AxisDiagnosis, Bin, Cell, DataCheck, Diagnosis, Verdict
from service.model.results.effect import ModelRevision
from service.model.results.estimate import Estimate
from service.model.results.part import Document
from service.model.results.payload import Payload
from service.model.results.sheet import Sheet
from tests.stored.documents import stored

KINDS: dict[str, type[Document]] = {
    **dict.fromkeys(("analysis", "estimate", "estimate-free-motion"), Estimate),
    **dict.fromkeys(("check", "check-wrong"), DataCheck),
    **dict.fromkeys(("diagnosis-named", "diagnosis-open"), Diagnosis),
    **{"model": ModelRevision, "payload": Payload, "sheet": Sheet},
}
LATER = {"part", "changes", "alternatives", "started_from", "rigid_model", "unexplained", "data", "visible_in"}
"""Keys of an axis that documents of before did not have."""


def canonical(document: object) -> str:
    return json.dumps(document, sort_keys=True, separators=(",", ":"))


def unnamed(value: object) -> set[str]:
    """Keys, at any depth, that a model kept without describing them."""
    if isinstance(value, BaseModel):
        parts = (getattr(value, key) for key in type(value).model_fields)
        return set(value.model_extra or {}).union(*map(unnamed, parts))
    if isinstance(value, dict):
        return set().union(*map(unnamed, value.values()))
    return set().union(*map(unnamed, value)) if isinstance(value, tuple) else set()


def test_every_stored_document_has_its_model(root: Path) -> None:
    assert {path.stem for path in (root / "tests" / "stored").glob("*.json")} == set(KINDS)


@pytest.mark.parametrize("name", KINDS)
def test_a_stored_document_comes_out_as_it_went_in_and_has_no_key_without_a_name(name: str) -> None:
    found = KINDS[name].read(stored(name), name)
    assert canonical(found.as_json()) == canonical(stored(name))
    assert unnamed(found) == set()


def test_words_of_mathematics_and_of_its_results_are_the_same() -> None:
    assert get_args(Verdict) == tuple(one.value for one in verdict.Verdict)
    assert experiments.TEST_MASS == TEST_MASS


def test_older_documents_are_read() -> None:
    axis = stored("diagnosis-named")["axes"]["joint_1"]
    older = {key: value for key, value in axis.items() if key not in LATER}
    older["gap"] = {key: axis["gap"][key] for key in axis["gap"] if key not in ("cross_validated", "twin_rms")}
    older["fit"] = {key: axis["fit"][key] for key in axis["fit"] if key not in ("gravity", "torques")}
    found = AxisDiagnosis.read(older, "axis")
    assert (found.started_from, found.gap.cross_validated, found.fit.torques) == ("cad", False, "recorded")
    assert canonical(found.as_json()) == canonical(older)


def test_trajectories_of_single_periods_have_no_scatter() -> None:
    document = stored("estimate-free-motion")
    document["combination"]["noise"] = {"joint_1": {"harmonic": 0.5, "scatter": None}}
    found = Estimate.read(document, "estimate")
    assert found.combination is not None
    assert found.combination.noise["joint_1"].scatter is None
    assert found.as_json() == document


def test_keys_that_nobody_described_are_kept() -> None:
    document = stored("check") | {"tomorrow": {"n": 1}}
    assert DataCheck.read(document, "check").as_json() == document


GAP = stored("diagnosis-named")
GAP["axes"]["joint_1"]["gap"]["before_rms"] = "much"


@pytest.mark.parametrize(
    ("kind", "document", "told"),
    [
        (Diagnosis, GAP, r"^file 7\.axes\.joint_1\.gap\.before_rms"),
        (Diagnosis, [], "^file 7"),
        *((DataCheck, {"version": one}, r"^file 7\.version.*update sweepid") for one in (2, 0, "one", None)),
    ],
)
def test_what_is_no_result_is_refused_by_its_field(kind: type[Document], document: Any, told: str) -> None:
    with pytest.raises(BadInput, match=told):
        kind.read(document, "file 7")


@pytest.mark.parametrize(
    ("value", "found"),
    [
        ("0.1 to 0.2 rad/s", Bin(0.1, 0.2, "rad/s")),
        ("1e-12 to 0.1 rad/s2", Bin(1e-12, 0.1, "rad/s2")),
        ("-544 to -414 N m", Bin(-544, -414, "N m")),
        ("+0.10 rad", Bin(0.1, None, "rad")),
        ("17 Hz", Bin(17, None, "Hz")),
        ("3/8 turn", Bin(3, None, "turn", 8)),
        ("reversal", None),
        ("forward_slow of campaign 7", None),
        ("7", None),
        ("nan to 3 rad", None),
        ("1 to many rad", None),
        ("", None),
    ],
)
def test_a_cell_in_numbers(value: str, found: Bin | None) -> None:
    assert Cell(dimension="d", value=value, rms=1.0, significance=1.0, rms_after=1.0).bin == found
