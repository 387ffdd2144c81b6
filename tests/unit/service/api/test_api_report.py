"""The report of a campaign over HTTP and by the command; no machine answers, so nothing can move."""

import hashlib
import io
import json
import re
from pathlib import Path
from typing import Any

import httpx
import pytest
from pypdf import PdfReader

from service.client import ServiceClient
from tests.command import sweepid
from tests.programs import needs
from tests.unit.service.api.test_api_bundles import packed

pytestmark = pytest.mark.slow

PLAN: dict[str, Any] = {
    "cell": "workshop",
    "axes": ["joint_1"],
    "varied": ["joint_2"],
    "poses": 1,
    "modes": "one_host_streamed",
}


@pytest.fixture(scope="module")
def campaign(url: str, bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> int:
    """Three sweeps, identified and checked."""
    archive = tmp_path_factory.mktemp("report") / "bundle.zip"
    archive.write_bytes(packed(bundle))
    with ServiceClient(url) as client:
        number = int(client.import_bundle(archive)["id"])
        wanted = {"completed", "checked"}
        for event in client.events(number):
            wanted -= {event["data"].get("state"), "checked" if event["kind"] == "data_check" else ""}
            if not wanted:
                break
    return number


def test_the_report_is_one_page_with_verdict_and_origin(http: httpx.Client, campaign: int, folder: Path) -> None:
    answer = http.get(f"/campaigns/{campaign}/report")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")
    page = answer.text
    body = page.partition("<main>")[2].partition("</main>")[0]
    for words in (
        "no diagnosis was made",
        "Identified from 3 sweeps; revision 3 of the estimate.",
        "Drives",
        "Inertia of the axes over the poses",
        "Convergence",
        "One sweep",
        "Check of the data",
    ):
        assert words in body
    robot = http.get(f"/campaigns/{campaign}").json()["robot_id"]
    assert f"max100-class, number {robot} of this service" in body
    # as `sha256sum FILE ... | sha256sum` in the data folder tells it
    recordings = list_told(folder / "data", body)
    listed = "".join(f"{hash_of(path)}  {path.relative_to(folder / 'data').as_posix()}\n" for path in recordings)
    assert hashlib.sha256(listed.encode()).hexdigest() in body


def hash_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def list_told(data: Path, body: str) -> list[Path]:
    """The recordings of the import whose list has the SHA-256 that the report tells; others have the same content."""
    told = re.search(r"3, SHA-256 ([0-9a-f]{64}) of their list", body)
    assert told
    for folder in data.glob("recordings/import-*"):
        paths = sorted(folder.glob("*-1.parquet"))
        text = "".join(f"{hash_of(path)}  recordings/{folder.name}/{path.name}\n" for path in paths)
        if hashlib.sha256(text.encode()).hexdigest() == told[1]:
            return paths
    raise AssertionError(f"no folder of recordings has the list {told[1]}")


@needs("pango")
def test_the_report_as_pdf(http: httpx.Client, campaign: int) -> None:
    answer = http.get(f"/campaigns/{campaign}/report.pdf")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/pdf")
    text = " ".join(" ".join(page.extract_text() for page in PdfReader(io.BytesIO(answer.content)).pages).split())
    for words in ("no diagnosis was made", "Origin", "Figure 1. Inertia of the axes", "sweepid 0."):
        assert words in text


def test_the_tables_of_the_report(http: httpx.Client, campaign: int) -> None:
    answer = http.get(f"/campaigns/{campaign}/report.json")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/json")
    sections = [table["section"] for table in answer.json()["tables"]]
    assert {"Origin", "How well the models fit", "Base parameters"} <= set(sections)
    assert http.get(f"/campaigns/{campaign}/report.docx").status_code == 422


def test_what_has_nothing_to_report_is_refused_in_one_line(http: httpx.Client, url: str, tmp_path: Path) -> None:
    robot = next(one["id"] for one in http.get("/robots").json()["items"] if one["name"] == "max100-class")
    plan = http.post("/plans", json=PLAN | {"robot_id": robot})
    assert plan.status_code == 201, plan.text
    planned = http.post("/campaigns", json={"plan_id": plan.json()["id"]}).json()["id"]
    for number, status, words in (
        (planned, 409, f"campaign {planned} (planned) has no identified sweep yet, there is nothing to report"),
        (999999, 404, "campaign 999999 does not exist"),
    ):
        answer = http.get(f"/campaigns/{number}/report")
        assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
        assert answer.json()["detail"] == words
        done = sweepid("report", str(number), str(tmp_path / "none.html"), "--url", url)
        assert (done.returncode, done.stdout, done.stderr) == (1, "", f"sweepid: {words}\n")
    assert not (tmp_path / "none.html").exists()


def test_the_command_writes_the_page(url: str, campaign: int, tmp_path: Path) -> None:
    file = tmp_path / "report.html"
    done = sweepid("report", str(campaign), str(file), "--url", url)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{file}\n", "")
    assert file.read_text("utf-8").startswith("<!doctype html>")
    tables = tmp_path / "tables"
    done = sweepid("report", str(campaign), "--tables", str(tables), "--url", url)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{tables}\n", "")
    assert (tables / "01-origin.csv").read_text("utf-8").startswith(",value\nrobot,")
    assert json.loads((tables / "tables.json").read_text("utf-8"))["tables"][0]["section"] == "Origin"
    done = sweepid("report", str(campaign), str(tmp_path / "no" / "report.html"), "--url", url)
    assert (done.returncode, done.stdout) == (2, "")
    assert "cannot be written: No such file" in done.stderr
