"""A real campaign, followed by node-opcua and mosquitto_sub; the publisher is killed, and the campaign goes on."""

import json
import subprocess
from pathlib import Path

import httpx
import psutil
import pytest
from prometheus_client.parser import text_string_to_metric_families

from service.web.client import ServiceClient
from tests.mosquitto import broker
from tests.node_opcua import node_client
from tests.ports import free_port
from tests.programs import require
from tests.system.rest_bench import PATIENT_LEASE, Service, add_plan, release, serving, until, virtual_machine

pytestmark = pytest.mark.slow

STEM = "plant/cell_7"


def publisher(service: Service) -> list[psutil.Process]:
    children = psutil.Process(service.running().pid).children()
    return [child for child in children if "service.publishing.publisher" in child.cmdline()]


def test_a_campaign_is_followed_from_outside(tmp_path: Path) -> None:
    require("promtool")
    foreign = node_client()
    port = free_port()
    url = f"opc.tcp://127.0.0.1:{port}/sweepid"
    with (
        broker(tmp_path) as server,
        virtual_machine(tmp_path) as machine,
        serving(
            tmp_path,
            machine.profile,
            PATIENT_LEASE,
            machine_name="cell 7",
            opcua={"port": port},
            mqtt={"host": "127.0.0.1", "port": server.port, "tls": False, "topic": "plant"},
        ) as service,
        ServiceClient(service.url) as client,
        server.subscribed() as found,
    ):
        until(lambda: found.of("/machine"), "the machine is published")
        campaign = int(client.add_campaign(add_plan(client, axes=["joint_2", "joint_3"], poses=1))["id"])
        until(lambda: foreign.ask(url=url, endpointsOnly=True).get("endpoints"), "OPC UA listens")
        nodes = [f"ns=2;s={name}" for name in ("Campaign.SweepsDone", "Estimate.Revision")]
        following = foreign.start(url=url, subscribe={"nodes": nodes, "until": {"node": nodes[1], "value": 2}})
        assert following.stderr is not None
        assert "changed" in following.stderr.readline()  # it is subscribed

        client.start(campaign)
        until(lambda: client.campaign(campaign)["state"] == "completed", "the campaign is over")
        until(
            lambda: [m for m in found.of("/estimate") if m.json and m.json["revision"] == 2],
            "the estimate is published",
        )
        changes = foreign.answer(following)["changes"]
        assert [value["value"] for node, value in changes if node == nodes[1] and value["value"]] == [1, 2]

        client.stop("Ada", "a test")
        until(lambda: found.of("/machine")[-1].json["stopped"], "the stop is published")
        assert found.of("/machine")[-1].json["stops"][0]["by"] == "Ada"
        release(client)
        until(lambda: not found.of("/machine")[-1].json["stopped"], "its release, too")

        names = ("Machine.Name", "Campaign.State", "Estimate.Campaign", "Loads.link_2.Mass")
        read = [f"ns=2;s={name}" for name in names]
        values = [value["value"] for value in foreign.ask(url=url, read=read)["read"].values()]
        latest = client.estimate(campaign)
        mass = latest["document"]["standard_parameters"]["links"]["link_2"]["m"]
        assert values == ["cell 7", "completed", campaign, mass]
        check_events(found.of("/event"), campaign)

        # a publisher that dies is nobody's trouble: a second campaign runs to its end meanwhile
        again = int(client.add_campaign(add_plan(client, axes=["joint_2", "joint_3"], poses=1))["id"])
        client.start(again)
        until(lambda: client.campaign(again)["progress"]["current"], "a sweep runs")
        (process,) = publisher(service)
        process.kill()
        until(lambda: client.campaign(again)["state"] == "completed", "the second campaign is over")
        assert [sweep["attempt"] for sweep in client.sweeps(again)] == [1, 1]
        until(lambda: found.of("/campaign")[-1].json["id"] == again, "the new publisher has its state")
        until(lambda: found.of("/campaign")[-1].json["state"] == "completed", "to the end")
        assert "offline" in [message.content for message in found.of("/status")]
        assert found.of("/status")[-1].content == "online"
        check_metrics(httpx.get(f"{service.url}/metrics", timeout=60, trust_env=False).text)
    logged = [json.loads(line) for line in service.log().splitlines()]
    assert "publisher_ended" in [line["event"] for line in logged]
    with pytest.raises(psutil.NoSuchProcess):
        process.status()


def check_metrics(text: str) -> None:
    """Of a machine at a CAN bus, after two campaigns; by Prometheus' own tool, too."""
    checked = subprocess.run(
        ["promtool", "check", "metrics"], input=text, capture_output=True, text=True, timeout=60, check=False
    )
    assert checked.returncode == 0, checked.stdout + checked.stderr
    families = {family.name: family for family in text_string_to_metric_families(text)}
    values = {name: family.samples[0].value for name, family in families.items() if len(family.samples) == 1}
    frames = {sample.labels["direction"]: sample.value for sample in families["sweepid_bus_frames"].samples}
    assert frames["received"] > frames["sent"] > 0
    # 47 bits and 0 to 8 bytes a frame (ISO 11898-1)
    assert 47 <= 8 * values["sweepid_bus_bytes"] / sum(frames.values()) <= 47 + 64
    assert values["sweepid_set_points_sent"] >= values["sweepid_bus_cycles_missed"] >= 0
    assert values["sweepid_recorder_blocks_waiting"] == 0
    assert values["sweepid_worker_available"] == 1
    assert values["sweepid_published_dropped"] >= 0
    assert {each.labels["part"]: each.value for each in families["sweepid_publishing_trouble"].samples} == {
        "opcua": 0,
        "mqtt": 0,
    }
    assert values["sweepid_estimate_revision"] == 2
    assert all(family.documentation for family in families.values())


def check_events(events: list, campaign: int) -> None:
    """Each of the campaign once, in the order of the database."""
    told = [message.json for message in events]
    numbers = [event["number"] for event in told if event["number"] is not None]
    assert numbers == sorted(set(numbers))
    kinds = [event["kind"] for event in told if event["campaign"] == campaign]
    assert [kind for kind in kinds if kind == "estimate"] == ["estimate"] * 2
    states = [event["data"]["state"] for event in told if event["kind"] == "campaign" and event["campaign"] == campaign]
    assert states[0] in ("planned", "running")
    assert states[-1] == "completed"
    stops = [event["data"]["latched"] for event in told if event["kind"] == "stop"]
    assert stops == [True, False]
