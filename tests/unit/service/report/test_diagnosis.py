"""Figures and page of a diagnosis, from a document worked out by hand."""

import json
from typing import Any

import pytest

from service.diagnosis.summary import summary
from service.model.results.diagnosis import AxisDiagnosis, Diagnosis
from service.report.diagnosis import diagnosis_figures, diagnosis_page
from tests.stored.documents import stored

POSES = ([0.1, 0.5, 0.0], [0.1, -0.5, 0.0], [0.1, 0.0, 0.0])


def known(value: float, std: float, unit: str = "N m") -> dict[str, Any]:
    return {"value": value, "std": std, "unit": unit}


EFFECT = {
    **{"effect": "coulomb_friction", "sentence": "Dry friction.", "physics": "tau = Fc sign(v) </script>"},
    **{"source": "Coulomb 1785", "parameters": {"coulomb": known(50.0, 0.5)}, "evidence": {}},
}
CELLS = [
    ("speed", "0.2 to 0.3 rad/s", 30.0, 2.1, 50.0),
    ("speed", "1e-12 to 0.1 rad/s", 30.0, 1.9, 60.0),
    ("speed", "0.1 to 0.2 rad/s", 1.0, 1.0, 0.5),
    ("block", "reversal", 46.0, 2.0, 80.0),
    ("block", "forward_slow of campaign 7", 28.0, 2.0, 70.0),
    ("line frequency", "3 Hz", 20.0, 0.5, 40.0),
    ("line frequency", "17 Hz", 0.5, 0.0, 0.0),
    ("gravity torque", "-544 to -414 N m", 29.0, 2.0, 70.0),
    ("motor angle", "0/8 turn", 29.0, 2.0, 70.0),
]
GAP = {
    **{"before_rms": 30.0, "after_rms": 2.1, "noise_floor_rms": 2.0, "held_out_sweeps": 42, "twin_rms": 2.2},
    **{"before_percent": 9.0, "after_percent": 0.63, "cross_validated": True, "source": "columns"},
    "by_pose": [
        {"pose": pose, "before_rms": 30.0, "after_rms": 2.1, "noise_floor_rms": 2.0, "sweeps": 14} for pose in POSES
    ],
}


def axis(**changes: Any) -> dict[str, Any]:
    """Coulomb friction, named; noise of 2 N m."""
    keys = ("dimension", "value", "rms", "rms_after", "significance")
    document: dict[str, Any] = {
        **{"verdict": "named", "unit": "N m", "effects": [EFFECT], "known": [], "part": [], "changes": []},
        **{"candidates": [], "alternatives": [], "rolled_back": [], "next_experiment": None, "gap": GAP},
        "where": [dict(zip(keys, cell, strict=True)) for cell in CELLS],
        "sentences": ["joint_2: the gap is largest at block reversal."],
        "example": {
            **{"sweep": "0017", "block": "reversal", "time": [0.0, 0.1]},
            **{"measured": [50.0, -49.0], "before": [1.0, 1.0], "after": [50.0, -50.0]},
        },
        "rivals": [{"effect": "stribeck_friction", "behind": -3.0}, {"effect": "payload", "behind": 9999.0}],
        "fit": {
            "inertia": [{"pose": pose, "value": 60.0, "std": 0.3} for pose in POSES],
            "viscous_friction": {"value": 800.0, "std": 3.0},
        },
        "rigid_model": [
            {"name": "Izz2 + 0.3 m3", "nominal": 60.0, "value": 61.25, "std": 0.5},
            {"name": "viscous_friction", "nominal": None, "value": 800.0, "std": 3.0},
        ],
        "untestable": ["friction_temperature_drift"],
        "visible_in": {"friction_temperature_drift": ["revisit_forward_slow", "revisit_backward_slow"]},
        **changes,
    }
    return document | {"summary": summary("joint_2", AxisDiagnosis.model_validate(document | {"summary": ""}))}


def document(**changes: Any) -> Diagnosis:
    return Diagnosis.read({"axes": {"joint_2": axis(**changes)}, "model": {"robot": "r", "effects": {}}}, "document")


def figures(**changes: Any) -> dict[str, Any]:
    return diagnosis_figures(document(**changes))["joint_2"]


def test_every_figure_is_plain_json() -> None:
    found = figures()
    assert list(found) == ["map", "gap_by_pose", "example", "evidence", "parameters"]
    json.dumps(found, allow_nan=False)
    assert all(figure["layout"]["height"] > 0 for figure in found.values())


