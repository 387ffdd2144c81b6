"""What the check of the data finds is told over HTTP: of an imported campaign, and of a diagnosis of it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.client import ServiceClient
from service.data_check import check, findings_document
from service.recording import Sweep
from service.robot import Robot
from tests.unit.service.api.test_api_diagnoses import imported, sweeps_of

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def client(url: str) -> Iterator[ServiceClient]:
    with ServiceClient(url) as client:
        yield client


def wrong(robot: Robot) -> list[Sweep]:
    """Sweeps whose torque has the wrong sign."""
    sweeps = sweeps_of(robot, 3, "forward_slow", "backward_slow")
    for sweep in sweeps:
        sweep.recording.effort[:] *= -1
    return sweeps


def checked(client: ServiceClient, campaign_id: int) -> dict[str, Any]:
    """The campaign once its data were checked; an event tells."""
    for event in client.events(campaign_id):
        if event["kind"] == "data_check":
            break
    return client.campaign(campaign_id)


def test_findings_stand_in_the_campaign_and_forbid_names_in_its_diagnosis(
    client: ServiceClient, http: httpx.Client, robot: Robot, tmp_path: Path
) -> None:
    sweeps = wrong(robot)
    campaign_id = imported(client, tmp_path, robot, sweeps)
    found = checked(client, campaign_id)["data_check"]
    assert found == findings_document(robot, sweeps, check(robot, sweeps))
    assert not found["axes"]["joint_1"]["trustworthy"]
    (finding,) = [one for one in found["findings"] if one["code"] == "effort_sign"]
    assert (finding["severity"], finding["axis"]) == ("wrong", "joint_1")
    diagnosis = client.diagnosed(client.add_diagnosis([campaign_id])["id"])
    axis = diagnosis["document"]["axes"]["joint_1"]
    assert (axis["verdict"], axis["effects"]) == ("unknown", [])
    assert "effort_sign" in [one["code"] for one in axis["data"]]
    report = http.get(f"/diagnoses/{diagnosis['id']}/report.html").text
    assert "Check of the data" in report
    assert finding["action"] in report


def test_a_sound_campaign_has_no_findings(client: ServiceClient, robot: Robot, tmp_path: Path) -> None:
    campaign_id = imported(client, tmp_path, robot, sweeps_of(robot, 4, "forward_slow", "backward_slow"))
    found = checked(client, campaign_id)["data_check"]
    assert found["axes"]["joint_1"]["trustworthy"]
    assert [one for one in found["findings"] if one["severity"] == "wrong"] == []
