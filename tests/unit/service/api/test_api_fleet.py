"""Robots of the plant over HTTP and by the command, from campaigns that the service has identified itself."""

import json
from pathlib import Path

import httpx
import pytest

from service.client import ServiceClient, ServiceProblem
from tests.command import sweepid

pytestmark = pytest.mark.slow

TYPE = "max100-class"


def test_a_robot_has_its_series_and_is_not_due(http: httpx.Client, campaigns: list[int]) -> None:
    (found,) = http.get("/fleet", params={"type": TYPE}).json()["types"]
    assert (found["name"], found["axes"], found["campaigns"]) == (TYPE, ["joint_1"], 12)
    (robot,) = found["robots"]
    assert (robot["serial"], robot["machine"], robot["due"], robot["changed"]) == (None, "machine", False, [])
    points = robot["axes"]["joint_1"]["points"]
    assert set(campaigns) <= {point["campaign"] for point in points}
    assert all(abs(point["difference_percent"]) < 1e-9 for point in points)


def test_all_types_are_those_that_were_measured(http: httpx.Client, campaigns: list[int]) -> None:
    assert campaigns
    types = [one["name"] for one in http.get("/fleet").json()["types"]]
    assert TYPE in types
    assert types == sorted(set(types))


def test_an_unknown_type_is_404_and_names_the_known_ones(http: httpx.Client) -> None:
    for path in ("/fleet", "/fleet/report", "/fleet/report.json"):
        answer = http.get(path, params={"type": "nobody"})
        assert answer.status_code == 404
        assert "no robot of the type 'nobody'; the types are: " in answer.json()["detail"]
        assert TYPE in answer.json()["detail"]


def test_the_report_is_a_page_and_its_tables(http: httpx.Client, campaigns: list[int]) -> None:
    page = http.get("/fleet/report", params={"type": TYPE})
    assert page.headers["content-type"] == "text/html; charset=utf-8"
    assert "change of J in %" in page.text
    tables = http.get("/fleet/report.json").json()["tables"]
    robots = next(table for table in tables if table["section"] == TYPE)
    assert robots["rows"][0][0] == "machine machine"
    assert int(robots["rows"][0][2]) >= len(campaigns)


def test_the_command_prints_and_writes(url: str, campaigns: list[int], tmp_path: Path) -> None:
    printed = sweepid(
        *("plant", "fleet", "--url", url, "--type", TYPE),
        *("--report", str(tmp_path / "fleet.html"), "--tables", str(tmp_path / "tables")),
    )
    assert printed.returncode == 0, printed.stderr
    head, robot = printed.stdout.splitlines()
    assert head == f"{TYPE}: 1 robots, 0 changed, 0 outliers, 0 due"
    assert robot.startswith("  machine machine: measured ")
    assert (tmp_path / "fleet.html").read_text("utf-8").startswith("<!doctype html>")
    assert json.loads((tmp_path / "tables" / "tables.json").read_text("utf-8"))["title"] == "Robots of the plant"
    found = json.loads(sweepid("plant", "fleet", "--url", url, "--type", TYPE, "--json", "-").stdout)
    assert found["types"][0]["robots"][0]["machine"] == "machine"
    assert campaigns


def test_the_client_raises_for_an_unknown_type(url: str) -> None:
    with ServiceClient(url) as client, pytest.raises(ServiceProblem, match="no robot of the type 'a b&c'"):
        client.fleet("a b&c")
