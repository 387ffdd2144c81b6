"""A machine with a hidden effect, measured in one direction alone: the diagnosis asks for what separates the rivals.

Once with a person who approves, once by itself, as only the service of a virtual machine may.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest

from service.client import Json, ServiceClient, ServiceProblem
from tests.system.rest_bench import Service, VirtualMachine, serving, until, virtual_machine
from tests.system.test_diagnosis_campaign import AXIS, COULOMB, hiding

ROUNDS = 4
PATIENCE = 300.0  # s for a campaign or a diagnosis on a busy computer


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("loop")


@pytest.fixture(scope="module")
def machine(folder: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(folder, 100.0, scenario=hiding(folder)) as machine:
        yield machine


@pytest.fixture(scope="module")
def service(folder: Path, machine: VirtualMachine) -> Iterator[Service]:
    with serving(folder, machine.profile) as service:
        yield service


@pytest.fixture(scope="module")
def client(service: Service) -> Iterator[ServiceClient]:
    with ServiceClient(service.url) as client:
        yield client


@pytest.fixture(scope="module")
def one_way(client: ServiceClient) -> int:
    """A campaign as the paper runs it: one direction, offset and sines, once in each pose."""
    robot = next(robot for robot in client.robots() if robot["name"] == "max100-class")
    request: Json = {"kind": "diagnosis", "robot_id": robot["id"], "axes": [AXIS], "varied": ["joint_2"]}
    plan = client.add_plan(request | {"poses": 3, "blocks": ["forward_slow"], "repeats": 1})
    campaign = int(client.add_campaign(plan["id"])["id"])
    client.start(campaign)
    until(lambda: client.campaign(campaign)["state"] in ("measured", "completed"), "campaign measured", PATIENCE)
    return campaign


def continued(client: ServiceClient, diagnosis: Json) -> Json:
    """The diagnosis that goes on with another's experiment."""
    children: list[Json] = []

    def born() -> bool:
        children[:] = [one for one in client.diagnoses() if one["parent"] == diagnosis["id"]]
        return bool(children)

    until(born, "the diagnosis goes on", PATIENCE)
    return client.diagnosed(children[0]["id"])


def check_named(diagnosis: Json) -> None:
    assert (diagnosis["state"], diagnosis["verdicts"]) == ("done", {AXIS: "named"}), diagnosis["cause"]
    (effect,) = diagnosis["document"]["axes"][AXIS]["effects"]
    coulomb = effect["parameters"]["coulomb"]
    assert effect["effect"] == "coulomb_friction"
    assert abs(coulomb["value"] - COULOMB) < max(4 * coulomb["std"], 0.02 * COULOMB)


def test_a_person_approves_until_the_effect_has_a_name(
    client: ServiceClient, machine: VirtualMachine, one_way: int
) -> None:
    found = client.diagnosed(client.add_diagnosis([one_way])["id"])
    assert found["verdicts"] == {AXIS: "ambiguous"}, found["cause"]
    assert "coulomb_friction" in found["document"]["axes"][AXIS]["candidates"]
    campaigns = [one_way]
    while found["verdicts"][AXIS] == "ambiguous" and len(campaigns) <= ROUNDS:
        assert machine.stands()
        campaign = client.approve_experiment(found["id"], AXIS, "Ada")
        assert (campaign["state"], campaign["plan_id"] is not None) == ("running", True)
        experiment = client.diagnosis(found["id"])["experiment"]
        assert (experiment["campaign_id"], experiment["approved_by"]) == (campaign["id"], "Ada")
        with pytest.raises(ServiceProblem, match="already has an experiment"):
            client.approve_experiment(found["id"], AXIS, "Bob")
        campaigns.append(campaign["id"])
        found = continued(client, found)
        assert found["campaigns"] == campaigns
    check_named(found)

    model = client.accept_model(found["id"], "Ada")
    again = client.diagnosed(client.add_diagnosis(campaigns, model=model["id"])["id"])
    assert (again["state"], again["verdicts"]) == ("done", {AXIS: "none"}), again["cause"]


def test_the_loop_runs_alone_on_a_virtual_machine(client: ServiceClient, machine: VirtualMachine, one_way: int) -> None:
    found = client.diagnosed(client.add_diagnosis([one_way], unattended=True)["id"])
    rounds = 0
    while found["verdicts"] == {AXIS: "ambiguous"}:
        found, rounds = continued(client, found), rounds + 1
        assert rounds <= ROUNDS
        experiment = client.diagnosis(found["parent"])["experiment"]
        assert experiment["approved_by"] == "unattended"
    assert rounds >= 1
    check_named(found)
    until(lambda: not client.diagnosis(found["id"])["unattended"], "the loop is over")
    assert machine.stands()
