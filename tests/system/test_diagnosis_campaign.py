"""A machine that hides an effect, diagnosed over the wire until it has a name: by a person, alone, by the runbook."""

from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from service.diagnosis.experiments import MOST_EXPERIMENTS
from service.web.client import Json, ServiceClient, ServiceProblem
from tests.command import sweepid
from tests.system.rest_bench import CONFIG, Service, VirtualMachine, serving, until, virtual_machine
from tests.system.test_runbooks import BAD_INPUT, DONE, FAILED, STOPPED, Books, results

AXIS = "joint_1"
COULOMB = 90.0  # N m, that nobody told the model of
ROBOT = "max100-class"
DIAGNOSE = ("diagnose_axis", ROBOT, AXIS)
MEASURE = (*DIAGNOSE, "--varied", "joint_2", "--poses", "3")
PATIENCE = 300.0  # s for a campaign or a diagnosis on a busy computer


def hiding(folder: Path) -> Path:
    """The rigid machine with the noise of the full one; all friction is viscous but for one axis."""
    content = yaml.safe_load((CONFIG / "scenarios" / "max100-rigid.yaml").read_text("utf-8"))
    content["robot"] = str(CONFIG / "robots" / "max100-class.yaml")
    for joint, axis in content["axes"].items():
        axis["train"]["motor_friction"]["coulomb"] = COULOMB if joint == AXIS else 0.0
        axis["train"]["load_friction"]["coulomb"] = 0.0
    content["measurement"] = {"effort_noise": 0.002, "velocity_noise": 5e-6, "position_noise": 2e-8}
    path = folder / "hiding.yaml"
    path.write_text(yaml.safe_dump(content), "utf-8")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("diagnosis")


@pytest.fixture(scope="module")
def machine(folder: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(folder, 50.0, scenario=hiding(folder)) as machine:
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
def books(folder: Path, service: Service) -> Books:
    return Books(folder, service.url)


def measured(client: ServiceClient, plan: int) -> int:
    """The campaign of a plan, run to its end."""
    campaign = int(client.add_campaign(plan)["id"])
    client.start(campaign)
    until(lambda: client.campaign(campaign)["state"] not in ("running", "measured"), "campaign over", PATIENCE)
    state = client.campaign(campaign)
    assert (state["state"], state["cause"]) == ("completed", "")
    return campaign


@pytest.fixture(scope="module")
def one_way(client: ServiceClient) -> int:
    return measured_one_way(client)


def measured_one_way(client: ServiceClient) -> int:
    """A campaign as the paper runs it: one direction, offset and sines, once in each pose."""
    robot = next(robot for robot in client.robots() if robot["name"] == ROBOT)
    request: Json = {"kind": "diagnosis", "robot_id": robot["id"], "axes": [AXIS], "varied": ["joint_2"]}
    plan = client.add_plan(request | {"poses": 3, "blocks": ["forward_slow"], "repeats": 1})["id"]
    campaign = measured(client, plan)
    starts = [sweep["spec"]["started_at"] for sweep in client.sweeps(campaign)]
    assert starts == sorted(starts)
    assert starts != [sweep["spec"]["started_at"] for sweep in client.plan(plan)["document"]["sweeps"]]  # as measured
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


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ((ROBOT, "joint_9", "--varied", "joint_2"), "has no joint joint_9; it has: joint_1"),
        ((ROBOT, AXIS, "--campaigns", "first"), "first is not the number of a campaign"),
    ],
)
def test_bad_input_is_reported_before_anything_moves(
    books: Books, client: ServiceClient, arguments: tuple[str, ...], reason: str
) -> None:
    known = len(client.campaigns())
    code, protocol, printed = books.run("diagnose_axis", *arguments, "--yes")
    assert (code, reason in printed, reason in protocol["result"]) == (BAD_INPUT, True, True), printed
    assert len(client.campaigns()) == known