def test_map_has_a_panel_a_property_with_its_bins_in_order() -> None:
    layout = figures()["map"]["layout"]
    titles = ["speed (rad/s)", "block", "line frequency (Hz)", "gravity torque (N m)", "motor angle (turn)"]
    assert [note["text"] for note in layout["annotations"]][:-1] == titles
    bars = [trace for trace in figures()["map"]["data"] if not trace.get("showlegend", True)]
    before = {trace["xaxis"]: trace for trace in bars[::2]}
    assert before["x"]["y"] == ["0 … 0.1", "0.1 … 0.2", "0.2 … 0.3"]
    assert before["x"]["x"] == [30.0, 1.0, 30.0]
    colours = before["x"]["marker"]["color"]
    assert colours[0] == colours[2] != colours[1]  # the middle bin is not significant
    assert before["x2"]["y"] == ["forward slow #7", "reversal"]
    assert before["x3"]["y"] == ["3", "17"]
    assert before["x5"]["y"] == ["0/8"]
    # what is left can be nothing, and is seen; the noise of a single sweep is no measure of what repeats
    after = {trace["xaxis"]: trace for trace in bars[1::2]}
    assert {trace["mode"] for trace in after.values()} == {"markers"}
    assert after["x"]["marker"]["size"] > 5
    assert after["x3"]["x"] == [0.5, 0.0]
    assert "shapes" not in layout
    assert "noise floor" not in [trace.get("name") for trace in figures()["map"]["data"]]


def test_evidence_on_a_scale_of_powers() -> None:
    bars = figures(candidates=["coulomb_friction", "stribeck_friction"])["evidence"]["data"][0]
    assert bars["y"] == ["Coulomb friction", "Stribeck friction", "Payload"]
    assert bars["x"] == pytest.approx([0.0, -0.6021, 4.0])
    assert bars["marker"]["color"][1] != bars["marker"]["color"][2]
    assert bars["text"] == ["chosen", "-3, not ruled out", "9,999"]  # the colour is no measure of how far behind


def test_poses_are_named_by_the_joints_that_vary_and_parameters_are_percent_of_their_value() -> None:
    found = figures()
    by_pose = found["gap_by_pose"]["data"]
    assert [trace["name"] for trace in by_pose] == ["before", "after", "noise floor"]
    assert by_pose[0]["x"] == ["+0.50", "-0.50", "+0.00"]
    left = {trace["name"]: trace["y"] for trace in found["example"]["data"]}
    assert (left["left before"], left["left after"]) == ([49.0, -50.0], [0.0, 1.0])
    (trace,) = found["parameters"]["data"]
    assert (trace["error_x"]["array"], trace["text"]) == ([2.0], ["50 ± 0.5 N m"])


def test_a_coefficient_of_which_the_sweeps_tell_nothing_has_no_value() -> None:
    effect = EFFECT | {"parameters": {"coulomb": known(880.0, 640_000.0)}}
    assert "parameters" not in figures(effects=[effect])
    page = diagnosis_page(document(effects=[effect]), "Robot").html()
    assert "<td>not significant</td><td>–</td>" in page
    assert "640000" not in page
    assert ">viscous friction</td><td>–</td><td>800.0</td>" in page  # of the rigid model, in words


def test_without_an_effect_there_is_no_after() -> None:
    found = figures(verdict="none", effects=[])
    assert list(found) == ["map", "gap_by_pose", "example"]
    assert not any("after" in trace.get("name", "") for figure in found.values() for trace in figure["data"])
    assert list(figures(verdict="none", effects=[], where=[])) == ["gap_by_pose", "example"]


