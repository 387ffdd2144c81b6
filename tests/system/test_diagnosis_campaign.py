"""A machine that hides an effect, measured by a campaign of a diagnosis over the wire: the effect is found by name."""

from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from service.client import ServiceClient
from service.diagnosis import diagnose_axis
from service.diagnosis.verdict import Verdict
from service.store.files.bundle import read_bundle
from tests.command import sweepid
from tests.system.rest_bench import CONFIG, Service, VirtualMachine, add_plan, serving, virtual_machine

AXIS = "joint_1"
COULOMB = 90.0  # N m, that nobody told the model of


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
def machine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[VirtualMachine]:
    folder = tmp_path_factory.mktemp("machine")
    with virtual_machine(folder, 100.0, scenario=hiding(folder)) as machine:
        yield machine


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory, machine: VirtualMachine) -> Iterator[Service]:
    with serving(tmp_path_factory.mktemp("service"), machine.profile) as service:
        yield service


@pytest.fixture
def client(service: Service) -> Iterator[ServiceClient]:
    with ServiceClient(service.url) as client:
        yield client


def measured(client: ServiceClient, plan: int) -> int:
    """The campaign of a plan, run to its end."""
    campaign = int(client.add_campaign(plan)["id"])
    client.start(campaign)
    for event in client.events(campaign):
        if event["kind"] == "campaign" and event["data"]["state"] not in ("planned", "running", "measured"):
            break
    state = client.campaign(campaign)
    assert (state["state"], state["cause"]) == ("completed", "")
    return campaign


def test_a_hidden_effect_is_found_over_the_wire(
    service: Service, machine: VirtualMachine, client: ServiceClient, tmp_path: Path
) -> None:
    wanted = {"kind": "diagnosis", "axes": [AXIS], "varied": [AXIS, "joint_2"], "poses": 2, "move_velocity": 0.5}
    plan = add_plan(client, **wanted, blocks=["forward_slow", "backward_slow"])
    campaign = measured(client, plan)
    assert machine.stands()
    specs = [sweep["spec"] for sweep in client.sweeps(campaign)]
    assert Counter(spec["block"].removeprefix("revisit_") for spec in specs) == {"forward_slow": 6, "backward_slow": 6}
    assert [spec["repeat"] for spec in specs] == [0, 1] * 6
    assert len({tuple(spec["pose"]) for spec in specs}) == 2
    starts = [spec["started_at"] for spec in specs]
    assert starts == sorted(starts)
    assert starts != [sweep["spec"]["started_at"] for sweep in client.plan(plan)["document"]["sweeps"]]  # as measured

    exported = sweepid("export", str(campaign), str(tmp_path / "bundle"), "--url", service.url)
    assert exported.returncode == 0, exported.stderr
    bundle = read_bundle(tmp_path / "bundle")
    found = diagnose_axis(bundle.robot, AXIS, bundle.sweeps)
    assert (found.verdict, [effect.name for effect in found.effects]) == (Verdict.NAMED, ["coulomb_friction"])
    coulomb = found.effects[0].parameters["coulomb"]
    assert abs(coulomb.value - COULOMB) < max(4 * coulomb.std, 0.02 * COULOMB)


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
