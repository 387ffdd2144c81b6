"""The report of a campaign: its verdict, its origin, and what is drawn where nobody told the workspace."""

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from service.model import Robot
from service.model.results.diagnosis import DataCheck, Diagnosis, Finding
from service.model.results.estimate import BaseParameter, Estimate, not_for_use
from service.report.campaign import CONFIRMED, CONTRADICTED, OPEN, EstimateVerdict, campaign_page, verdict
from service.report.content import CampaignReport, Content, Drive, content_of
from tests.stored import documents
from tests.stored.documents import axis_document, stored
from tests.unit.service.report.test_report import content, estimate_page, sweep

SUSPECT = {"axis": "joint_1", "sweep": "0001", "why": "it is far off", "weight": 0.1}
SOUND = DataCheck(findings=(), axes={})
BRAKES = stored("check-wrong")["findings"][0] | {"sentence": "It brakes.", "action": "Turn it."}
WRONG = DataCheck(findings=(Finding.model_validate(BRAKES),), axes={})


def estimate(percent: float = 0.8, **more: Any) -> Estimate:
    document = stored("estimate")
    known = {"confidence_percent": percent, "torque_gain": {"value": 1.0, "std": 0.006}}
    axes = {joint: document["axes"][joint] | known for joint in ("joint_1", "joint_2")}
    parameters = document["base_parameters"]
    document["base_parameters"] = [entry | {"std": entry["std"] or 0.1, "reason": ""} for entry in parameters]
    return Estimate.read(document | {"axes": axes} | more, "estimate")


def diagnosis(verdict: str, *effects: str) -> tuple[int, Diagnosis]:
    return 7, documents.diagnosis(
        joint_1=axis_document(effects, verdict=verdict), joint_2=axis_document((), verdict="none")
    )


def test_confirmed_only_where_check_and_diagnosis_speak_for_it() -> None:
    # hypot(0.8, 0.6) = 1.0
    assert verdict(estimate(), SOUND, diagnosis("none")) == EstimateVerdict(
        CONFIRMED,
        "The inertias of joint_1 and joint_2 are known to 0.8 % or better (confidence: one standard deviation in the "
        "worst pose, with a correct torque constant; joint_1 is the least accurate), to 1 % with the uncertainty of "
        "the torque constants; the data check found nothing; diagnosis 7 finds no effect missing.",
    )


def test_base_parameters_that_are_not_identified_are_counted() -> None:
    document = stored("estimate")["base_parameters"]
    sure = [entry | {"std": 0.1, "reason": ""} for entry in document]
    open_ = [sure[0] | {"std": None}, *sure[1:]]
    told = verdict(estimate(base_parameters=open_), SOUND, diagnosis("none")).sentence
    assert f"; the sweeps do not identify 1 of {len(document)} base parameters; the data check" in told


@pytest.mark.parametrize(
    ("document", "check", "found", "words"),
    [
        (estimate(), None, diagnosis("none"), "the data were not checked yet"),
        (estimate(), SOUND, None, "no diagnosis was made"),
        (estimate(), SOUND, diagnosis("untestable"), "does not decide whether an effect is missing in joint_1"),
        (estimate(40.0), SOUND, diagnosis("none"), "The inertias of joint_1 and joint_2 are too uncertain to use"),
        (estimate(suspect=[SUSPECT]), SOUND, diagnosis("none"), "but 1 sweep does not fit the others"),
        (estimate(axes={}), SOUND, None, "No inertia of a single axis"),
    ],
)
def test_what_is_not_known_is_not_confirmed(
    document: Estimate, check: DataCheck | None, found: tuple[int, Diagnosis] | None, words: str
) -> None:
    told = verdict(document, check, found)
    assert told.standing == OPEN
    assert words in told.sentence


def without_floor(axis: dict[str, Any]) -> dict[str, Any]:
    gap = axis["gap"]
    poses = [one | {"noise_floor_rms": None} for one in gap["by_pose"]]
    return axis | {"gap": gap | {"noise_floor_rms": None, "by_pose": poses}}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axis", "words"),
    [
        (without_floor(axis_document((), verdict="none")), "no sweep was repeated, so there is no noise floor"),
        (without_floor(axis_document((), verdict="untestable")), "no sweep was repeated, so there is no noise floor"),
        (axis_document((), verdict="none", untestable=["backlash"], biasing=["backlash"]), "not visible: backlash"),
        (without_floor(axis_document()), "no sweep was repeated, so there is no noise floor"),  # and in the model
    ],
    ids=["none of an older version", "untestable", "an effect of weight", "named"],
)
def test_nothing_is_confirmed_or_green_without_noise_floor_or_with_an_unseen_effect_of_weight(
    axis: dict[str, Any], words: str
) -> None:
    found = 7, documents.diagnosis(joint_1=axis, joint_2=axis)
    used = {"parameters": {}, "how": "", "used": True}
    named = [one["effect"] for one in axis["effects"]]
    taken = [{"axis": joint, "effect": name, **used} for joint in ("joint_1", "joint_2") for name in named]
    document = estimate(effects=taken)
    assert verdict(document, SOUND, found).standing == OPEN
    page = campaign_page(report(check=SOUND, diagnosis=found), (), document, None).html()
    assert "card open" in page
    assert "card settled" not in page
    assert words in page.split(">Drives</h3>")[0]


