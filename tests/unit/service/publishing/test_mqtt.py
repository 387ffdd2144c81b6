"""MQTT at a real broker (mosquitto), read by its own subscriber: state is retained, events come, the end is told."""

import asyncio
import signal
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import psutil
import pytest
from aiomqtt import Client, MqttError

from service import BadInput
from service.process.settings import Mqtt
from service.publishing import mqtt
from service.publishing.mqtt import Broker
from service.publishing.publisher import NOTICES, Publisher
from service.publishing.state import Configuration, FromPublisher, Notice, PublishedState
from tests.mosquitto import PATIENCE, Mosquitto, Secured, broker
from tests.node_opcua.certificates import certificate
from tests.unit.service.publishing.conftest import progressed

pytestmark = pytest.mark.slow

STEM = "plant/cell_7"


def settings(port: int, **more: object) -> Mqtt:
    return Mqtt.model_validate({"host": "127.0.0.1", "port": port, "tls": False, "topic": "plant", **more})


def notice(number: int) -> Notice:
    return Notice(number=number, kind="sweep", campaign=3, at=datetime.now(UTC), data={"number": number})


async def until(condition: Callable[[], object], what: str) -> None:
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < PATIENCE, what
        await asyncio.sleep(0.02)


@asynccontextmanager
async def publishing(to: Mqtt, reports: list[FromPublisher]) -> AsyncGenerator[Broker]:
    client = Broker(to, "cell 7", reports.append)
    running = asyncio.create_task(client.run(), name="mqtt")
    try:
        yield client
    finally:
        running.cancel()
        await asyncio.wait([running], timeout=PATIENCE)
        assert running.cancelled(), "it does not end"


class _LosesItsBroker(Client):
    """As when the broker goes while the client says goodbye."""

    async def __aexit__(self, *exit_of_the_body: object) -> None:
        await super().__aexit__(None, None, None)
        raise MqttError("Disconnected during message iteration")


class _LosesACancellation(Client):
    """The cancellation comes together with the broker's answer: `asyncio.wait_for` of Python 3.11 returns normally."""

    async def publish(self, *args: Any, **kwargs: Any) -> None:
        await super().publish(*args, **kwargs)
        task, answer = asyncio.current_task(), asyncio.get_running_loop().create_future()
        answer.set_result(None)
        if task is not None and args[0] == f"{STEM}/event":
            task.cancel()
            await asyncio.wait_for(answer, 1.0)


async def test_it_ends_though_its_cancellation_came_with_an_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt, "Client", _LosesACancellation)
    with broker(tmp_path) as server:
        client = Broker(settings(server.port), "cell 7", lambda report: None)
        client.notice(notice(1))
        running = asyncio.create_task(client.run(), name="mqtt")
        await asyncio.wait([running], timeout=PATIENCE)
        assert running.cancelled(), "it does not end"
        with server.subscribed() as after:
            await until(lambda: after.of("/status"), "the status is retained")
    assert after.of("/status")[0].content == "offline"


async def test_it_ends_though_the_broker_is_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt, "Client", _LosesItsBroker)
    reports: list[FromPublisher] = []
    with broker(tmp_path) as server:
        async with publishing(settings(server.port), reports):
            await until(lambda: reports and not reports[-1].trouble, "it is connected")


async def test_state_is_retained_and_a_clean_end_is_told(tmp_path: Path, state: PublishedState) -> None:
    reports: list[FromPublisher] = []
    with broker(tmp_path) as server:
        async with publishing(settings(server.port), reports) as client:
            client.state(state)
            with server.subscribed() as first:
                await until(lambda: first.of("/estimate"), "the estimate is published")
                client.state(progressed(state, done=2))
                await until(lambda: [m for m in first.of("/campaign") if m.json["done"] == 2], "progress is published")
                client.notice(notice(9))
                await until(lambda: first.of("/event"), "the event is published")
            with server.subscribed() as late:
                await until(lambda: len(late.messages) == 4, "all that is retained comes")
        with server.subscribed() as after:
            await until(lambda: after.of("/status"), "the status is retained")
    found = {message.topic: message for message in late.messages}
    assert set(found) == {f"{STEM}/{name}" for name in ("status", "machine", "campaign", "estimate")}  # no event
    assert all(message.retained for message in late.messages)
    assert found[f"{STEM}/status"].content == "online"
    assert PublishedState.model_validate(
        {name: found[f"{STEM}/{name}"].json for name in PublishedState.model_fields}
    ) == progressed(state, done=2)
    assert first.of("/event")[0].json["number"] == 9
    assert len(first.of("/estimate")) == 1  # what did not change is not sent again
    assert after.of("/status")[0].content == "offline"
    assert {report.trouble for report in reports} == {""}


