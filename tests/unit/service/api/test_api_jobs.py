"""Stored campaigns identified again: over HTTP and by the command, with progress and cancel."""

import json

import httpx
import pytest

from service.client import ServiceClient
from service.errors import BadInput
from tests.command import sweepid
from tests.unit.service.api.conftest import CAMPAIGNS

pytestmark = pytest.mark.slow


def test_the_same_program_finds_the_same(url: str, campaigns: list[int], http: httpx.Client) -> None:
    """To 1e-9, and the stored estimates stay as they are."""
    with ServiceClient(url) as client:
        before = {number: client.estimate(number) for number in campaigns}
        job = client.add_job(campaigns)
        assert (job["campaigns"], job["kind"], job["asked_by"]) == (CAMPAIGNS, "reidentify", "local")
        over = client.job_over(int(job["id"]))
        assert (over["state"], over["done"], over["failed"], over["sweeps"]) == ("done", CAMPAIGNS, 0, 3 * CAMPAIGNS)
        results = client.job_results(int(job["id"]))
        assert {number: client.estimate(number) for number in campaigns} == before
    assert [one["campaign_id"] for one in results] == campaigns
    assert all(one["change_percent"] < 1e-7 for one in results)
    new = http.get(f"/jobs/{job['id']}/results/{campaigns[0]}").json()["document"]
    for one, old in zip(
        new["axes"]["joint_1"]["inertia"], before[campaigns[0]]["document"]["axes"]["joint_1"]["inertia"], strict=True
    ):
        assert one["value"] == pytest.approx(old["value"], rel=1e-9)
    assert http.get(f"/jobs/{job['id']}/results/999999").status_code == 404


def test_a_job_that_is_cancelled_stays_so(url: str, campaigns: list[int]) -> None:
    with ServiceClient(url) as client:
        job = int(client.add_job(None)["id"])
        cancelled = client.cancel_job(job)
        assert cancelled["state"] in ("cancelled", "done")  # it may have been faster
        assert client.cancel_job(job) == client.job(job)
        assert client.job_over(job)["state"] == cancelled["state"]
        assert job in {one["id"] for one in client.jobs()}
    assert campaigns


def test_what_cannot_be_is_refused(url: str, http: httpx.Client, campaigns: list[int]) -> None:
    with ServiceClient(url) as client, pytest.raises(BadInput):
        client.add_job([0])
    assert http.post("/jobs", json={"campaigns": [999999]}).status_code == 404
    assert http.post("/jobs", json={"kind": "nothing"}).status_code == 422
    assert http.get("/jobs/999999").status_code == 404
    assert http.post("/jobs/999999/cancel").status_code == 404
    assert campaigns


def test_the_command(url: str, campaigns: list[int]) -> None:
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
