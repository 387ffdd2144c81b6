"""What becomes of identified campaigns, over HTTP and by command: convergence, report, robots of the plant, jobs."""

import hashlib
import json
import re
from pathlib import Path

import httpx
import pytest

from service.web.client import ServiceClient, ServiceProblem
from tests.command import sweepid
from tests.system.rest_bench import add_plan
from tests.unit.service.api.conftest import identified

pytestmark = pytest.mark.slow

TYPE = "max100-class"
CAMPAIGNS = 3


@pytest.fixture(scope="module")
def campaigns(url: str, bundle: Path, campaign: int) -> list[int]:
    """The same three sweeps, imported and identified `CAMPAIGNS` times: a robot that does not change at all."""
    return [campaign, *(identified(url, bundle) for _ in range(CAMPAIGNS - 1))]


def test_the_convergence_of_a_campaign_has_a_line_a_revision(http: httpx.Client, url: str, campaign: int) -> None:
    with ServiceClient(url) as client:
        estimates = client.estimates(campaign)
    told = http.get(f"/campaigns/{campaign}/estimates/convergence").json()
    assert told["wanted"] is None
    assert [(one["revision"], one["sweep"]) for one in told["revisions"]] == [
        (one["revision"], one["number"]) for one in estimates
    ]
    for one, estimate in zip(told["revisions"], estimates, strict=True):
        percent = estimate["document"]["axes"]["joint_1"]["confidence_percent"]
        assert one["percent"] == {"joint_1": None if percent is None else pytest.approx(percent)}


# -- report


def hash_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def listed(data: Path, folder: Path) -> str:
    """As `sha256sum FILE ...` in the data folder lists the recordings of an import."""
    paths = sorted(folder.glob("*-1.parquet"))
    return "".join(f"{hash_of(path)}  {path.relative_to(data).as_posix()}\n" for path in paths)


def test_the_report_is_one_page_with_verdict_and_origin(http: httpx.Client, campaign: int, folder: Path) -> None:
    answer = http.get(f"/campaigns/{campaign}/report")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")
    body = answer.text.partition("<main>")[2].partition("</main>")[0]
    robot = http.get(f"/campaigns/{campaign}").json()["robot_id"]
    for words in (
        *("no diagnosis was made", "Identified from 3 sweeps; revision 3 of the estimate.", "Drives", "Convergence"),
        *("Inertia of the axes over the poses", "One sweep", "Check of the data"),
        f"max100-class, number {robot} of this service",
    ):
        assert words in body
    told = re.search(r"3, SHA-256 ([0-9a-f]{64}) of their list", body)
    assert told
    lists = [listed(folder / "data", one) for one in (folder / "data").glob("recordings/import-*")]
    assert told[1] in [hashlib.sha256(one.encode()).hexdigest() for one in lists]


def test_the_sheet_for_a_control(http: httpx.Client, campaign: int) -> None:
    answer = http.get(f"/campaigns/{campaign}/sheet.md")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/markdown; charset=utf-8")
    revision = http.get(f"/campaigns/{campaign}/estimates/latest").json()["revision"]
    assert f"Source: estimate {revision} of campaign {campaign}." in answer.text
    assert "## What differs from CAD" in answer.text


def test_the_command_writes_the_report_or_refuses_in_one_line(
    http: httpx.Client, url: str, campaign: int, tmp_path: Path
) -> None:
    def report(number: int, *words: str) -> tuple[int, str, str]:
        done = sweepid("report", str(number), *words, "--url", url)
        return done.returncode, done.stdout, done.stderr

    file, tables, none = tmp_path / "report.html", tmp_path / "tables", tmp_path / "none.html"
    assert report(campaign, str(file)) == (0, f"{file}\n", "")
    assert file.read_text("utf-8").startswith("<!doctype html>")
    assert report(campaign, "--tables", str(tables)) == (0, f"{tables}\n", "")
    assert (tables / "02-origin.csv").read_text("utf-8").startswith(",value\nrobot,")
    assert json.loads((tables / "tables.json").read_text("utf-8"))["tables"][1]["section"] == "Origin"
    code, out, err = report(campaign, str(file / "report.html"))
    assert (code, out, "cannot be written: Not a directory" in err) == (2, "", True)
    with ServiceClient(url) as client:
        planned = int(client.add_campaign(add_plan(client, axes=["joint_1"], varied=["joint_2"], poses=1))["id"])
    words = f"campaign {planned} (planned) has no identified sweep yet, there is nothing to report"
    refused = http.get(f"/campaigns/{planned}/report")
    assert (refused.status_code, refused.json()["detail"]) == (409, words)
    assert report(planned, str(none)) == (1, "", f"sweepid: {words}\n")
    assert not none.exists()


