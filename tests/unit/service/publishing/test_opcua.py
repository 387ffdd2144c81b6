"""The OPC UA server, read by node-opcua: values, loads, subscription; nobody writes, and only trusted clients read."""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from asyncua import ua
from asyncua.client.client import Client
from asyncua.ua.status_codes import StatusCodes

from service import BadInput
from service.process.settings import OpcUa
from service.publishing.opcua import OpcUaServer, load_of
from service.publishing.state import FromPublisher, PublishedState
from tests.node_opcua import NodeClient, node_client
from tests.node_opcua.certificates import certificate
from tests.unit.service.publishing.conftest import progressed

pytestmark = pytest.mark.slow

ROBOTICS = "http://opcfoundation.org/UA/Robotics/"
LOAD_TYPE = "i=1018"  # in that namespace


@pytest.fixture(scope="module")
def client() -> NodeClient:
    return node_client()


@asynccontextmanager
async def serving(settings: OpcUa, state: PublishedState) -> AsyncGenerator[tuple[OpcUaServer, str]]:
    reports: asyncio.Queue[FromPublisher] = asyncio.Queue()
    server = OpcUaServer(settings, "cell 7", reports.put_nowait)
    server.state(state)
    running = asyncio.create_task(server.run(), name="opcua")
    try:
        report = await asyncio.wait_for(reports.get(), 120)
        assert report.trouble == ""
        yield server, f"opc.tcp://127.0.0.1:{report.port}/sweepid"
    finally:
        running.cancel()
        await asyncio.wait([running])


async def test_a_foreign_client_reads_machine_campaign_estimate_and_loads(
    client: NodeClient, state: PublishedState, links: dict[str, dict[str, float]]
) -> None:
    load = load_of(links["link_2"])
    assert load is not None
    names = {
        "Machine.Name": "cell 7",
        "Machine.MayMove": True,
        "Machine.State": "stands",
        "Campaign.State": "running",
        "Campaign.SweepsDone": 1,
        "Campaign.CurrentAxes": ["joint_1"],
        "Estimate.Revision": 1,
        "Estimate.Made": "2026-03-01T12:00:00.000Z",
        "Estimate.Axes.joint_1.GapRatio": 0.1,
        "Loads.link_2.Mass": load.mass,
        "Loads.link_2.CenterOfMass.CartesianCoordinates.Z": load.centre[2],
        "Loads.link_2.CenterOfMass.Orientation.C": load.angles[2],
        "Loads.link_2.Inertia.X": load.moments[0],
    }
    structures = ["Loads.link_2.CenterOfMass", "Loads.link_2.Inertia", "Loads.link_2.Mass.EngineeringUnits"]
    unknown = ["Estimate.ConditionNumber", "Estimate.Axes.joint_1.StdRatio"]
    nodes = [f"ns=2;s={name}" for name in (*names, *structures, *unknown)]
    async with serving(OpcUa(port=0), state) as (_, url):
        order = {"read": nodes, "types": ["ns=2;s=Loads.link_2"], "browse": ["ns=2;s=Loads.link_2", "ns=2;s=Loads"]}
        found = await asyncio.to_thread(client.ask, url=url, **order)
    read = {node.partition(";s=")[2]: value for node, value in found["read"].items()}
    assert {name: read[name]["value"] for name in names} == names
    assert {value["status"] for name, value in read.items() if name not in unknown} == {"Good"}
    assert [read[name]["status"] for name in unknown] == ["BadWaitingForInitialData"] * 2
    x, y, z = load.centre
    a, b, c = load.angles
    assert read["Loads.link_2.CenterOfMass"]["value"] == {
        "cartesianCoordinates": {"x": x, "y": y, "z": z},
        "orientation": {"a": a, "b": b, "c": c},
    }
    assert read["Loads.link_2.Inertia"]["value"] == dict(zip("xyz", load.moments, strict=True))
    unit = read["Loads.link_2.Mass.EngineeringUnits"]["value"]
    assert (unit["unitId"], unit["displayName"]["text"]) == (4933453, "kg")  # KGM
    robotics = found["namespaces"].index(ROBOTICS)
    assert found["types"]["ns=2;s=Loads.link_2"] == [f"ns={robotics};{LOAD_TYPE}"]
    assert found["children"]["ns=2;s=Loads.link_2"] == [f"{robotics}:{x}" for x in ("Mass", "CenterOfMass", "Inertia")]
    assert found["children"]["ns=2;s=Loads"] == [f"2:{link}" for link in links]


@pytest.mark.slow
async def test_a_foreign_client_gets_every_change(client: NodeClient, state: PublishedState) -> None:
    nodes = ["ns=2;s=Campaign.SweepsDone", "ns=2;s=Estimate.Revision"]
    async with serving(OpcUa(port=0), state) as (server, url):
        until = {"node": nodes[1], "value": 4}
        process = await asyncio.to_thread(client.start, url=url, subscribe={"nodes": nodes, "until": until})
        assert process.stderr is not None
        for _ in nodes:  # their first values
            assert "changed" in await asyncio.to_thread(process.stderr.readline)
        for number in (2, 3, 4):
            server.state(progressed(state, done=number, revision=number))
            for _ in nodes:
                assert "changed" in await asyncio.to_thread(process.stderr.readline)
        found = await asyncio.to_thread(client.answer, process)
    for node in nodes:
        assert [value["value"] for name, value in found["changes"] if name == node] == [1, 2, 3, 4]


