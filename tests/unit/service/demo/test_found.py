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
    assert diagnosed.description == "coulomb friction (coulomb 48.79)"


def fitted(hidden: str, value: float, std: float) -> Found:
    """A diagnosis without a gap, whose model has one link parameter of CAD's 37.8 kg m and viscous friction."""
    parameters = [
        {"name": "mx(link_3)", "nominal": 37.8, "value": value, "std": std},
        {"name": "viscous_friction", "nominal": 90.0, "value": 194.0, "std": 0.1},
    ]
    axis = axis_document((), verdict="none", candidates=[], rigid_model=parameters)
    return Found(
        "joint_3", diagnosis_document(joint_3=axis), (), None, {"joint": "joint_3", "effect": hidden, "parameters": {}}
    )


def test_a_gravity_error_within_cads_uncertainty_is_told_as_fitted() -> None:
    assert fitted("gravity_error", 43.56, 0.54).judgement == (
        "Not named, but fitted: it is as small as CAD's own uncertainty. mx(link_3) is 43.56 +/- 0.54, CAD says 37.8."
    )


@pytest.mark.parametrize(
    "diagnosed", [fitted("gravity_error", 39.0, 0.54), fitted("hose_spring", 43.56, 0.54)], ids=["chance", "other"]
)
def test_what_the_link_parameters_do_not_show_is_not_found(diagnosed: Found) -> None:
    assert diagnosed.judgement == "Not found: the verdict is none."
