"""`sweepid demo`: its operator leaves a stop to a person, and what it says of a diagnosis does not flatter."""

from collections.abc import Iterator
from typing import Any, cast

import pytest

from service.cli.demo import Found
from service.cli.virtual_cell import CampaignFailed, Operator
from service.web.client import HOST_WATCH, Json, ServiceClient, ServiceProblem
from tests.stored.documents import axis_document, diagnosis_document


class Client:
    """A service whose campaign goes through `states`; a pause has a cause, a stop or a fault."""

    def __init__(self, states: list[str], stopped_by: str) -> None:
        self.states, self.stopped_by = states, stopped_by
        self.did: list[Any] = []

    def start(self, campaign: int) -> None:
        self.did.append(("start", campaign))

    def events(self, campaign: int) -> Iterator[int]:
        yield from range(len(self.states))

    def campaign(self, campaign: int) -> Json:
        return {"state": self.states.pop(0), "cause": "the host was suspended for 3.0 s"}

    def stops(self) -> list[Json]:
        return [{"id": 7, "by": self.stopped_by}, {"id": 8, "by": HOST_WATCH}]

    def reset_stop(self, by: str, stops: list[int]) -> None:
        self.did.append(("release", stops))

    def drives(self) -> Json:
        return {"axes": [{"joint": "joint_1", "fault": None}, {"joint": "joint_2", "fault": "2310h"}]}

    def acknowledge(self, joint: str) -> None:
        self.did.append(("acknowledge", joint))

    def resume(self, campaign: int, *, repeat: bool) -> None:
        if self.stopped_by != HOST_WATCH:
            raise ServiceProblem(409, f"stopped by {self.stopped_by}: a noise")
        self.did.append(("resume", campaign, repeat))

    def stop(self, by: str, why: str) -> None:
        self.did.append(("stop", by, why))


STOP = ("stop", "sweepid demo", "CampaignFailed")
CLEARED = [("release", [7, 8]), ("acknowledge", "joint_2"), ("resume", 1, True)]


@pytest.mark.parametrize(
    ("states", "stopped_by", "did", "ends"),
    [
        (["running", "completed"], HOST_WATCH, [], ""),
        (["paused", "running", "completed"], HOST_WATCH, CLEARED, ""),
        (["paused"], "Ada", [("release", [8]), ("acknowledge", "joint_2"), STOP], "cannot go on: .*by Ada: a noise"),
        (["aborted"], HOST_WATCH, [STOP], "campaign 1 was aborted: the host was suspended"),
        (["paused"] * 4, HOST_WATCH, [*CLEARED * 3, STOP], "paused for the 4th time: the host was suspended"),
    ],
    ids=["to its end", "suspended", "stopped by a person", "aborted", "too many faults"],
)
def test_what_it_clears_and_what_it_leaves_to_a_person(
    states: list[str], stopped_by: str, did: list[Any], ends: str
) -> None:
    client, notes, pauses = Client(list(states), stopped_by), list[str](), min(states.count("paused"), 3)
    operator = Operator(cast("ServiceClient", client), progress=lambda _: None, say=notes.append)
    if ends:
        with pytest.raises(CampaignFailed, match=ends):
            operator.run(1)
    else:
        operator.run(1)
    assert client.did == [("start", 1), *did]
    assert notes == ["the host was suspended for 3.0 s - checked, acknowledged, sweep repeated"] * pauses


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
            "Wrong: Coulomb friction, hose spring was named.",
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
    unit = " N m" if diagnosed.axis.effects else ""
    assert diagnosed.description == f"Coulomb friction (Coulomb 48.79{unit})"


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
