"""A campaign whose store is on a PostgreSQL server that restarts in the middle and is killed once."""

import json
from contextlib import suppress
from pathlib import Path

from service.identification.estimation import estimate_document
from service.identification.spectra.frequency_response import spectrum
from service.store.files.bundle import read_bundle
from service.web.client import ServiceClient, ServiceProblem
from tests.postgresql_server import PASSWORD, running_server
from tests.system.rest_bench import VirtualMachine, add_plan, differences, run, serving, until, virtual_machine

POSES = 5  # sweeps enough for all that happens to the server
LEASE_TIME = 10.0  # s; half of it without a server, and the machine stands; a busy disk takes less


def moves(machine: VirtualMachine) -> bool:
    return any(abs(axis["velocity"]) > 1e-3 for axis in machine.axes().values())


def _untold_lease(client: ServiceClient) -> bool:
    return any("lease" in cause for cause in client.ready()["causes"])


def test_a_server_that_restarts_and_one_that_is_killed_change_no_result(tmp_path: Path) -> None:
    """The estimate is, to rounding, what the recordings give where no database is involved."""
    with running_server() as server, virtual_machine(tmp_path) as machine:
        settings = {"database_url": server.new_database(), "database_password_file": str(server.password_file)}
        with (
            serving(tmp_path, machine.profile, LEASE_TIME, **settings) as service,
            ServiceClient(service.url) as client,
        ):
            plan = add_plan(client, axes=["joint_2", "joint_3"], poses=POSES)
            campaign = int(client.add_campaign(plan)["id"])
            client.start(campaign)

            def done() -> int:
                return sum(sweep["state"] in ("recorded", "identified") for sweep in client.sweeps(campaign))

            def resumed() -> str:
                """State of the campaign, resumed where the server took longer than half of the lease's time."""
                state = client.campaign(campaign)["state"]
                if state == "paused":
                    with suppress(ServiceProblem):
                        client.resume(campaign, repeat=True)
                return state

            until(lambda: resumed() == "running" and done() >= 1 and moves(machine), "an axis moves")
            server.stop()
            server.start()
            until(lambda: resumed() == "running" and done() >= 2 and moves(machine), "it goes on")
            server.kill()
            # not at the first standstill: that may be one between two sweeps, and a server back so soon changes nothing
            until(lambda: _untold_lease(client), "the lease is not renewed")
            until(machine.stands, "the machine stands without a server")
            server.start()
            until(lambda: client.campaign(campaign)["state"] == "paused", "the campaign is paused")
            assert "the database does not answer" in client.campaign(campaign)["cause"]
            assert machine.stands()
            until(lambda: client.ready()["causes"] == [], "the lease is renewed")
            until(lambda: resumed() == "completed", "the campaign is over")

            sweeps = client.sweeps(campaign)
            assert [sweep["state"] for sweep in sweeps] == ["identified"] * 2 * POSES
            estimates = client.estimates(campaign)
            assert sorted(one["number"] for one in estimates) == [sweep["number"] for sweep in sweeps]  # each once
            latest = client.estimate(campaign)
            assert latest["revision"] == 2 * POSES
            exported = run("export", str(campaign), str(tmp_path / "bundle"), url=service.url)
            assert exported.returncode == 0, exported.stderr
            told = service.log() + json.dumps([client.ready(), client.campaign(campaign), sweeps])
        bundle = read_bundle(tmp_path / "bundle")
        undisturbed = estimate_document(bundle.robot, [spectrum(bundle.robot, sweep) for sweep in bundle.sweeps])
        worst = max(differences(latest["document"], undisturbed.as_json()), key=lambda found: found[1])
        assert worst[1] <= 1e-9, worst
        assert PASSWORD not in told + (service.data / "database.json").read_text("utf-8")