NOT_REPEATED = {
    **GAP,
    **{"noise_floor_rms": None, "held_out_sweeps": 0, "before_percent": 112.3, "cross_validated": False},
    "by_pose": [{**pose, "noise_floor_rms": None} for pose in GAP["by_pose"]],
}
SPEC = stored("diagnosis-open")["axes"]["joint_1"]["next_experiment"]["sweeps"][0]["spec"]
RIVALS = ["coulomb_friction", "stribeck_friction"]
EXPERIMENT = {
    **{"kind": "reversal", "blocks": ["reversal"], "seconds": 96.0, "separation": 200.0, "between": RIVALS},
    "sweeps": [{"spec": SPEC | {"pose": pose}, "ramp": 0.5, "settle": 0.5} for pose in POSES * 2],
    "reason": "reversal separates Coulomb friction and Stribeck friction best for its time.",
}
OPEN = {"verdict": "ambiguous", "candidates": RIVALS, "alternatives": [RIVALS], "next_experiment": EXPERIMENT}
KNOWN = {"effect": "coulomb_friction", "parameters": EFFECT["parameters"]}
CHANGE = {"effect": "coulomb_friction", "parameter": "coulomb", "model": known(40.0, 0.4), "now": known(50.0, 0.5)}
SPRING = EFFECT | {"effect": "hose_spring", "parameters": {"stiffness": known(76.5, 1.0, "N m/rad")}}
FOUND = stored("check-wrong")["findings"][0]
FINDINGS = [
    FOUND | {"severity": "warning", "sentence": "Repeats differ.", "action": "Look at the floor."},
    FOUND | {"severity": "wrong", "sentence": "Torque has the wrong sign.", "action": "Turn it round."},
]
SAID = ["Repeats differ.", "Torque has the wrong sign.", "joint_2 leaves 30 N m."]
# what differs from the document above, what the page says, and what it does not
PAGES: dict[str, tuple[dict[str, Any], tuple[str, ...], tuple[str, ...]]] = {
    "named": (
        {},
        (
            "joint_2: the model lacks Coulomb friction. With it the gap on sweeps that took no part in naming or fit "
            "falls from 30 N m",
            "Robot &lt;1&gt;",
            "tau = Fc sign(v) &lt;/script&gt;",
            "<td>50.00</td><td>0.50</td><td>N m</td>",
            "inertia at +0.50",
            "Friction temperature drift</td><td>revisit forward slow, revisit backward slow</td>",
            *("The rigid model", "Izz2 + 0.3 m3", ">60.00<", ">61.25<", ">0.50<"),
            *(
                "left by the simulator",
                "<th>CAD</th>",
                "Amber: not ruled out. Grey: ruled out, because it is far behind",
            ),
            "before 49.5 N m RMS (at most 50 N m) and after 0.707 N m RMS (at most 1 N m). The gap is that of all",
        ),
        ("Check of the data", "Known in part"),
    ),
    "open": (
        OPEN,
        (
            "do not tell whether it is Coulomb friction or Stribeck friction. Next: measure the proposed experiment.",
            "separates Coulomb friction and Stribeck friction best for its time.",
            "6 sweeps of joint_2 in 3 poses, 1 min 36 s of machine time.",
            "not decided",
        ),
        (),
    ),
    "nothing repeated": (
        {"gap": NOT_REPEATED},
        (
            "nothing was measured twice",
            "evaluated on its own sweeps",
            "(on the sweeps themselves: none could be left out) falls from 30 N m (112 % of the effort)",
        ),
        ("noise alone",),
    ),
    "cross-validated": ({"gap": {**GAP, "held_out_sweeps": 0}}, ("the gap (cross-validated) falls",), ()),
    "not held out": ({"gap": {**GAP, "held_out_sweeps": 0, "cross_validated": False}}, ("could be held out",), ()),
    "changed": (
        {"verdict": "none", "effects": [], "known": [KNOWN], "changes": [CHANGE]},
        (
            "Coulomb friction</td><td>Coulomb</td><td>50.00</td><td>0.50</td><td>N m</td><td>40.00 ± 0.40</td>",
            "lacks no effect, but Coulomb friction has changed: coulomb is 50 ± 0.5, not 40 N m",
        ),
        (),
    ),
    "from an estimate": (
        {"started_from": "campaign 3, revision 7"},
        ("<th>estimate</th>", "Started from an estimate: campaign 3, revision 7."),
        ("<th>CAD</th>",),
    ),
    "findings": ({"data": FINDINGS, "sentences": SAID}, ("<b>wrong:</b> Torque has the wrong sign. Turn it",), ()),
    "known in part": ({"verdict": "unknown", "effects": [], "part": [SPRING]}, ("Known in part", "76.5"), ()),
}


def page_of(case: str) -> str:
    return diagnosis_page(document(**PAGES[case][0]), "Robot <1>", "campaign 3").html()


@pytest.mark.slow
@pytest.mark.parametrize("case", PAGES)
def test_the_page_says_it_in_words_and_loads_nothing(case: str) -> None:
    page, (_, words, others) = page_of(case), PAGES[case]
    assert "<script" not in page
    assert [word for word in words if word not in page] == []
    assert [word for word in others if word in page] == []


@pytest.mark.slow
def test_figures_are_cards_and_findings_come_first_and_once() -> None:
    assert page_of("named").count("<figure>") == 5
    page = page_of("findings")
    assert page.index("Torque has the wrong sign") < page.index("Repeats differ") < page.index("leaves 30 N m")
    assert page.count("Repeats differ.") == 1


ROLLED_BACK = "Rolled back, because held-out sweeps came out no better: backlash."


@pytest.mark.parametrize(
    ("changes", "words", "end"),
    [
        ({"verdict": "none"}, "joint_2: the model is right as far as these sweeps can tell", ROLLED_BACK),
        ({"verdict": "unknown"}, "no effect of the catalogue explains it. The model stays as it was.", ROLLED_BACK),
        ({"verdict": "untestable"}, "these sweeps cannot show whether something is missing", ROLLED_BACK),
        (
            {
                "verdict": "ambiguous",
                "effects": [{"effect": name, "parameters": {}} for name in ("coulomb_friction", "joint_elasticity")],
                "alternatives": [["coulomb_friction", "drift"], ["joint_elasticity"]],
            },
            "do not tell whether it is Coulomb friction or drift. Significant: joint elasticity.",
            "",
        ),
        ({"verdict": "unknown", "part": [SPRING]}, "no effect of the catalogue explains it. Known in part: ", ""),
        (
            {"verdict": "unknown", "data": [FINDINGS[1]]},
            "because the data cannot be trusted. Torque has the wrong sign. Correct this first.",
            "Correct this first.",
        ),
    ],
)
def test_verdicts_in_words(changes: dict[str, Any], words: str, end: str) -> None:
    rolled_back = ["backlash"] if end == ROLLED_BACK else []
    said = axis(**{"effects": [], "rolled_back": rolled_back} | changes)["summary"]
    assert words in said
    assert said.endswith(end)
