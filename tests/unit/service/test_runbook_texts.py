"""What the runbooks say of a motion and of a fault, without a machine."""

import importlib
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from service import BadInput
from tests.unit.service.benefit.pair import URDF, robot

RUNBOOKS = Path(__file__).parents[3] / "docs" / "how-to" / "runbooks"


@pytest.fixture
def runbook(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A module of the runbooks by its name."""
    monkeypatch.setattr(sys, "path", [str(RUNBOOKS), *sys.path])
    return importlib.import_module


@pytest.mark.parametrize(
    ("old", "new", "moves_mm"),
    [
        ('<axis xyz="1 0 0"/>', '<axis xyz="0 0 1"/>', 1e3 * 0.5 * 0.2),  # the flange is 0.5 m from the axis
        ("0.5 0 0.7", "0.5 0 0", None),  # the axis goes through the end of the arm
    ],
)
def test_the_last_axis_moves_what_is_mounted_on_it(runbook: Any, old: str, new: str, moves_mm: float | None) -> None:
    turned = URDF.replace('name="j2" type="prismatic"', 'name="j2" type="revolute"').replace(old, new)
    arm = type(robot())(robot().description, turned)
    spec = {"axis": "j2", "pose": [0.0, 0.5], "started_at": 0.0}
    sweep = {"spec": spec, "duration": 10.0, "position_window": [0.4, 0.6], "legs": []}
    (move,) = runbook("moves").moves(arm, [sweep], {"j2": 0.5})
    assert move.joint == "j2"
    assert move.arm_mm == (moves_mm and pytest.approx(moves_mm))
    assert ("the arm's end" in runbook("runbook").told(move)) is (moves_mm is not None)


def test_every_axis_of_a_trajectory_moves_for_its_time_and_at_its_longest_arm(runbook: Any) -> None:
    def sweep(axis: str, window: list[float], **of_all: object) -> dict[str, object]:
        spec = {"axis": axis, "pose": [0.0, 0.5], "started_at": 4.0}
        return {"spec": spec, "duration": 0.0, "position_window": window, "legs": []} | of_all

    way = {"duration": 9.0, "legs": [{"joint": "j2", "target": 0.3}]}
    found = runbook("moves").moves(robot(), [sweep("j1", [-1.0, 1.0], **way), sweep("j2", [0.4, 0.8])], {})
    assert [(move.joint, move.lowest, move.highest, move.seconds) for move in found] == [
        *(("j1", -1.0, 1.0, 9.0), ("j2", 0.3, 0.8, 9.0))
    ]
    alone = runbook("moves").moves(robot(), [sweep("j1", [-1.0, 1.0], **way)], {})
    assert found[0].arm_mm > alone[0].arm_mm  # j2 is out at 0.8 m


def test_an_emergency_stop_is_told_by_its_name(runbook: Any) -> None:
    fault_of = runbook("after_a_stop").fault_of
    fault = {"text": "error 9000h", "code": 0x9000, "emergency_stop": True}
    assert fault_of({"fault": fault}) == "EMERGENCY STOP, error 9000h (9000h)"
    assert fault_of({"fault": fault | {"emergency_stop": False}}) == "error 9000h (9000h)"
    assert not fault_of({"fault": None})


def test_a_campaign_that_cannot_be_the_reference_says_why(runbook: Any) -> None:
    lacking = runbook("daily_check").lacking
    known: dict[str, Any] = {"confidence_percent": 0.4, "inertia": [{}] * 3}
    assert not lacking({"axes": {"turn": known, "elbow": known}}, [])
    left_open = known | {"confidence_percent": None}
    assert "J of turn is left open" in lacking({"axes": {"turn": left_open, "elbow": known}}, [])
    few = known | {"inertia": [{}]}
    assert lacking({"axes": {"turn": few}}, []) == "turn measured in fewer than 3 poses"
    assert lacking({"axes": {"turn": known}}, ["turn", "rail"]) == "rail measured in fewer than 3 poses"


@pytest.mark.parametrize(
    ("percent", "code", "told"),
    [
        (0.4, 0, "confidence of 0.6 % reached"),
        (0.7, 4, "sweeps used up, 0.6 % not reached"),
        (None, 4, "sweeps used up, 0.6 % not reached"),
    ],
)
def test_a_resumed_night_tells_what_it_reached(
    runbook: Any, monkeypatch: pytest.MonkeyPatch, percent: float | None, code: int, told: str
) -> None:
    after_a_stop = runbook("after_a_stop")
    campaign = {"id": 2, "plan_id": 7, "state": "completed", "robot_id": 1, "cause": ""}
    request = {"axes": ["turn"], "confidence": 0.6}
    client = SimpleNamespace(
        plan=lambda _: {"document": {"request": request}},
        estimate=lambda _: {"document": {"axes": {"turn": {"confidence_percent": percent}}}},
    )
    steps: list[tuple[str, str]] = []
    book = SimpleNamespace(
        client=client, watched=lambda *_: campaign, step=lambda name, result, **_: steps.append((name, result))
    )
    monkeypatch.setattr(after_a_stop, "tell_resume", lambda *_: None)
    monkeypatch.setattr(after_a_stop, "confirmed", lambda *_: True)
    assert after_a_stop.resumed(book, campaign) == code
    assert steps[-1] == ("ended by", told)


def test_a_red_axis_tells_the_next_command(runbook: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    daily_check, exits = runbook("daily_check"), runbook("runbook").Exit
    reference = {"id": 6, "plan_id": 7, "robot_id": 1, "created_at": "2026-01-01T00:00"}
    plan = {"document": {"request": {"varied": ["shoulder", "elbow"]}}}
    colours = {"turn": exits.DONE, "elbow": exits.FAILED}
    steps: list[tuple[str, str]] = []
    book = SimpleNamespace(
        client=SimpleNamespace(plan=lambda _: plan, robot=lambda _: {}),
        planned=lambda _: plan,
        given=SimpleNamespace(robot="railpal", axes=[], poses=1),
        identify_machine=lambda _: None,
        measured=lambda *_: {"id": 8, "state": "completed"},
        step=lambda name, result, **_: steps.append((name, result)),
    )
    monkeypatch.setattr(daily_check, "stored", lambda _: (reference, {"axes": colours}))
    monkeypatch.setattr(daily_check, "compared", lambda *given: colours[given[-1]])
    assert daily_check.check(book) == exits.FAILED
    assert steps[-1] == ("next", "if no load was changed, diagnose_axis.py railpal elbow --varied shoulder,elbow")


def test_a_campaign_of_too_few_poses_says_what_to_measure(runbook: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    before_and_after = runbook("before_and_after")

    def nothing(*_: object) -> None:
        raise BadInput("campaign 8", "gives no inertia of turn in this pose")

    monkeypatch.setattr(before_and_after, "inertias", nothing)
    before, after = {"id": 6}, {"id": 8}
    with pytest.raises(BadInput, match=r"^after: campaign 8: gives no .* Too few poses: .*--before 6 without --after"):
        before_and_after.known(None, after, {}, "turn", None, before)


@pytest.mark.parametrize(
    ("after", "expected"),
    [
        ([[0.0, 1.0], [0.5, 2.0]], [[0.0, 1.0]]),
        ([[0.5, 2.0]], [[0.0, 1.0], [0.0, 2.0], [0.5, 2.0]]),  # no common pose: that of what a person would try first
        ([], []),
    ],
)
def test_campaigns_are_compared_at_common_poses_or_else_at_all(runbook: Any, after: Any, expected: Any) -> None:
    sweeps = [
        [{"spec": {"pose": pose}, "state": "identified"} for pose in poses]
        + [{"spec": {"pose": [9.0, 9.0]}, "state": "failed"}]
        for poses in ([[0.0, 1.0], [0.0, 2.0]], after)
    ]
    assert runbook("before_and_after").compared_at(sweeps).tolist() == expected


def test_a_diagnosis_says_that_it_takes_time_before_it_is_waited_for(runbook: Any) -> None:
    happened: list[str] = []

    def diagnosed(_: int) -> dict[str, str]:
        happened.append("waited")
        return {"state": "failed", "cause": "none"}

    book = SimpleNamespace(
        client=SimpleNamespace(diagnosed=diagnosed),
        given=SimpleNamespace(axis="elbow"),
        step=lambda name, *_, **__: happened.append(name),
    )
    runbook("diagnose_axis").settled(book, None, 3)
    assert happened == ["waiting", "waited", "diagnosis 3"]