@pytest.mark.slow
async def test_nobody_writes_or_calls(client: NodeClient, state: PublishedState) -> None:
    nodes = ["ns=2;s=Machine.Name", "ns=2;s=Loads.link_2.Mass"]
    async with serving(OpcUa(port=0), state) as (_, url):
        found = await asyncio.to_thread(client.ask, url=url, write=nodes, read=nodes[:1])
        async with Client(url) as other:  # its calls are raw
            with pytest.raises(ua.UaStatusCodeError) as refused:
                await other.nodes.server.call_method("0:GetMonitoredItems", 1)
            assert refused.value.code == StatusCodes.BadUserAccessDenied
    assert all("BadUserAccessDenied" in answer for answer in found["written"].values())
    assert found["read"][nodes[0]]["value"] == "cell 7"


@pytest.mark.slow
async def test_with_certificates_only_trusted_clients_read(
    client: NodeClient, state: PublishedState, tmp_path: Path
) -> None:
    own, friend, stranger = (certificate(tmp_path, name) for name in ("server", "friend", "stranger"))
    old = certificate(tmp_path, "old", timedelta(days=-1))
    trusted = tmp_path / "trusted"
    trusted.mkdir()
    for each in (friend, old):
        (trusted / each.certificate.name).write_bytes(each.certificate.read_bytes())
    (trusted / "README.txt").write_text("no certificate")
    settings = OpcUa(port=0, certificate=own.certificate, key=own.key, trusted=trusted)
    node = "ns=2;s=Machine.Name"
    async with serving(settings, state) as (_, url):

        def asked(who: str, policy: str = "Basic256Sha256") -> Any:
            shown = {name: tmp_path / f"{who}.{end}" for name, end in (("certificate", "pem"), ("key", "key"))}
            files = {name: str(path) for name, path in shown.items()} if who else {}
            more = {"uri": f"urn:test:{who}", "store": str(tmp_path / f"pki-{who}"), "policy": policy}
            return client.ask(url=url, read=[node], **files, **more)

        for policy in ("Basic256Sha256", "Aes128_Sha256_RsaOaep", "Aes256_Sha256_RsaPss"):
            found = await asyncio.to_thread(asked, "friend", policy)
            assert found.get("read") == {node: {"status": "Good", "value": "cell 7"}}, found
            assert set(found["endpoints"]) == {"SignAndEncrypt"}
        for who in ("", "stranger", "old"):
            refused = await asyncio.to_thread(asked, who)
            assert "read" not in refused
            assert "error" in refused

        # a session that was never activated, on a channel without security, reads nothing either
        raw = Client(url)
        await raw.connect_socket()
        try:
            await raw.send_hello()
            await raw.open_secure_channel()
            await raw.uaclient.create_session(ua.CreateSessionParameters(SessionName="raw"))
            with pytest.raises(ua.UaStatusCodeError) as error:
                await raw.get_node(node).read_value()
            assert error.value.code == StatusCodes.BadUserAccessDenied
        finally:
            raw.disconnect_socket()
    assert stranger.certificate.exists()


@pytest.mark.parametrize("angles", [(0.3, -0.7, 2.1), (-3.0, 1.2, -0.4), (0.5, np.pi / 2, 0.0), (0.5, -np.pi / 2, 0.0)])
def test_a_load_has_the_inertia_of_its_link(angles: tuple[float, float, float]) -> None:
    """Built by hand from mass, centre, principal moments and R = Rz(C) Ry(B) Rx(A); found again up to signs of axes."""
    rotation = rotated(*angles)
    mass, centre, moments = 12.0, np.array([0.1, -0.2, 0.3]), np.array([0.5, 0.9, 1.2])
    about = rotation @ np.diag(moments) @ rotation.T
    origin = about + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    parameters = {"m": mass} | dict(zip(("mx", "my", "mz"), (mass * centre).tolist(), strict=True))
    axes = ("x", "y", "z")
    parameters |= {f"I{axes[i]}{axes[j]}": float(origin[i, j]) for i in range(3) for j in range(i, 3)}
    load = load_of(parameters)
    assert load is not None
    assert load.mass == mass
    assert load.centre == pytest.approx(tuple(centre))
    assert load.moments == pytest.approx(tuple(moments))
    again = rotated(*load.angles)
    assert again @ np.diag(load.moments) @ again.T == pytest.approx(about)
    assert load_of(parameters | {"m": 0.0}) is None


def rotated(a: float, b: float, c: float) -> np.ndarray:
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    z = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return z @ y @ x


def test_beyond_this_computer_it_wants_certificates(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"opcua.host: '0.0.0.0' is not this computer alone.*`trusted`"):
        OpcUa(host="0.0.0.0").checked()
    own = certificate(tmp_path, "server")
    with pytest.raises(BadInput, match=r"opcua.trusted: is missing"):
        OpcUa(host="0.0.0.0", certificate=own.certificate, key=own.key).checked()
    with pytest.raises(BadInput, match=r"opcua.trusted: .* is not a folder"):
        OpcUa(certificate=own.certificate, key=own.key, trusted=own.key).checked()
    checked = OpcUa(host="0.0.0.0", certificate=own.certificate, key=own.key, trusted=tmp_path).checked()
    assert checked.trusted == tmp_path
