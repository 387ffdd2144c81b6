"""The cabinet loses its power and gets it back, under a sweep and between two campaigns: nothing moves until a person
says so, and then the work goes on; the service is not restarted."""

from pathlib import Path

from service.client import ServiceClient
from tests.system.rest_bench import VirtualMachine, add_plan, serving, until, virtual_machine


def test_power_fails_and_returns(tmp_path: Path) -> None:
    with (
        virtual_machine(tmp_path) as machine,
        serving(tmp_path, machine.profile) as service,
        ServiceClient(service.url) as client,
    ):
        plan = add_plan(client, axes=["joint_1"], poses=1, modes="host_streamed")
        first, second = (int(client.add_campaign(plan)["id"]) for _ in range(2))

        client.start(first)
        until(lambda: client.sweeps(first)[0]["state"] == "running", "a sweep is measured")
        until(lambda: not machine.stands(), "the axis moves")
        machine.power_off()
        until(lambda: client.campaign(first)["state"] == "paused", "the campaign is held")
        cause = client.campaign(first)["cause"]
        assert cause.startswith("CommunicationLost: ")
        assert "\n" not in cause
        drives = client.drives()
        assert not drives["connected"]
        assert {axis["state"] for axis in drives["axes"]} == {"unknown"}

        machine.power_on()
        nothing_moves(machine, client)
        client.resume(first, repeat=True)
        until(lambda: client.campaign(first)["state"] == "completed", "the campaign is measured")
        assert [sweep["attempt"] for sweep in client.sweeps(first)] == [2]

        machine.power_off()
        until(lambda: not client.drives()["connected"], "the loss is seen while nobody moves")
        assert client.drives()["trouble"] == "no drive answers"
        machine.power_on()
        nothing_moves(machine, client)
        client.start(second)
        until(lambda: client.campaign(second)["state"] == "completed", "another campaign is measured")


def nothing_moves(machine: VirtualMachine, client: ServiceClient) -> None:
    """For as long as somebody looks at the page, which asks for the drives again and again."""
    before = machine.axes()
    for _ in range(10):
        client.drives()
    assert machine.stands()
    assert machine.axes() == before
