"""SIGKILL of the service while an axis moves: the axis comes to stand by itself, the samples so far are there, and
after a restart nothing moves until a person says so."""

import io
from pathlib import Path

import httpx
import pyarrow as pa
import pyarrow.parquet as pq
from websockets.sync.client import connect

from service.client import ServiceClient
from tests.system.rest_bench import SHORT_LEASE, add_plan, serving, until, virtual_machine


def test_the_service_dies_during_a_sweep(tmp_path: Path) -> None:
    with virtual_machine(tmp_path) as machine, serving(tmp_path, machine.profile, SHORT_LEASE) as service:
        with ServiceClient(service.url) as client:
            plan = add_plan(client, axes=["joint_1"], poses=1, modes="host_streamed")
            campaign = int(client.add_campaign(plan)["id"])
            address = service.url.replace("http", "ws")
            with connect(f"{address}/api/v1/campaigns/{campaign}/live", max_size=None, proxy=None) as live:
                client.start(campaign)
                seen = 0
                while seen < 20:
                    message = live.recv(timeout=60)
                    assert isinstance(message, bytes)
                    (batch,) = pa.ipc.open_stream(message)
                    assert batch.schema.names == ["time", "effort", "velocity", "position"]
                    assert batch.schema.metadata[b"joint"] == b"joint_1"
                    seen += batch.num_rows
                service.kill()

        until(machine.stands, "the axes stand without the service")
        before = machine.axes()
        (stream,) = service.data.glob("recordings/*/*.arrows")
        assert readable_rows(stream) > 0

        service.start()
        with ServiceClient(service.url) as client:
            held = client.campaign(campaign)
            assert (held["state"], held["cause"]) == ("paused", "the service was restarted")
            assert held["progress"]["done"] == 0
            (sweep,) = client.sweeps(campaign)
            assert (sweep["state"], sweep["attempt"]) == ("interrupted", 1)
            url = f"{service.url}/api/v1/campaigns/{campaign}"
            with httpx.Client(base_url=url, timeout=60, trust_env=False) as http:
                recording = http.get("/sweeps/1/recording").json()
                file = http.get("/sweeps/1/recording/file")
            assert recording["state"] == file.headers["x-recording-state"] == "partial"
            assert pq.read_table(io.BytesIO(file.content)).num_rows == recording["samples"] > 0
            assert machine.stands()
            after = machine.axes()
            assert {joint: axis["position"] for joint, axis in after.items()} == {
                joint: axis["position"] for joint, axis in before.items()
            }

            # the drive that lost its host waits for a person, too
            for axis in client.drives()["axes"]:
                if axis["fault"] is not None:
                    client.acknowledge(axis["joint"])
            client.resume(campaign, repeat=True)
            until(lambda: client.sweeps(campaign)[0]["attempt"] == 2, "the sweep is measured again")
            client.abort(campaign, "enough seen")
            until(machine.stands, "the axes stand")


def readable_rows(path: Path) -> int:
    """Rows of the whole batches of a stream that may be torn."""
    rows = 0
    with pa.OSFile(str(path)) as file:
        reader = pa.ipc.open_stream(file)
        while True:
            try:
                rows += reader.read_next_batch().num_rows
            except (StopIteration, pa.ArrowInvalid, OSError):
                return rows
