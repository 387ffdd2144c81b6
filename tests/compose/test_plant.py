"""The plant is started for real: two cells measure at once into one database and one store, and a worker is killed."""

import json
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from service.cli.virtual_cell import Operator
from service.web.client import ServiceClient, ServiceProblem
from tests.compose.bench import COMMAND, ROOT, inspected, stands
from tests.compose.plant_bench import CELLS, MACHINES, Plant, build_images
from tests.system.rest_bench import add_plan, until

DASHBOARD = ROOT / "config" / "monitoring" / "grafana" / "sweepid-plant.json"

_KEYS = """
import s3fs
for key in s3fs.S3FileSystem(endpoint_url="http://objects:8333", key="any", secret="any").find("recordings"):
    print(key)
"""


@pytest.fixture(scope="module")
def plant(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    plant = Plant(tmp_path_factory.mktemp("plant"), build_images())
    try:
        plant.up(workers=2)
        yield plant
    finally:
        plant.remove()


def measure(plant: Plant, cell: str, troubles: list[str]) -> int:
    """A campaign of four sweeps, from plan to estimate; its number."""
    with ServiceClient(plant.url[cell]) as client:
        campaign = int(client.add_campaign(add_plan(client, axes=["joint_2", "joint_3"], poses=2))["id"])
        Operator(client, progress=lambda campaign: None, say=troubles.append).run(campaign)
        return campaign


def test_two_cells_measure_at_once_and_a_worker_is_killed(plant: Plant) -> None:
    """A computer that is too busy for the bus may stop a machine; a person then looks and goes on. Nothing else may."""
    troubles: list[str] = []
    with (
        plant.watched(MACHINES[0]) as one,
        plant.watched(MACHINES[1]) as other,
        ThreadPoolExecutor(2) as people,
    ):
        measuring = [people.submit(measure, plant, cell, troubles) for cell in CELLS]
        until(lambda: (one.moves() and other.moves()) or any(each.done() for each in measuring), "both machines move")
        assert not any(each.done() for each in measuring)
        killed, kept = plant.numbers("worker")
        subprocess.run(["docker", "kill", killed], check=True, capture_output=True, timeout=COMMAND)
        campaigns = [each.result() for each in measuring]
        until(lambda: stands(one.all()[-1]) and stands(other.all()[-1]), "the axes stand")
    assert (inspected(killed)["State"]["Running"], inspected(kept)["State"]["Running"]) == (False, True)
    assert [trouble for trouble in troubles if not trouble.startswith("CommunicationLost: ")] == []

    # one database: each service, also the one without a machine, shows both
    for name, url in plant.url.items():
        with ServiceClient(url) as client:
            listed = {each["id"]: (each["machine"], each["here"]) for each in client.campaigns()}
            machines = ("cell 1", "cell 2")
            assert [listed[number][0] for number in campaigns] == list(machines)
            assert [listed[number][1] for number in campaigns] == [name == cell for cell in CELLS]
            for number in campaigns:
                assert [sweep["state"] for sweep in client.sweeps(number)] == ["identified"] * 4
                assert client.estimate(number)["revision"] == 4
    with ServiceClient(plant.url["plant"]) as client, pytest.raises(ServiceProblem, match="no machine"):
        client.resume(campaigns[0])

    # one object store: each recording is in it, by its hash
    recorded = set(rows(plant, "SELECT sha256 FROM recording"))
    assert len(recorded) >= 8
    until(lambda: rows(plant, "SELECT count(*) FROM recording WHERE moved_at IS NULL") == ["0"], "all are moved")
    kept_keys = {Path(key).stem for key in plant.python("cell-1", _KEYS).split()}
    assert recorded <= kept_keys


def test_prometheus_sees_both_cells_and_answers_where_grafana_asks(plant: Plant) -> None:
    until(lambda: plant.metric('up{job="sweepid"}') == {"cell-1:8642": "1", "cell-2:8642": "1"}, "both are scraped")
    assert plant.metric("sweepid_machine_connected") == {"cell-1:8642": "1", "cell-2:8642": "1"}
    assert plant.metric("sweepid_worker_available") == {"cell-1:8642": "1", "cell-2:8642": "1"}
    panels = json.loads(plant.compose("exec", "-T", "grafana", "cat", f"/var/lib/grafana/dashboards/{DASHBOARD.name}"))
    source = plant.compose("exec", "-T", "grafana", "cat", "/etc/grafana/provisioning/datasources/sweepid.yml")
    assert 'url: "http://prometheus:9090"' in source
    queries = [target["expr"] for panel in panels["panels"] for target in panel["targets"]]
    program = (
        "import json, sys\nfrom urllib.parse import urlencode\nfrom urllib.request import urlopen\n"
        "for query in json.loads(sys.argv[1]):\n"
        "    urlopen('http://prometheus:9090/api/v1/query?' + urlencode({'query': query}), timeout=60).read()\n"
        "print('answered')"
    )
    assert plant.python("grafana", program, json.dumps(queries)).strip() == "answered"


def test_the_plant_is_sealed(plant: Plant) -> None:
    moving = {*CELLS, *MACHINES}
    seen: set[str] = set()
    for number in plant.numbers():
        known = inspected(number)
        name = known["Config"]["Labels"]["com.docker.compose.service"]
        seen.add(name)
        host = known["HostConfig"]
        assert host["ReadonlyRootfs"], name
        assert host["CapDrop"] == ["ALL"], name
        assert "no-new-privileges:true" in host["SecurityOpt"], name
        assert host["CapAdd"] in ([], None) or name == "permissions", name
        if name in moving:
            assert host["RestartPolicy"]["Name"] in ("", "no"), name
        bindings = host["PortBindings"] or {}
        assert {binding["HostIp"] for bound in bindings.values() for binding in bound} <= {"127.0.0.1"}, name
        if known["State"]["Running"]:
            inside = plant.compose("exec", "-T", name, "id", "--user") if name != "worker" else "10001"
            assert inside.strip() == "10001", name
        else:
            assert name in ("permissions", "bucket", "worker"), name
            assert name == "worker" or known["State"]["ExitCode"] == 0, name
    assert seen >= {*moving, "database", "objects", "scheduler", "worker", "plant", "prometheus", "grafana"}
    modes = plant.compose("exec", "-T", "cell-1", "stat", "--format", "%u %a", "/run/secrets/database-password")
    assert modes.strip() == "10001 600"
    missing = "import pathlib; print(pathlib.Path('/app/config/plant/secrets').exists())"
    assert plant.python("cell-1", missing).strip() == "False"


def test_down_in_motion_leaves_the_machines_standing(plant: Plant) -> None:
    with plant.watched(MACHINES[0]) as one, plant.watched(MACHINES[1]) as other:
        for cell in CELLS:
            with ServiceClient(plant.url[cell]) as client:
                plan = add_plan(client, axes=["joint_1"], poses=1, modes="host_streamed")
                client.start(int(client.add_campaign(plan)["id"]))
        until(one.moves, "machine 1 moves")
        until(other.moves, "machine 2 moves")
        plant.compose("down", patience=300)
        assert stands(one.all()[-1])
        assert stands(other.all()[-1])


def rows(plant: Plant, query: str) -> list[str]:
    """The first column of the answer of the database."""
    command = ["exec", "-T", "database", "psql", "-tA", "-U", "postgres", "-d", "sweepid", "-c", query]
    return plant.compose(*command).split()
