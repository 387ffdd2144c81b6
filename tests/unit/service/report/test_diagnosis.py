"""Figures and page of a diagnosis, from a document worked out by hand."""

import json
from typing import Any

import pytest

from service.diagnosis.summary import summary
from service.report import diagnosis_figures, diagnosis_page
from service.results.diagnosis import Diagnosis
from tests.stored.documents import stored

POSES = ([0.1, 0.5, 0.0], [0.1, -0.5, 0.0], [0.1, 0.0, 0.0])


def axis(**changes: Any) -> dict[str, Any]:
    """Coulomb friction, named; noise of 2 N m."""
    cells = [
        ("speed", "0.2 to 0.3 rad/s", 30.0, 2.1, 50.0),
        ("speed", "1e-12 to 0.1 rad/s", 30.0, 1.9, 60.0),
        ("speed", "0.1 to 0.2 rad/s", 1.0, 1.0, 0.5),
        ("block", "reversal", 46.0, 2.0, 80.0),
        ("block", "forward_slow of campaign 7", 28.0, 2.0, 70.0),
        ("line frequency", "3 Hz", 20.0, 0.5, 40.0),
        ("line frequency", "17 Hz", 0.5, 0.5, 0.0),
        ("gravity torque", "-544 to -414 N m", 29.0, 2.0, 70.0),
        ("motor angle", "0/8 turn", 29.0, 2.0, 70.0),
    ]
    document: dict[str, Any] = {
        "verdict": "named",
        "unit": "N m",
        "effects": [
            {
                "effect": "coulomb_friction",
                "sentence": "Dry friction.",
                "physics": "tau = Fc sign(v) </script>",
                "source": "Coulomb 1785",
                "parameters": {"coulomb": {"value": 50.0, "std": 0.5, "unit": "N m"}},
                "evidence": {},
            }
        ],
        "known": [],
        "part": [],
        "changes": [],
        "candidates": [],
        "alternatives": [],
        "rolled_back": [],
        "where": [
            {"dimension": name, "value": value, "rms": rms, "rms_after": after, "significance": significance}
            for name, value, rms, after, significance in cells
        ],
        "sentences": ["joint_2: the gap is largest at block reversal."],
        "gap": {
            "before_rms": 30.0,
            "after_rms": 2.1,
            "noise_floor_rms": 2.0,
            "held_out_sweeps": 42,
            "before_percent": 9.0,
            "after_percent": 0.63,
            "cross_validated": True,
            "source": "columns",
            "twin_rms": 2.2,
            "by_pose": [
                {"pose": pose, "before_rms": 30.0, "after_rms": 2.1, "noise_floor_rms": 2.0, "sweeps": 14}
                for pose in POSES
            ],
        },
        "example": {
            "sweep": "0017",
            "block": "reversal",
            "time": [0.0, 0.1],
            "measured": [50.0, -49.0],
            "before": [1.0, 1.0],
            "after": [50.0, -50.0],
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
        "next_experiment": None,
        "untestable": ["friction_temperature_drift"],
        "visible_in": {"friction_temperature_drift": ["revisit_forward_slow", "revisit_backward_slow"]},
    }
    document |= changes
    return document | {"summary": summary("joint_2", document)}


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
    titles = [note["text"] for note in layout["annotations"]]
    assert titles[:-1] == [
        "speed (rad/s)",
        "block",
        "line frequency (Hz)",
        "gravity torque (N m)",
        "motor angle (turn)",
    ]
    bars = [trace for trace in figures()["map"]["data"] if not trace.get("showlegend", True)]
    before = {trace["xaxis"]: trace for trace in bars[::2]}
    assert before["x"]["y"] == ["0 … 0.1", "0.1 … 0.2", "0.2 … 0.3"]
    assert before["x"]["x"] == [30.0, 1.0, 30.0]
    colours = before["x"]["marker"]["color"]
    assert colours[0] == colours[2] != colours[1]  # the middle bin is not significant
    assert before["x2"]["y"] == ["forward slow #7", "reversal"]
    assert before["x3"]["y"] == ["3", "17"]
    assert before["x5"]["y"] == ["0/8"]
    # the floor of all frequencies together says nothing of one line
    assert {shape["xref"] for shape in layout["shapes"]} == {"x", "x2", "x4", "x5"}
    assert {shape["x0"] for shape in layout["shapes"]} == {2.0}


def test_poses_are_named_by_the_joints_that_vary() -> None:
    by_pose = figures()["gap_by_pose"]["data"]
    assert [trace["name"] for trace in by_pose] == ["before", "after", "noise floor"]
    assert by_pose[0]["x"] == ["+0.50", "-0.50", "+0.00"]


def test_example_shows_what_either_model_leaves() -> None:
    data = {trace["name"]: trace["y"] for trace in figures()["example"]["data"]}
    assert data["left before"] == [49.0, -50.0]
    assert data["left after"] == [0.0, 1.0]


def test_evidence_on_a_scale_of_powers() -> None:
    bars = figures(candidates=["coulomb_friction", "stribeck_friction"])["evidence"]["data"][0]
    assert bars["y"] == ["Coulomb friction", "Stribeck friction", "Payload"]
    assert bars["x"] == pytest.approx([0.0, -0.6021, 4.0])
    assert bars["marker"]["color"][1] != bars["marker"]["color"][2]


def test_parameters_are_percent_of_their_value() -> None:
    trace = figures()["parameters"]["data"][0]
    assert trace["error_x"]["array"] == [2.0]
    assert trace["text"] == ["50 ± 0.5 N m"]


def test_without_an_effect_there_is_no_after() -> None:
    found = figures(verdict="none", effects=[])
    assert list(found) == ["map", "gap_by_pose", "example"]
    assert not any("after" in trace.get("name", "") for figure in found.values() for trace in figure["data"])
    assert list(figures(verdict="none", effects=[], where=[])) == ["gap_by_pose", "example"]


def test_the_page_says_it_in_words_and_loads_nothing() -> None:
    page = diagnosis_page(document(), "Robot <1>", "campaign 3").html()
    assert "<script" not in page
    assert "Robot &lt;1&gt;" in page
    assert (
        "joint_2: the model lacks Coulomb friction. With it the gap on sweeps that took no part in naming or fit "
        "falls from 30 N m" in page
    )
    assert "tau = Fc sign(v) &lt;/script&gt;" in page
    assert "<td>50</td><td>0.5</td><td>N m</td>" in page
    assert "inertia at +0.50" in page
    assert "Friction temperature drift</td><td>revisit forward slow, revisit backward slow</td>" in page
    assert page.count("<figure>") == 5


def test_the_page_tells_what_to_measure_next() -> None:
    designed = stored("diagnosis-open")["axes"]["joint_1"]["next_experiment"]["sweeps"][0]["spec"]
    experiment = {
        "kind": "reversal",
        "blocks": ["reversal"],
        "sweeps": [{"spec": designed | {"pose": pose}, "ramp": 0.5, "settle": 0.5} for pose in POSES * 2],
        "seconds": 96.0,
        "separation": 200.0,
        "between": ["coulomb_friction", "stribeck_friction"],
        "reason": "reversal separates Coulomb friction and Stribeck friction best for its time.",
    }
    page = diagnosis_page(
        document(
            verdict="ambiguous",
            candidates=["coulomb_friction", "stribeck_friction"],
            alternatives=[["coulomb_friction", "stribeck_friction"]],
            next_experiment=experiment,
        ),
        "title",
    ).html()
    assert "do not tell whether it is Coulomb friction or Stribeck friction. Measure what is proposed next." in page
    assert "separates Coulomb friction and Stribeck friction best for its time." in page
    assert "6 sweeps of joint_2 in 3 poses, 1 min 36 s of machine time." in page
    assert "not decided" in page


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ("none", "the model is right as far as these sweeps can tell"),
        ("unknown", "no effect of the catalogue explains it. The model stays as it was."),
        ("untestable", "these sweeps cannot show whether something is missing"),
    ],
)
def test_verdicts_in_words(verdict: str, words: str) -> None:
    said = summary("joint_2", axis(verdict=verdict, effects=[], rolled_back=["backlash"]))
    assert said.startswith(f"joint_2: {words}") or words in said
    assert said.endswith("Rolled back, because held-out sweeps came out no better: backlash.")