# -- robots of the plant


def test_a_robot_has_its_series_and_is_not_due(http: httpx.Client, campaigns: list[int]) -> None:
    types = [one["name"] for one in http.get("/fleet").json()["types"]]
    assert types == sorted(set(types))
    assert TYPE in types
    (found,) = http.get("/fleet", params={"type": TYPE}).json()["types"]
    assert (found["name"], found["axes"], found["campaigns"]) == (TYPE, ["joint_1"], 12)
    (robot,) = found["robots"]
    assert (robot["serial"], robot["machine"], robot["due"], robot["changed"]) == (None, "machine", False, [])
    points = robot["axes"]["joint_1"]["points"]
    assert set(campaigns) <= {point["campaign"] for point in points}
    assert all(abs(point["difference_percent"]) < 1e-9 for point in points)
    page = http.get("/fleet/report", params={"type": TYPE})
    assert page.headers["content-type"] == "text/html; charset=utf-8"
    assert "change of J in %" in page.text
    tables = http.get("/fleet/report.json").json()["tables"]
    rows = next(table["rows"] for table in tables if table["section"] == TYPE)
    assert rows[0][0] == "machine machine"
    assert int(rows[0][2]) >= len(campaigns)


@pytest.mark.usefixtures("campaigns")
def test_the_command_prints_and_writes_the_fleet(url: str, tmp_path: Path) -> None:
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
    with ServiceClient(url) as client, pytest.raises(ServiceProblem, match="no robot of the type 'a b&c'"):
        client.fleet("a b&c")


# -- payloads


def test_a_payload_is_ordered_once_and_read(http: httpx.Client, campaigns: list[int]) -> None:
    """Sweeps of one vertical axis do not excite the mass: that is part of the answer."""
    pair = {"before": campaigns[0], "after": campaigns[1]}
    asked = [http.post("/payloads", json=pair, headers={"Idempotency-Key": "a payload"}) for _ in range(2)]
    assert [one.status_code for one in asked] == [202, 202]
    assert asked[0].json() == asked[1].json()
    assert asked[1].headers["idempotency-replayed"] == "true"
    number = asked[0].json()["id"]
    assert asked[0].headers["location"].endswith(f"/payloads/{number}")
    with ServiceClient(str(http.base_url).partition("/api")[0]) as client:
        found = client.payload_over(**pair)
    assert (found["state"], found["cause"], found["document"]["mass"]["excited"]) == ("done", "", False)
    assert found["no_sheet"].startswith(f"payload {found['id']}: lacks mass, ")
    listed = http.get("/payloads").json()["items"]
    assert [one["id"] for one in listed] == [number, found["id"]]
    assert http.get(f"/payloads/{found['id']}").json() == found
    sheet = http.get(f"/payloads/{found['id']}/sheet.md")
    assert (sheet.status_code, sheet.json()["detail"]) == (422, found["no_sheet"])
    refused = http.post("/payloads", json=pair | {"after": campaigns[0]})
    assert (refused.status_code, refused.json()["errors"][0]["pointer"]) == (422, "after")


# -- stored campaigns identified again


def test_the_command_of_a_job(url: str, campaigns: list[int]) -> None:
    done = sweepid("plant", "reidentify", "--campaign", str(campaigns[1]), "--wait", "--url", url)
    assert done.returncode == 0, done.stderr
    number = done.stdout.split()[1]
    assert done.stdout == f"job {number} (reidentify, machine): done, 1 of 1 campaigns, 3 sweeps\n"
    shown = sweepid("plant", "job", number, "--url", url).stdout.splitlines()
    assert shown[1].startswith(f"  campaign {campaigns[1]}: 3 sweeps, J changed by ")
    assert json.loads(sweepid("plant", "job", number, "--json", "--url", url).stdout.splitlines()[1])["sweeps"] == 3
    assert done.stdout.strip() in sweepid("plant", "jobs", "--url", url).stdout.splitlines()
    again = sweepid("plant", "cancel", number, "--url", url)
    assert again.stdout == done.stdout  # it is over
