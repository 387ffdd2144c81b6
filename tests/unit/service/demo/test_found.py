"""What the demo says of a diagnosis once it knows the truth: it does not flatter."""

import pytest

from service.demo.hidden import Found
from tests.stored.documents import axis_document, diagnosis_document


def found(verdict: str, named: list[str], candidates: list[str], model: int | None) -> Found:
    axis = axis_document(tuple(named), verdict=verdict, candidates=candidates)
    hidden = {"joint": "joint_3", "effect": "coulomb_friction", "parameters": {"coulomb": 48.7878}}
    return Found("joint_3", diagnosis_document(joint_3=axis), (), model, hidden)


@pytest.mark.parametrize(
    ("diagnosed", "judgement"),
    [
        (found("named", ["coulomb_friction"], [], 1), "Right; accepted as revision 1 of the model."),
        (found("named", ["coulomb_friction"], [], None), "Right; but not accepted."),
        (found("named", ["effort_offset"], [], 1), "Wrong: effort offset was named."),
        (
            found("named", ["coulomb_friction", "hose_spring"], [], 1),
            "Wrong: coulomb friction, hose spring was named.",
        ),
        (
            found("ambiguous", ["effort_offset"], ["coulomb_friction", "effort_offset"], None),
            "Not decided: it is among the candidates.",
        ),
        (found("unknown", [], [], None), "Not found: the verdict is unknown."),
    ],
)
def test_the_judgement(diagnosed: Found, judgement: str) -> None:
    assert diagnosed.judgement == judgement
    assert diagnosed.told == "coulomb friction (coulomb 48.79)"
