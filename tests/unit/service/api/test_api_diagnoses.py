"""Check of the data and diagnosis over HTTP, from imported campaigns to an accepted model; nothing can move here."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import yaml

from service import BadInput
from service.data_check import check, findings_document
from service.diagnosis.experiments import MOST_EXPERIMENTS
from service.diagnosis.sensitivity import expected
from service.identification.design.diagnosis_sweeps import DesignedSweep, full_design
from service.model import Robot, Sweep, SweepSpec
from service.store.files.bundle import write_bundle
from service.web.client import ServiceClient, ServiceProblem
from tests.unit.service.api.conftest import packed

pytestmark = pytest.mark.slow

POSES = ((0.0, -0.6, 0.4, 0.0, 0.0, 0.0), (0.5, 0.4, -0.7, 0.0, 0.0, 0.0), (-0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
FRICTION = 60.0  # N m, dry, that the model does not know


def sweeps_of(robot: Robot, seed: int, *blocks: str) -> list[Sweep]:
    return run(full_design(robot, "joint_1", np.array(POSES), sample_rate=250.0, blocks=blocks), seed)


def run(designed: Sequence[DesignedSweep], seed: int) -> list[Sweep]:
    """The vertical axis with dry friction and 3 N m of noise."""
    random = np.random.default_rng(seed)
    sweeps: list[Sweep] = []
    for one in designed:
        sweep = expected(one, one.spec.pose[0])
        record = sweep.recording
        turning = np.gradient(record.velocity, record.time)
        friction = FRICTION * np.sign(record.velocity) + 200.0 * record.velocity
        record.effort[:] = 300.0 * turning + friction + random.normal(0, 3.0, len(record.time))
        sweeps.append(sweep)
    return sweeps


def imported(client: ServiceClient, folder: Path, robot: Robot, sweeps: list[Sweep]) -> int:
    """A campaign of these sweeps; a diagnosis does not wait until they are identified."""
    folder.mkdir(exist_ok=True)
    write_bundle(folder / "bundle", robot, sweeps)
    (folder / "bundle.zip").write_bytes(packed(folder / "bundle"))
    return int(client.import_bundle(folder / "bundle.zip")["id"])


@pytest.fixture(scope="module")
def client(url: str) -> Iterator[ServiceClient]:
    with ServiceClient(url) as client:
        yield client


@pytest.fixture(scope="module")
def forward(client: ServiceClient, robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> int:
    """A campaign in one direction: many effects look alike in it."""
    return imported(client, tmp_path_factory.mktemp("forward"), robot, sweeps_of(robot, 1, "forward_slow"))


@pytest.fixture(scope="module")
def both_ways(client: ServiceClient, robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> int:
    """A campaign of a later day."""
    sweeps = sweeps_of(robot, 2, "forward_slow", "backward_slow")
    return imported(client, tmp_path_factory.mktemp("both"), robot, sweeps)


@pytest.fixture(scope="module")
def ambiguous(client: ServiceClient, forward: int) -> dict[str, Any]:
    return client.diagnosed(client.add_diagnosis([forward], start="cad")["id"])  # whatever else was imported


@pytest.fixture(scope="module")
def named(client: ServiceClient, forward: int, both_ways: int) -> dict[str, Any]:
    return client.diagnosed(client.add_diagnosis([both_ways, forward, both_ways], ["joint_1"], start="cad")["id"])


def test_asking_twice_gives_one_diagnosis_and_a_place_to_look(http: httpx.Client, forward: int) -> None:
    wanted = {"campaigns": [forward]}
    answers = [http.post("/diagnoses", json=wanted, headers={"Idempotency-Key": "ask"}) for _ in range(2)]
    assert [answer.status_code for answer in answers] == [202, 202]
    first, again = (answer.json() for answer in answers)
    assert first == again
    assert (first["state"], first["document"], first["verdicts"]) == ("waiting", None, {})
    assert http.get(answers[0].headers["location"]).json()["id"] == first["id"]


def test_what_is_open_names_rivals_and_the_experiment_between_them(
    client: ServiceClient, http: httpx.Client, ambiguous: dict[str, Any]
) -> None:
    assert (ambiguous["state"], ambiguous["cause"]) == ("done", "")
    axis = ambiguous["document"]["axes"]["joint_1"]
    assert axis["verdict"] == "ambiguous" == ambiguous["verdicts"]["joint_1"]
    assert "coulomb_friction" in axis["candidates"]
    experiment = axis["next_experiment"]
    plan = client.plan_experiment(ambiguous["id"], "joint_1", "workshop")
    assert client.plan(plan["id"]) == plan
    planned = [(sweep["spec"]["axis"], sweep["spec"]["block"]) for sweep in plan["document"]["sweeps"]]
    assert {block for _, block in planned} <= set(experiment["blocks"])
    assert {joint for joint, _ in planned} == {"joint_1"}
    again = client.plan_experiment(ambiguous["id"], "joint_1")  # in the cell of the machine
    assert again["document"] == plan["document"]
    with pytest.raises(ServiceProblem, match="the verdict is ambiguous, not named"):
        client.accept_model(ambiguous["id"], "Ada")


def test_what_is_proposed_leads_to_a_name(
    client: ServiceClient, robot: Robot, ambiguous: dict[str, Any], tmp_path: Path
) -> None:
    """Each experiment as planned, until none is proposed."""
    found, campaigns = ambiguous, list(ambiguous["campaigns"])
    while found["verdicts"]["joint_1"] == "ambiguous":
        assert len(campaigns) <= MOST_EXPERIMENTS, found["document"]["axes"]["joint_1"]["summary"]
        planned = client.plan_experiment(found["id"], "joint_1")["document"]["sweeps"]
        designed = [DesignedSweep(SweepSpec(**one["spec"]), one["ramp"], one["settle"]) for one in planned]
        campaigns.append(imported(client, tmp_path / str(len(campaigns)), robot, run(designed, len(campaigns))))
        found = client.diagnosed(client.add_diagnosis(campaigns, start="cad")["id"])
    axis = found["document"]["axes"]["joint_1"]
    assert [effect["effect"] for effect in axis["effects"]] == ["coulomb_friction"]
    assert (axis["verdict"], axis["next_experiment"]) == ("named", None)


def test_an_experiment_that_cannot_begin_leaves_nothing(
    client: ServiceClient, http: httpx.Client, ambiguous: dict[str, Any]
) -> None:

    def stored() -> tuple[int, int]:
        return len(client.campaigns()), len(http.get("/plans", params={"limit": 200}).json()["items"])

    before = stored()
    approval = {"axis": "joint_1", "approved_by": "Ada", "cell": "workshop"}
    path = f"/diagnoses/{ambiguous['id']}/experiment"
    answer = http.post(path, json=approval)
    assert (answer.status_code, answer.json()["type"]) == (503, "urn:sweepid:problem:connection-failed")
    for wrong, pointer in (
        ({"approved_by": "  "}, "#/approved_by"),
        ({"axis": "joint_9"}, "axis"),
        ({"test_mass": {"mass": 20.0, "center": [0, 0, 0.1]}}, "test_mass"),
        ({"test_mass": {"mass": -1.0, "center": [0, 0, 0.1]}}, "#/test_mass/mass"),
    ):
        answer = http.post(path, json=approval | wrong)
        assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, pointer), answer.text
    assert stored() == before
    assert client.diagnosis(ambiguous["id"])["experiment"] is None


def test_evidence_of_two_days_stands_on_one_clock(
    named: dict[str, Any], ambiguous: dict[str, Any], forward: int, both_ways: int
) -> None:
    assert named["campaigns"] == [forward, both_ways]
    axis = named["document"]["axes"]["joint_1"]
    assert (axis["verdict"], axis["candidates"]) == ("named", [])
    (effect,) = axis["effects"]
    assert effect["effect"] == "coulomb_friction"
    assert effect["parameters"]["coulomb"]["value"] == pytest.approx(FRICTION, abs=1.5)
    blocks = {cell["value"] for cell in axis["where"] if cell["dimension"] == "block"}
    assert {"forward_slow", "backward_slow", f"forward_slow of campaign {both_ways}"} <= blocks


def test_it_is_shown_as_figures_and_as_a_page(client: ServiceClient, http: httpx.Client, named: dict[str, Any]) -> None:
    figures = http.get(f"/diagnoses/{named['id']}/figures").json()["axes"]["joint_1"]
    assert {"map", "gap_by_pose", "example"} <= set(figures)
    assert all({"data", "layout"} <= set(figure) for figure in figures.values())
    page = client.diagnosis_report(named["id"]).decode()
    assert page.startswith("<!doctype html>")
    assert "Coulomb friction" in page


def test_a_list_tells_verdicts_without_documents(
    client: ServiceClient, http: httpx.Client, named: dict[str, Any]
) -> None:
    page = http.get("/diagnoses", params={"limit": 1}).json()
    assert page["next"] == page["items"][0]["id"]
    entry = next(entry for entry in client.diagnoses() if entry["id"] == named["id"])
    assert (entry["verdicts"], "document" in entry) == ({"joint_1": "named"}, False)


def test_what_is_accepted_is_a_model_and_the_next_diagnosis_finds_nothing_more(
    client: ServiceClient, http: httpx.Client, named: dict[str, Any]
) -> None:
    with pytest.raises(BadInput, match="joint_2 is not an axis"):
        client.accept_model(named["id"], "Ada", ["joint_2"])
    answer = http.post(f"/diagnoses/{named['id']}/model", json={"accepted_by": "Ada"})
    model = answer.json()
    assert answer.status_code == 201, answer.text
    assert http.get(answer.headers["location"]).json() == model
    assert (model["accepted_by"], model["parent"], model["diagnosis_id"]) == ("Ada", None, named["id"])
    axis = model["document"]["axes"]["joint_1"]
    assert [effect["effect"] for effect in axis["effects"]] == ["coulomb_friction"]
    assert client.models(named["robot_id"])[-1] == model == client.model(model["id"])
    scenario = yaml.safe_load(client.model_scenario(model["id"]))
    assert scenario["axes"]["joint_1"]["train"]["motor_friction"]["coulomb"] == pytest.approx(FRICTION, abs=1.5)
    with pytest.raises(ServiceProblem, match=f"was already accepted as model {model['id']}"):
        client.accept_model(named["id"], "Bob")

    again = client.diagnosed(client.add_diagnosis(named["campaigns"], model=model["id"])["id"])
    assert (again["model"], again["verdicts"]) == (model["id"], {"joint_1": "none"})


def test_what_cannot_be_diagnosed_is_refused(
    client: ServiceClient, http: httpx.Client, robot: Robot, forward: int, tmp_path: Path
) -> None:
    description = robot.description.model_copy(update={"name": "another"})
    another = Robot(description, robot.urdf_text)
    foreign = imported(client, tmp_path, another, sweeps_of(another, 3, "forward_slow")[:2])
    for body, status, words in (
        ({"campaigns": [forward, foreign]}, 409, "select campaigns of one robot"),
        ({"campaigns": [forward], "axes": ["joint_2"]}, 422, "joint_2 has no complete sweep that moves"),
        ({"campaigns": [forward], "model": 999999}, 422, "model: model 999999 does not exist"),
        ({"campaigns": [forward], "unattended": True}, 409, "the settings do not mark this machine as virtual"),
    ):
        answer = http.post("/diagnoses", json=body)
        assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json")
        assert words in answer.text


# -- check of the data


def checked(client: ServiceClient, campaign_id: int) -> dict[str, Any]:
    """What the campaign says once its data were checked; an event tells."""
    next(event for event in client.events(campaign_id) if event["kind"] == "data_check")
    return client.campaign(campaign_id)["data_check"]


def test_findings_stand_in_the_campaign_and_forbid_names_in_its_diagnosis(
    client: ServiceClient, http: httpx.Client, robot: Robot, tmp_path: Path
) -> None:
    """The torque has the wrong sign."""
    sweeps = sweeps_of(robot, 3, "forward_slow", "backward_slow")
    for sweep in sweeps:
        sweep.recording.effort[:] *= -1
    campaign_id = imported(client, tmp_path, robot, sweeps)
    found = checked(client, campaign_id)
    assert found == findings_document(robot, sweeps, check(robot, sweeps)).as_json()
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
