"""A cell is started for real, measures, is stopped in the middle, and comes back with its data and without moving."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from service.cli.virtual_cell import Operator
from service.web.client import ServiceClient
from tests.compose.bench import Cell, positions, stands
from tests.system.rest_bench import add_plan, until

LOOKS = 100  # at the machine while nothing may move, some 25 ms apart


@pytest.fixture
def cell(tmp_path: Path) -> Iterator[Cell]:
    cell = Cell(tmp_path)
    try:
        cell.up()
        yield cell
    finally:
        cell.remove()


def test_a_campaign_from_plan_to_estimate(cell: Cell) -> None:
    """A computer that is too busy for the bus may stop it; a person then looks and goes on. Nothing else may."""
    troubles: list[str] = []
    with cell.watched() as watch, ServiceClient(cell.url) as client:
        plan = add_plan(client, axes=["joint_1", "joint_2"], poses=2)
        campaign = int(client.add_campaign(plan)["id"])
        Operator(client, progress=lambda campaign: None, say=troubles.append).run(campaign)

        assert [trouble for trouble in troubles if not trouble.startswith("CommunicationLost: ")] == []
        assert [sweep["state"] for sweep in client.sweeps(campaign)] == ["identified"] * 4
        latest = client.estimate(campaign)
        assert latest["revision"] == 4
        for joint in ("joint_1", "joint_2"):
            inertias = latest["document"]["axes"][joint]["inertia"]
            assert [inertia["value"] > 10 * inertia["std"] > 0 for inertia in inertias] == [True, True]
        until(lambda: stands(watch.all()[-1]), "the axes stand")
        assert not all(stands(axes) for axes in watch.all())


@pytest.mark.parametrize("end", ["stop", "kill"])
def test_what_was_ended_in_motion_comes_back_standing(cell: Cell, end: str) -> None:
    with ServiceClient(cell.url) as client:
        plan = add_plan(client, axes=["joint_1"], poses=1, modes="host_streamed")
        campaign = int(client.add_campaign(plan)["id"])
        with cell.watched() as watch:
            client.start(campaign)
            until(lambda: client.campaign(campaign)["progress"]["current"], "a sweep runs")
            until(watch.moves, "an axis moves")
            if end == "stop":
                cell.compose("stop")
                assert stands(watch.all()[-1])
                assert [cell.inspect(name)["State"]["ExitCode"] for name in ("service", "machine")] == [0, 0]
            else:
                cell.compose("kill", "service")
                until(lambda: stands(watch.all()[-1]), "the axes stand without the service")
                assert not cell.inspect("service")["State"]["Running"]

    cell.compose("down")
    cell.up()
    with ServiceClient(cell.url) as client:
        with cell.watched() as watch:
            (listed,) = client.campaigns()
            assert (listed["id"], listed["state"]) == (campaign, "paused")
            assert client.sweeps(campaign)[0]["state"] == "interrupted"
            until(lambda: len(watch.all()) > LOOKS, "looked at for a while")
            seen = watch.all()
            assert all(stands(axes) and positions(axes) == positions(seen[0]) for axes in seen)

        client.resume(campaign, repeat=True)
        until(lambda: client.sweeps(campaign)[0]["attempt"] == 2, "the sweep is measured again, on command")


def test_the_cell_is_sealed(cell: Cell) -> None:
    for name in ("machine", "service"):
        assert cell.compose("exec", "-T", name, "id", "--user").strip() == "10001"
        assert "CapEff:\t0000000000000000" in cell.compose("exec", "-T", name, "cat", "/proc/self/status")
        with pytest.raises(RuntimeError, match="Read-only file system"):
            cell.compose("exec", "-T", "--user", "root", name, "touch", "/app/config/service.yaml")
        known = cell.inspect(name)
        assert known["HostConfig"]["RestartPolicy"]["Name"] in ("", "no")
        bindings = known["HostConfig"]["PortBindings"] or {}
        assert {binding["HostIp"] for bound in bindings.values() for binding in bound} <= {"127.0.0.1"}