async def test_nothing_is_lost_and_nobody_waits_while_the_broker_is_away(tmp_path: Path, state: PublishedState) -> None:
    reports: list[FromPublisher] = []
    with broker(tmp_path) as server:
        async with publishing(settings(server.port), reports) as client:
            client.state(state)
            with server.subscribed() as before:
                await until(lambda: before.of("/estimate"), "the state is published")
            server.stop()
            for number in range(20):  # a call that waited for the broker would never end
                client.notice(notice(number))
                client.state(progressed(state, done=number))
            await until(lambda: reports[-1].trouble, "the trouble is told")
            server.start()
            with server.subscribed() as after:
                await until(lambda: len(after.of("/event")) >= 20, "the events come when it is back")
                await until(lambda: after.of("/campaign"), "so does the state")
                await until(lambda: not reports[-1].trouble, "and the trouble is over")
    assert [message.json["number"] for message in after.of("/event")] == list(range(20))
    assert after.of("/campaign")[-1].json["done"] == 19
    assert reports[-1].dropped == 0


async def test_too_many_events_are_dropped_and_counted(
    tmp_path: Path, state: PublishedState, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mqtt.Broker, "waiting", 10)
    server, reports = Mosquitto(tmp_path), list[FromPublisher]()
    async with publishing(settings(server.port), reports) as client:
        for number in range(25):
            client.notice(notice(number))
        server.start()
        with server.subscribed() as found:
            # those that came while the subscriber did not listen yet are not of interest: state is what is kept
            await until(lambda: reports and reports[-1].published == 10, "what waited is published")
            client.notice(notice(99))
            await until(lambda: 99 in [m.json["number"] for m in found.of("/event")], "it goes on")
        server.stop()
    assert reports[-1].dropped == 15
    numbers = [message.json["number"] for message in found.of("/event")]
    assert numbers == [*range(25 - len(numbers) + 1, 25), 99]


async def test_the_last_will_tells_of_a_publisher_that_was_killed(tmp_path: Path, state: PublishedState) -> None:
    with broker(tmp_path) as server:
        publisher = Publisher(Configuration(machine="cell 7", opcua=None, mqtt=settings(server.port), log_level="INFO"))
        publisher.state(state)
        running = asyncio.create_task(publisher.run(), name="publisher")
        try:
            with server.subscribed() as found:
                await until(lambda: found.of("/estimate"), "it publishes")
                (process,) = [
                    each for each in psutil.Process().children() if "service.publishing.publisher" in each.cmdline()
                ]
                process.send_signal(signal.SIGSTOP)  # it hangs: a call that waited would never end
                for number in range(5 * NOTICES):
                    publisher.notice(notice(number))
                process.kill()
                await until(lambda: "offline" in [m.content for m in found.of("/status")], "the broker tells it")
                await until(lambda: found.of("/status")[-1].content == "online", "it was started anew")
                publisher.notice(notice(9999))
                await until(lambda: [m for m in found.of("/event") if m.json["number"] == 9999], "and goes on")
                # before it ends: what it has published and not yet reported would count as dropped
                assert publisher.dropped + len(found.of("/event")) == 5 * NOTICES + 1  # also what the killed one had
        finally:
            running.cancel()
            await asyncio.wait([running])
        with server.subscribed() as after:
            await until(lambda: after.of("/status"), "the status is retained")
            assert after.of("/status")[0].content == "offline"


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # paho closes a refused socket late
async def test_tls_and_password(tmp_path: Path, state: PublishedState) -> None:
    own = certificate(tmp_path, "broker", authority=True)
    secured = Secured(own.certificate, own.key, own.certificate, "cell7", "not-for-logs-4411")
    password = tmp_path / "password"
    password.write_text(secured.password + "\n", "utf-8")
    wrong = tmp_path / "wrong"
    wrong.write_text("something else", "utf-8")
    to = {"host": "localhost", "tls": True, "authority": own.certificate, "user": "cell7"}
    with broker(tmp_path, secured) as server:
        reports: list[FromPublisher] = []
        async with publishing(settings(server.port, **to, password_file=password), reports) as client:
            client.state(state)
            with server.subscribed() as found:
                await until(lambda: found.of("/estimate"), "the state is published")
        for more in ({**to, "password_file": wrong}, {**to, "authority": None, "password_file": password}):
            refused: list[FromPublisher] = []
            async with publishing(settings(server.port, **more), refused):
                await until(lambda refused=refused: refused, "it is refused")
            assert refused[0].trouble.startswith(f"localhost:{server.port}: ")
            assert secured.password not in refused[0].trouble


def test_without_tls_only_on_this_computer(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"mqtt.tls: 'broker.example' is not this computer"):
        Mqtt(host="broker.example", tls=False).checked(trusted_network=False)
    Mqtt(host="broker.example", tls=False).checked(trusted_network=True)
    assert Mqtt(host="broker.example").checked(trusted_network=False).connects_at == 8883
    with pytest.raises(BadInput, match=r"mqtt.password_file: .*missing is not a file"):
        Mqtt(host="b", user="u", password_file=tmp_path / "missing").checked(trusted_network=False)
    with pytest.raises(BadInput, match=r"mqtt.user: is missing"):
        Mqtt(host="b", password_file=tmp_path).checked(trusted_network=False)
