"""A virtual machine that moves nothing without an approval, and stands when nobody shows a sign of life."""

from pathlib import Path

import pytest
import yaml

from service.client import ServiceClient, ServiceProblem
from service.store.database import open_database
from service.store.people.audit import AuditStore
from tests.system.rest_bench import Service, VirtualMachine, add_plan, serving, until, virtual_machine

WITHIN = 1.0  # s, the shortest that is taken


def test_nothing_moves_before_the_approval_and_a_changed_cell_voids_it(tmp_path: Path) -> None:
    (tmp_path / "cells").mkdir()
    cell = tmp_path / "cells" / "workshop.yaml"
    shipped = Path(__file__).parents[2] / "config" / "cells" / "workshop.yaml"
    cell.write_text(shipped.read_text("utf-8"), "utf-8")
    settings = {"approval": True, "cells_dir": str(cell.parent)}
    with (
        virtual_machine(tmp_path) as machine,
        serving(tmp_path, machine.profile, **settings) as service,
        ServiceClient(service.url) as client,
    ):
        plan = add_plan(client, axes=["joint_1"], poses=1, modes="drive_side")
        campaign = int(client.add_campaign(plan)["id"])
        refused(client, campaign, "not approved yet")
        assert machine.stands()
        client.approve(plan, client.approvals(plan)["sha256"], "Ada")
        changed = yaml.safe_load(cell.read_text("utf-8"))
        changed["clearance"] -= 0.001  # what was planned with more stays allowed
        cell.write_text(yaml.safe_dump(changed), "utf-8")
        refused(client, campaign, "is no longer valid")
        assert machine.stands()
        client.approve(plan, client.approvals(plan)["sha256"], "Berta")
        client.start(campaign)
        until(lambda: not machine.stands(), "it moves")
        client.abort(campaign, "enough seen")


def refused(client: ServiceClient, campaign: int, why: str) -> None:
    with pytest.raises(ServiceProblem, match=why) as told:
        client.start(campaign)
    assert told.value.status == 409
    assert client.campaign(campaign)["state"] == "planned"


def test_a_missed_sign_of_life_is_standstill(tmp_path: Path) -> None:
    with (
        virtual_machine(tmp_path, 1.0) as machine,
        serving(tmp_path, machine.profile) as service,
        ServiceClient(service.url) as client,
    ):
        silent(service, machine, client)


def silent(service: Service, machine: VirtualMachine, client: ServiceClient) -> None:
    plan = add_plan(client, axes=["joint_1"], poses=2, modes="drive_side")
    campaign = int(client.add_campaign(plan)["id"])
    client.start(campaign, attended=3600)
    until(lambda: not machine.stands(), "it moves")
    attended = client.sign_of_life(campaign)
    assert attended is not None
    assert attended["within_s"] == 3600
    client.pause(campaign)
    client.abort(campaign, "now with the shortest patience")
    campaign = int(client.add_campaign(plan)["id"])
    client.start(campaign, attended=WITHIN)
    until(lambda: client.campaign(campaign)["state"] == "paused", "paused")
    until(machine.stands, "the axes stand")
    found = client.campaign(campaign)
    assert found["cause"].startswith("no sign of life within 1 s")
    assert (found["attended"], client.stops()) == (None, [])
    with pytest.raises(ServiceProblem, match="is not running"):
        client.sign_of_life(campaign)
    with open_database(f"sqlite:///{service.data / 'sweepid.sqlite'}") as database:
        store = AuditStore(database)
        until(lambda: stops_of(store), "told")
        (entry,) = stops_of(store)
        assert (entry["way"], entry["why"]) == (f"campaign {campaign}", found["cause"])
        paths = [str(one.entry.get("path", "")) for one in store.documents(limit=1000)]
    assert not any(path.endswith("sign_of_life") for path in paths)


def stops_of(store: AuditStore) -> list[dict[str, object]]:
    return [dict(one.entry) for one in store.documents(limit=1000) if one.entry["event"] == "stop"]
