"""An initial analysis from the command line to the plan and the estimate that stand on it."""

import json
from pathlib import Path
from typing import Any

import pytest

from service import BadInput
from service.web.client import Json, ServiceClient
from tests.system.rest_bench import (
    ROBOT,
    Fieldbus,
    Service,
    VirtualMachine,
    add_plan,
    run,
    serving,
    until,
    virtual_machine,
)


def measured(client: ServiceClient, plan: int) -> tuple[int, dict[str, Any]]:
    """The campaign of a plan, run to its end, and its estimate's document."""
    campaign = int(client.add_campaign(plan)["id"])
    client.start(campaign)
    until(lambda: client.campaign(campaign)["state"] not in ("running", "measured"), "campaign over")
    state: Json = client.campaign(campaign)
    assert (state["state"], state["cause"]) == ("completed", "")
    return campaign, client.estimate(campaign)["document"]


def test_noise_runs_become_plan_and_prior(tmp_path: Path) -> None:
    with (
        virtual_machine(tmp_path) as machine,
        serving(tmp_path, machine.profile) as service,
        ServiceClient(service.url) as client,
    ):
        with pytest.raises(BadInput, match="analysis"):
            add_plan(client, axes=["joint_1"], poses=1, analysis=77)
        becomes_plan_and_prior(service, machine, client, tmp_path)


def becomes_plan_and_prior(service: Service, machine: VirtualMachine, client: ServiceClient, tmp_path: Path) -> None:
    options = ("--axes", "joint_1", "--varied", "joint_2,joint_3", "--poses", "2")
    planned = run("plan", str(ROBOT), "--initial-analysis", *options, url=service.url)
    assert planned.returncode == 0, planned.stderr
    assert planned.stderr.splitlines()[-1].startswith("8 runs,")
    first, document = measured(client, add_plan(client, kind="analysis", axes=["joint_1"], poses=2, repeats=1))
    assert machine.stands()
    assert document["axes"] == {}
    axis = document["analysis"]["joint_1"]
    light, heavy = sorted((pose["fit"] for pose in axis["poses"]), key=lambda fit: fit["inertia"]["value"])
    assert light["locked_rotor"]["value"] > 1.5 * heavy["locked_rotor"]["value"]
    for fit in (light, heavy):
        assert 0 < fit["locked_rotor"]["std"] < 0.02 * fit["locked_rotor"]["value"]
    assert [each["name"] for each in axis["classes"]] == ["light", "heavy"]

    exported = run("export", str(first), str(tmp_path / "bundle"), url=service.url)
    assert exported.returncode == 0, exported.stderr
    offline = run("identify", str(tmp_path / "bundle"), "--json", "-", url=service.url)
    assert offline.returncode == 0, offline.stderr
    found = json.loads(offline.stdout)["analysis"]["joint_1"]["drive_train"]
    assert all(found[name]["value"] == pytest.approx(axis["drive_train"][name]["value"], rel=1e-6) for name in found)
    shown = run("identify", str(tmp_path / "bundle"), url=service.url)
    assert "Initial analysis" in shown.stdout

    with_it = run("plan", str(ROBOT), "--analysis", str(first), *options, url=service.url)
    assert with_it.returncode == 0, with_it.stderr
    _, known = measured(client, int(with_it.stdout))
    assert known["analysis"] == {}
    for name in ("motor_inertia", "compliance"):
        std = [each["drive_train"][name]["std"] for each in (known["axes"]["joint_1"], axis)]
        assert 0 < std[0] <= std[1]


def test_a_drive_that_cannot_inject_gets_a_stepped_sine(tmp_path: Path) -> None:
    with (
        virtual_machine(tmp_path, fieldbus=Fieldbus.MODBUS_TCP) as machine,
        serving(tmp_path, machine.profile) as service,
        ServiceClient(service.url) as client,
    ):
        plan = add_plan(client, kind="analysis", axes=["joint_1"], poses=1, repeats=1)
        document = client.plan(plan)["document"]
        assert document["request"]["excitation"] == "stepped_sine"
        _, found = measured(client, plan)
        assert len(found["analysis"]["joint_1"]["poses"][0]["frequency_response"]) == 16
        assert machine.stands()
        assert client.drives()["capabilities"]["hears_other_hosts"] is False