def test_an_axis_without_diagnosis_and_a_test_mass_are_told() -> None:
    page = campaign_page(report(check=SOUND), (), estimate(), None).html()
    assert "joint_1, joint_2: no diagnosis, so no effect was looked for" in page.split(">Drives</h3>")[0]
    assert "a test mass of 20 kg was mounted" in verdict(estimate(), SOUND, diagnosis("none"), 20.0).sentence


@pytest.mark.parametrize(
    ("check", "found", "words"),
    [
        (WRONG, diagnosis("none"), "the data cannot be trusted (effort sign of joint_1)"),
        (SOUND, diagnosis("named", "coulomb_friction", "backlash"), "joint_1 lacks Coulomb friction and backlash"),
        (SOUND, diagnosis("ambiguous"), "the model of joint_1 lacks an effect that is not named yet"),
        (SOUND, diagnosis("unknown"), "joint_1 has a gap that no known effect explains"),
    ],
)
def test_what_speaks_against_it_comes_first(check: DataCheck, found: tuple[int, Diagnosis], words: str) -> None:
    told = verdict(estimate(40.0), check, found)
    assert told.standing == CONTRADICTED
    assert words in told.sentence


def test_an_effect_that_the_estimate_took_into_account_is_none_that_it_lacks() -> None:
    for used, standing in ((True, CONFIRMED), (False, CONTRADICTED)):
        effects = [{"axis": "joint_1", "effect": "coulomb_friction", "parameters": {}, "used": used, "how": ""}]
        assert verdict(estimate(effects=effects), SOUND, diagnosis("named", "coulomb_friction")).standing == standing


@pytest.mark.parametrize(
    ("value", "std", "why"),
    [(4.0, 1.0, ""), (-4.0, 1.01, "too uncertain"), (0.0, 0.1, "too uncertain"), (4.0, None, "not identified")],
)
def test_parameters_that_are_not_for_use(value: float, std: float | None, why: str) -> None:
    assert not_for_use(BaseParameter(name="m", value=value, std=std)) == why


def test_nothing_is_drawn_beyond_what_was_measured_or_where_the_robot_would_touch_itself(max100: Robot) -> None:
    base, asked = content(max100), list[str]()
    foreign = base.specs[0].model_copy(update={"id": "9999"})
    specs = (*base.specs, foreign)
    made = content_of(max100, base.estimate, specs, lambda spec: asked.append(spec.id) or sweep(), "of a test")
    assert made.specs == base.specs  # the foreign sweep is not in the estimate
    assert asked == ["0001"]  # one sweep is read
    assert made.title == "Inertias of the robot max100-class"
    assert len(made.workspace) == 25 * 25
    assert np.ptp(made.workspace, axis=0) == pytest.approx([0, 1.0, 1.0, 0, 0, 0])
    folded = base.specs[0].model_copy(update={"pose": (0.0, 1.2, 1.2, 0.0, 0.0, 0.0)})
    made = content_of(max100, base.estimate, (folded, *base.specs[1:]), lambda _: sweep(), "of a test")
    assert 0 < len(made.workspace) < 25 * 25
    page = estimate_page(made).html()
    assert page.count("White: the robot would touch itself; the cell is not considered.") == 2


def report(**changes: Any) -> CampaignReport:
    drive = Drive("joint_1", "node 1", 0x2B1, 0x402, 1, 4711, "ab" * 32, 12)
    told = CampaignReport(
        title="Campaign 1: <robot>",
        subtitle="12 sweeps",
        origin=(("robot document", "SHA-256 " + "cd" * 32), ("ordered by", "Ada <ada>")),
        drives=(drive, replace(drive, joint="joint_2", serial=0)),
        check=WRONG,
        diagnosis=None,
    )
    return replace(told, **changes)


def text_of(page: str) -> str:
    body = page.partition("<main>")[2].partition("</main>")[0]
    return " ".join(re.sub(r"<[^>]+>", " ", body).split())


@pytest.mark.slow
def test_the_page_begins_with_verdict_and_origin(max100: Robot) -> None:
    drawn: Content = content(max100)
    page = campaign_page(report(), max100.joints, drawn.estimate, drawn).html()
    text = text_of(page)
    in_order = (
        "Campaign 1: &lt;robot&gt;",
        "Contradicted. The inertias of joint_1, joint_2 and joint_3 are known",
        "Origin robot document SHA-256 cdcd",
        "ordered by Ada &lt;ada&gt;",
        "Drives",
        "joint_1 node 1 0x2b1 0x402 0x1 4711 abababababab 12",
        "joint_2 node 1 0x2b1 0x402 0x1 not reported abababababab 12",
        "Inertia of the axes over the poses",
        "Base parameters",
        "Check of the data wrong: It brakes. Turn it.",
    )
    assert re.search(".*".join(map(re.escape, in_order)), text)
    again = campaign_page(report(), max100.joints, drawn.estimate, drawn)
    assert again.html() == page
    sections = [table["section"] for table in json.loads(again.written("json"))["tables"]]
    assert sections[:3] == ["Campaign 1: <robot>", "Origin", "Drives"]
    assert "Drives" not in sections[3:]


def test_a_campaign_without_an_inertia_has_what_there_is(max100: Robot) -> None:
    one = {"name": "m(link_6)", "value": 12.0, "std": None, "identified": False, "reason": "not excited", "source": ""}
    document = estimate(axes={}, combination={"base_parameters": [one]})
    text = text_of(campaign_page(report(drives=(), check=None), max100.joints, document, None).html())
    assert "m(link_6) 12 – not excited not identified" in text
    assert "Not recorded: the sweeps were imported" in text
    assert "Not confirmed. No inertia of a single axis" in text
