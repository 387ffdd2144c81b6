"""Two cells measure at once into one database; neither a stop nor the death of one disturbs the other."""

from contextlib import ExitStack
from pathlib import Path

import pytest

from service.web.client import ServiceClient, ServiceProblem
from tests.postgresql_server import running_server
from tests.system.rest_bench import (
    PATIENT_LEASE,
    SHORT_LEASE,
    Service,
    VirtualMachine,
    add_plan,
    release,
    until,
    virtual_machine,
)

POSES = 2


class Cell:
    """A machine and its service."""

    def __init__(self, name: str, machine: VirtualMachine, service: Service) -> None:
        self.name, self.machine, self.service = name, machine, service

    @property
    def moves(self) -> bool:
        return any(abs(axis["velocity"]) > 1e-3 for axis in self.machine.axes().values())


def test_two_cells_measure_at_once_and_one_is_killed(tmp_path: Path) -> None:
    """A stop, a command to the wrong cell, a kill and a restart of one cell leave the other's campaign as it is."""
    with ExitStack() as stack:
        server = stack.enter_context(running_server())
        settings = {"database_url": server.new_database(), "database_password_file": str(server.password_file)}
        cells: list[Cell] = []
        for name, lease in (("cell A", PATIENT_LEASE), ("cell B", SHORT_LEASE)):
            folder = tmp_path / name
            folder.mkdir()
            machine = stack.enter_context(virtual_machine(folder))
            service = Service(folder, machine.profile, lease, machine_name=name, **settings)
            service.start()
            stack.callback(service.close)
            cells.append(Cell(name, machine, service))
        a, b = cells
        client_a = stack.enter_context(ServiceClient(a.service.url))
        client_b = stack.enter_context(ServiceClient(b.service.url))
        campaigns: list[int] = []
        for client in (client_a, client_b):
            plan = add_plan(client, axes=["joint_2", "joint_3"], poses=POSES)
            campaigns.append(int(client.add_campaign(plan)["id"]))
            client.start(campaigns[-1])
        of_a, of_b = campaigns
        until(lambda: a.moves and b.moves, "both machines move at once")

        # each sees the campaigns of the plant, and commands its own alone
        assert [(one["id"], one["machine"], one["here"]) for one in client_b.campaigns()] == [
            (of_a, "cell A", False),
            (of_b, "cell B", True),
        ]
        for command in (client_b.pause, client_b.resume, lambda number: client_b.abort(number, "wrong cell")):
            with pytest.raises(ServiceProblem, match=r"campaign \d+ (belongs to machine 'cell A'|is running)"):
                command(of_a)

        client_b.stop("Ada", "a test")
        until(b.machine.stands, "machine B stands")
        until(lambda: client_b.campaign(of_b)["state"] == "paused", "campaign B is paused")
        assert client_a.stops() == []
        assert client_a.campaign(of_a)["state"] in ("running", "measured", "completed")
        release(client_b)
        client_b.resume(of_b, repeat=True)
        until(lambda: b.moves, "machine B moves again")

        b.service.kill()
        b.service.start()
        again = stack.enter_context(ServiceClient(b.service.url))
        assert again.campaign(of_b)["state"] == "paused"  # by its own restart
        until(lambda: client_a.campaign(of_a)["state"] == "completed", "campaign A is over")
        assert [sweep["attempt"] for sweep in client_a.sweeps(of_a)] == [1] * 2 * POSES  # no sweep was disturbed
        assert "restarted" not in client_a.campaign(of_a)["cause"]
        again.resume(of_b, repeat=True)
        until(lambda: again.campaign(of_b)["state"] == "completed", "campaign B is over")
        for client, number in ((client_a, of_a), (again, of_b)):
            assert [sweep["state"] for sweep in client.sweeps(number)] == ["identified"] * 2 * POSES
            assert client.estimate(number)["revision"] == 2 * POSES
        assert client_a.estimate(of_b)["revision"] == 2 * POSES  # one plant
