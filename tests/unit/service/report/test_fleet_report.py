"""The report of a plant tells what the survey found, in every form."""

import json
from datetime import UTC, datetime, timedelta

from service.cli.commands.plant import fleet_lines
from service.identification.fleet.document import Fleet
from service.identification.fleet.survey import (
    AxisMeasured,
    CampaignMeasured,
    FleetRules,
    RobotMeasured,
    in_pose,
    pose_key,
    survey,
)
from service.report.fleet import fleet_page

START = datetime(2026, 1, 5, tzinfo=UTC)
AT = START + timedelta(days=200)


def fleet() -> Fleet:
    """Robot R1 steps by about 3 % in the fourth month; R9 was never measured."""

    def campaign(k: int, n: int) -> CampaignMeasured:
        value = 100 + 5 * k + 0.1 * ((7 * n + 3 * k) % 5) + (3 if k == 1 and n >= 3 else 0)
        measured = AxisMeasured({pose_key((0.0,)): in_pose([value], [100.0], [0.1])}, 1.0, 0.0)
        return CampaignMeasured(10 * n + k, START + timedelta(days=30 * n), {"joint_<2>": measured})

    robots = [RobotMeasured(f"R{k}", f"cell {k}", 6, tuple(campaign(k, n) for n in range(6))) for k in range(5)]
    robots.append(RobotMeasured("R9", None, 0, ()))
    return Fleet(made_at=AT, types=(survey("arm & hand", robots, FleetRules(0.01, 12, 31.0), AT),))


def test_tables_tell_who_changed_and_who_is_due() -> None:
    found = json.loads(fleet_page(fleet(), (("report", "a test"),)).written("json"))
    robots, axis = found["tables"][2:]
    assert robots["section"] == "arm & hand"
    by_robot = {row[0]: row[1:] for row in robots["rows"]}
    assert by_robot["R1"] == ["cell 1", "6", "2026-06-04", "now: since 2026-07-05", "joint_<2>", "–"]
    assert by_robot["R9"] == ["–", "0", "–", "now: never measured", "–", "–"]
    changed = next(row for row in axis["rows"] if row[0] == "R1")
    assert (changed[3], changed[5]) == ("step from campaign 31", "changed")
    assert 2.7 < float(changed[1]) < 3.3
    assert {row[0] for row in axis["rows"] if row[5] == "changed"} == {"R1"}


def test_the_page_has_a_chart_and_escapes_names() -> None:
    html = fleet_page(fleet(), (("report", "a test"),)).html()
    assert "arm &amp; hand" in html
    assert "joint_&lt;2&gt;" in html
    assert ">joint_<2>" not in html
    assert "change of J in %" in html


def test_the_command_prints_a_line_for_each_robot() -> None:
    head, *robots = fleet_lines(fleet())
    assert head == "arm & hand: 6 robots, 1 changed, 0 outliers, 6 due"
    assert len(robots) == 6
    (changed,) = (line for line in robots if "changed" in line)
    assert changed.startswith("  R1: measured 2026-06-04, 6 campaigns, due, joint_<2> changed by +")
    assert "(step at campaign 31)" in changed
    assert "  R9: never measured, 0 campaigns, due" in robots
    assert fleet_lines(Fleet(made_at=AT, types=())) == ["no robot of this plant was measured yet"]