def test_of_two_effects_the_one_that_is_sure_is_said() -> None:
    said = summary(
        "joint_2",
        axis(
            verdict="ambiguous",
            effects=[{"effect": "coulomb_friction"}, {"effect": "joint_elasticity"}],
            alternatives=[["coulomb_friction", "drift"], ["joint_elasticity"]],
        ),
    )
    assert "do not tell whether it is Coulomb friction or drift. Sure is joint elasticity. " in said


def test_where_nothing_was_repeated_no_noise_floor_is_made_up() -> None:
    gap = {**axis()["gap"], "noise_floor_rms": None, "held_out_sweeps": 0, "before_percent": 112.3}
    gap["cross_validated"] = False
    gap["by_pose"] = [{**pose, "noise_floor_rms": None} for pose in gap["by_pose"]]
    page = diagnosis_page(document(gap=gap), "title").html()
    assert "nothing was measured twice" in page
    assert "evaluated on its own sweeps" in page
    assert "(on the sweeps themselves: none could be left out) falls from 30 N m (112 % of the effort)" in page
    assert "noise alone" not in page


def test_what_the_model_has_stands_beside_what_it_is_now() -> None:
    known = {"effect": "coulomb_friction", "parameters": {"coulomb": {"value": 50.0, "std": 0.5, "unit": "N m"}}}
    change = {
        "effect": "coulomb_friction",
        "parameter": "coulomb",
        "model": {"value": 40.0, "std": 0.4, "unit": "N m"},
        "now": {"value": 50.0, "std": 0.5, "unit": "N m"},
    }
    page = diagnosis_page(document(verdict="none", effects=[], known=[known], changes=[change]), "title").html()
    assert "Coulomb friction</td><td>Coulomb</td><td>50</td><td>0.5</td><td>N m</td><td>40 ± 0.4</td>" in page
    assert "lacks no effect, but Coulomb friction has changed: coulomb is 50 ± 0.5, not 40 N m" in page