def test_a_fault_ends_it_and_the_machine_stands(books: Books, client: ServiceClient, machine: VirtualMachine) -> None:
    known = client.diagnoses()
    machine.order("fault", joint=AXIS, code=0x4310, at_sample=50)
    code, protocol, printed = books.run(*MEASURE, "--yes")
    assert code == FAILED, printed
    (paused,) = [step for step in protocol["steps"] if step.get("state") == "paused"]
    assert "4310h" in paused["cause"]
    assert client.diagnoses() == known
    until(machine.stands, "the axes stand")
    (faulty,) = [axis["joint"] for axis in client.drives()["axes"] if axis["fault"]]
    client.acknowledge(faulty)
    code, _, printed = books.run(*DIAGNOSE, "--campaigns", str(protocol["campaign"]))
    assert (code, "it must be completed" in printed) == (BAD_INPUT, True), printed
    client.abort(protocol["campaign"], "the test goes on")


def test_a_person_approves_until_the_effect_has_a_name(
    client: ServiceClient, machine: VirtualMachine, one_way: int
) -> None:
    found = client.diagnosed(client.add_diagnosis([one_way])["id"])
    assert found["verdicts"] == {AXIS: "ambiguous"}, found["cause"]
    assert "coulomb_friction" in found["document"]["axes"][AXIS]["candidates"]
    campaigns = [one_way]
    while found["verdicts"][AXIS] == "ambiguous" and len(campaigns) <= MOST_EXPERIMENTS:
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
        assert rounds <= MOST_EXPERIMENTS
        experiment = client.diagnosis(found["parent"])["experiment"]
        assert experiment["approved_by"] == "unattended"
    assert rounds >= 1
    check_named(found)
    until(lambda: not client.diagnosis(found["id"])["unattended"], "the loop is over")
    assert machine.stands()


def test_the_other_blocks_run_and_none_spoils_the_inertia(
    service: Service, machine: VirtualMachine, client: ServiceClient
) -> None:
    blocks = ("forward_fast", "backward_fast", "reversal", "wide")
    robot = str(CONFIG / "robots" / "max100-class.yaml")
    options = ("--axes", AXIS, "--varied", "joint_2", "--poses", "1", "--repeats", "1", "--blocks", ",".join(blocks))
    planned = sweepid("plan", robot, "--diagnosis", *options, "--url", service.url)
    assert planned.returncode == 0, planned.stderr
    assert planned.stderr.splitlines()[-1].startswith("4 runs,")
    campaign = measured(client, int(planned.stdout))
    assert machine.stands()
    sweeps = client.sweeps(campaign)
    assert [(sweep["spec"]["block"], sweep["state"]) for sweep in sweeps] == [(block, "identified") for block in blocks]
    turning = [sweep["spec"]["id"] for sweep in sweeps if sweep["spec"]["offset_velocity"]]
    used = client.estimate(campaign)["document"]["axes"][AXIS]["inertia"]
    assert [each["sweep"] for each in used] == turning
    values = [each["value"] for each in used]
    assert max(values) < 1.02 * min(values)


def test_the_runbook_goes_from_a_campaign_to_the_accepted_model(tmp_path: Path) -> None:
    """On a machine of its own: a model that another test accepted would be the start of its diagnosis."""
    with (
        virtual_machine(tmp_path, 50.0, scenario=hiding(tmp_path)) as machine,
        serving(tmp_path, machine.profile) as service,
        ServiceClient(service.url) as client,
    ):
        from_a_campaign_to_a_model(Books(tmp_path, service.url), client, machine, measured_one_way(client))


def from_a_campaign_to_a_model(books: Books, client: ServiceClient, machine: VirtualMachine, one_way: int) -> None:
    known = len(client.campaigns())
    code, protocol, printed = books.run(*DIAGNOSE, "--campaigns", str(one_way), typed="no\n")
    assert code == STOPPED, printed
    (undecided,) = results(protocol, "verdict").values()
    assert undecided["verdict"] == "ambiguous"
    assert results(protocol, "motion").keys() >= {AXIS}
    assert (len(client.campaigns()), machine.stands()) == (known, True)

    code, protocol, printed = books.run(*DIAGNOSE, "--campaigns", str(one_way), "--yes")
    assert code == DONE, printed
    verdicts = [step["verdict"] for step in protocol["steps"] if "verdict" in step]
    assert (verdicts[0], verdicts[-1]) == ("ambiguous", "named")
    assert any(step["step"].startswith("sweep ") for step in protocol["steps"])
    assert [step["model"] for step in protocol["steps"] if "model" in step] == [client.models()[-1]["id"]]
    check_named(client.diagnosis(client.diagnoses()[-1]["id"]))
    assert machine.stands()
