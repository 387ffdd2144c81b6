"""The runbook that diagnoses a deviation, on a machine with hidden Coulomb friction: dry, with a fault, to the name."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from service.client import Json, ServiceClient
from tests.system.rest_bench import PATIENT_LEASE, Service, VirtualMachine, serving, until, virtual_machine
from tests.system.test_diagnosis_campaign import AXIS, hiding
from tests.system.test_runbooks import BAD_INPUT, DONE, FAILED, STOPPED, Books, results

ROBOT = "max100-class"
DIAGNOSE = ("diagnose_axis", ROBOT, AXIS)
PATIENCE = 300.0  # s for a campaign or a diagnosis on a busy computer


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("diagnose")


@pytest.fixture(scope="module")
def machine(folder: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(folder, 50.0, scenario=hiding(folder)) as machine:
        yield machine


@pytest.fixture(scope="module")
def service(folder: Path, machine: VirtualMachine) -> Iterator[Service]:
    with serving(folder, machine.profile, PATIENT_LEASE) as service:
        yield service


@pytest.fixture(scope="module")
def client(service: Service) -> Iterator[ServiceClient]:
    with ServiceClient(service.url) as client:
        yield client


@pytest.fixture(scope="module")
def books(folder: Path, service: Service) -> Books:
    return Books(folder, service.url)


def one_way(client: ServiceClient) -> int:
    """A completed campaign in one direction, which cannot separate Coulomb friction from an offset."""
    robot = next(robot for robot in client.robots() if robot["name"] == ROBOT)
    request: Json = {"kind": "diagnosis", "robot_id": robot["id"], "axes": [AXIS], "varied": ["joint_2"]}
    plan = client.add_plan(request | {"poses": 3, "blocks": ["forward_slow"], "repeats": 1})
    campaign = int(client.add_campaign(plan["id"])["id"])
    client.start(campaign)
    until(lambda: client.campaign(campaign)["state"] == "completed", "campaign completed", PATIENCE)
    return campaign


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((ROBOT, "joint_9", "--varied", "joint_2"), "has no joint joint_9; it has: joint_1"),
        ((ROBOT, AXIS), "either --varied to measure, or --campaigns"),
        ((ROBOT, AXIS, "--campaigns", "first"), "first is not the number of a campaign"),
        (("nobody", AXIS, "--varied", "joint_2"), "has no robot nobody"),
    ],
)
def test_bad_input_is_reported_before_anything_moves(
    books: Books, client: ServiceClient, arguments: tuple[str, ...], reason: str
) -> None:
    known = len(client.campaigns())
    code, protocol, printed = books.run("diagnose_axis", *arguments, "--yes")
    assert (code, reason in printed, reason in protocol["result"]) == (BAD_INPUT, True, True), printed
    assert len(client.campaigns()) == known


def test_a_dry_run_gives_the_ranges_and_moves_nothing(
    books: Books, client: ServiceClient, machine: VirtualMachine
) -> None:
    known = len(client.campaigns())
    code, protocol, printed = books.run(*DIAGNOSE, "--varied", "joint_2", "--poses", "3", "--dry-run")
    assert code == DONE, printed
    assert results(protocol, "motion").keys() >= {AXIS, "joint_2"}
    assert (len(client.campaigns()), machine.stands()) == (known, True)


def test_a_fault_ends_it_and_the_machine_stands(books: Books, client: ServiceClient, machine: VirtualMachine) -> None:
    machine.order("fault", joint=AXIS, code=0x4310, at_sample=50)
    code, protocol, printed = books.run(*DIAGNOSE, "--varied", "joint_2", "--poses", "3", "--yes")
    assert code == FAILED, printed
    (paused,) = [step for step in protocol["steps"] if step.get("state") == "paused"]
    assert "4310h" in paused["cause"]
    assert client.diagnoses() == []
    until(machine.stands, "the axes stand")
    (faulty,) = [axis["joint"] for axis in client.drives()["axes"] if axis["fault"]]
    client.acknowledge(faulty)
    code, _, printed = books.run(*DIAGNOSE, "--campaigns", str(protocol["campaign"]))
    assert (code, "it must be completed" in printed) == (BAD_INPUT, True), printed
    client.abort(protocol["campaign"], "the test goes on")


def test_from_a_campaign_to_the_accepted_model(books: Books, client: ServiceClient, machine: VirtualMachine) -> None:
    campaign = one_way(client)
    code, protocol, printed = books.run(*DIAGNOSE, "--campaigns", str(campaign), typed="no\n")
    assert code == STOPPED, printed
    (undecided,) = results(protocol, "verdict").values()
    assert undecided["verdict"] == "ambiguous"
    assert results(protocol, "motion").keys() >= {AXIS}
    assert machine.stands()
    assert [one["id"] for one in client.campaigns()][-1] == campaign

    code, protocol, printed = books.run(*DIAGNOSE, "--campaigns", str(campaign), "--yes")
    assert code == DONE, printed
    verdicts = [step["verdict"] for step in protocol["steps"] if "verdict" in step]
    assert (verdicts[0], verdicts[-1]) == ("ambiguous", "named")
    assert any(step["step"].startswith("sweep ") for step in protocol["steps"])
    (model,) = client.models()
    assert [step["model"] for step in protocol["steps"] if "model" in step] == [model["id"]]
    (effect,) = client.diagnosis(client.diagnoses()[-1]["id"])["document"]["axes"][AXIS]["effects"]
    assert effect["effect"] == "coulomb_friction"
    assert machine.stands()