def test_the_rigid_model_stands_beside_cad() -> None:
    page = diagnosis_page(document(), "t").html()
    for text in ("The rigid model", "Izz2 + 0.3 m3", ">60<", ">61.25<", ">0.5<", "left by the simulator"):
        assert text in page


def test_the_rigid_model_stands_beside_the_estimate_that_it_started_from() -> None:
    page = diagnosis_page(document(started_from="campaign 3, revision 7"), "t").html()
    assert "<th>estimate</th>" in page
    assert "Started from an estimate: campaign 3, revision 7." in page
    assert "<th>CAD</th>" in diagnosis_page(document(), "t").html()


def test_findings_of_the_data_come_first_and_once() -> None:
    (found,) = stored("check-wrong")["findings"]
    findings = [
        found | {"severity": "warning", "sentence": "Repeats differ.", "action": "Look at the floor."},
        found | {"severity": "wrong", "sentence": "Torque has the wrong sign.", "action": "Turn it round."},
    ]
    sentences = [*(one["sentence"] for one in findings), "joint_2 leaves 30 N m."]
    page = diagnosis_page(document(data=findings, sentences=sentences), "t").html()
    assert "<b>wrong:</b> Torque has the wrong sign. Turn it round." in page
    assert page.index("Torque has the wrong sign") < page.index("Repeats differ") < page.index("leaves 30 N m")
    assert page.count("Repeats differ.") == 1
    assert "Check of the data" not in diagnosis_page(document(), "t").html()


def test_what_is_known_in_part_stands_beside_the_unknown() -> None:
    part = [{**axis()["effects"][0], "effect": "hose_spring", "parameters": {}}]
    part[0]["parameters"] = {"stiffness": {"value": 76.5, "std": 1.0, "unit": "N m/rad"}}
    page = diagnosis_page(document(verdict="unknown", effects=[], part=part), "t").html()
    assert "Known in part" in page
    assert "76.5" in page
    assert "Known in part" not in diagnosis_page(document(), "t").html()


def test_a_gap_without_a_pose_held_back_says_how_it_was_judged() -> None:
    gap = {**axis()["gap"], "held_out_sweeps": 0}
    assert "the gap (cross-validated) falls" in diagnosis_page(document(gap=gap), "t").html()
    page = diagnosis_page(document(gap={**gap, "cross_validated": False}), "t").html()
    assert "nothing could be held out" in page


def test_the_summary_of_the_unknown_tells_what_is_known_in_part_or_that_the_data_are_wrong() -> None:
    part = [{**axis()["effects"][0], "effect": "hose_spring"}]
    found = axis(verdict="unknown", effects=[], part=part)["summary"]
    assert "no effect of the catalogue explains it. Known in part: " in found
    data = [{"severity": "wrong", "sentence": "Torque has the wrong sign.", "action": "Turn it round."}]
    found = axis(verdict="unknown", effects=[], part=[], data=data)["summary"]
    assert found.endswith("because the data cannot be trusted. Torque has the wrong sign. Mend that first.")
