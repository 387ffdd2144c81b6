"""Each line that the service writes while a sweep is measured has its campaign and its sweep."""

import json
from pathlib import Path

import pytest

from service.client import Json, ServiceClient
from tests.system.rest_bench import PATIENT_LEASE, add_plan, release, serving, until, virtual_machine

pytestmark = pytest.mark.slow


def during_sweeps(lines: list[Json]) -> list[Json]:
    """Those from the beginning of a sweep up to its end."""
    found: list[Json] = []
    inside = False
    for line in lines:
        inside = inside or line["event"] == "sweep_begun"
        if inside:
            found.append(line)
        inside = inside and line["event"] not in ("recorded", "sweep_given_up")
    return found


def test_every_line_of_a_campaign_says_where_it_belongs(tmp_path: Path) -> None:
    """With a stop, a worker that is killed, a viewer and requests beside it; DEBUG: libraries speak too."""
    with (
        virtual_machine(tmp_path) as machine,
        serving(tmp_path, machine.profile, PATIENT_LEASE, log_level="DEBUG") as service,
        ServiceClient(service.url) as client,
    ):
        campaign = int(client.add_campaign(add_plan(client, axes=["joint_2", "joint_3"], poses=1))["id"])
        client.start(campaign)
        until(lambda: client.campaign(campaign)["progress"]["current"], "a sweep runs")
        client.stop("Ada", "a test")
        until(lambda: client.campaign(campaign)["state"] == "paused", "the campaign is paused")
        until(machine.stands, "the machine stands")
        release(client)
        client.resume(campaign, repeat=True)
        until(lambda: client.campaign(campaign)["progress"]["current"], "a sweep runs again")
        for worker in service.workers():
            worker.kill()
        until(lambda: client.campaign(campaign)["state"] == "completed", "the campaign is over")
        lines = [json.loads(line) for line in service.log().splitlines()]

    inside = during_sweeps(lines)
    events = {line["event"] for line in inside}
    assert {"sweep_begun", "check_move", "sweep_given_up", "recorded"} <= events
    assert {"stop", "worker_replaced"} <= {line["event"] for line in lines}  # maybe after the sweep's end
    assert [line for line in inside if line.get("campaign") != campaign or line.get("sweep") not in (1, 2)] == []
    assert {line["sweep"] for line in inside} == {1, 2}
    estimates = [line for line in lines if line["event"] == "estimate"]
    assert [(line["campaign"], line["sweep"]) for line in estimates] == [(campaign, 1), (campaign, 2)]
    before = lines[: lines.index(inside[0])]
    assert [line for line in before if "sweep" in line] == []
