"""The MQTT client of the publisher process.

Retained topics contain the newest state (`status`, `machine`, `campaign`, `estimate`); `event` contains events, QoS 1.
The last will sets `status` to `offline`. While the broker is not connected, at most `WAITING` notices are kept; the
oldest are dropped and counted.
"""

import asyncio
import ssl
from collections import deque
from collections.abc import Callable
from contextlib import suppress

from aiomqtt import Client, MqttError, Will
from pydantic import BaseModel

from service.process.settings import Mqtt
from service.publishing.state import FromPublisher, Notice, PublishedState


class Broker:
    """One connection at a time."""

    waiting = 1000  # notices

    def __init__(self, settings: Mqtt, machine: str, report: Callable[[FromPublisher], None]) -> None:
        self._settings, self._report = settings, report
        self._stem = f"{settings.topic}/{topic_word(machine)}"
        self._machine = machine
        self._state: PublishedState | None = None
        self._notices: deque[Notice] = deque()
        self._news = asyncio.Event()
        self._dropped = self._published = 0

    def state(self, state: PublishedState) -> None:
        """Set the state; it replaces one that is not published yet."""
        self._state = state
        self._news.set()

    def notice(self, notice: Notice) -> None:
        """Add a notice; returns at once."""
        if len(self._notices) == Broker.waiting:
            self._notices.popleft()
            self._dropped += 1
            if self._dropped in (1, 10, 100) or self._dropped % 1000 == 0:
                self._tell("the broker is away")
        self._notices.append(notice)
        self._news.set()

    async def run(self) -> None:
        """Run until cancelled; then the broker gets the status offline."""
        pause = shortest = 1.0  # s until the next attempt to reach the broker
        while True:
            try:
                async with self._client() as client:
                    pause = shortest
                    try:
                        await self._publish(client)
                    finally:
                        # a clean disconnection sends no last will
                        with suppress(MqttError, asyncio.CancelledError):
                            await self._send(client, "status", "offline", retain=True)
            except (MqttError, OSError) as error:
                if _cancelled():  # aiomqtt failed to disconnect from a broker that is gone: its error replaced it
                    raise asyncio.CancelledError from error
                self._tell(f"{self._settings.host}:{self._settings.connects_at}: {error}")
            await asyncio.sleep(pause)
            pause = min(2 * pause, 30.0)

    async def _publish(self, client: Client) -> None:
        await self._send(client, "status", "online", retain=True)
        self._tell("")
        published: dict[str, BaseModel | None] = {}
        while True:
            self._news.clear()
            if self._state is not None:
                for topic in ("machine", "campaign", "estimate"):
                    part: BaseModel | None = getattr(self._state, topic)
                    if topic not in published or published[topic] != part:
                        await self._send(client, topic, "null" if part is None else part.model_dump_json(), retain=True)
                        published[topic] = part
            while self._notices:
                notice = self._notices[0]
                await self._send(client, "event", notice.model_dump_json())
                if self._notices and self._notices[0] is notice:  # else it was dropped meanwhile
                    self._notices.popleft()  # after the broker has confirmed it
                    self._published += 1
                if not self._notices:
                    self._tell("")
            await self._watch(client)

    async def _watch(self, client: Client) -> None:
        """Wait for new data; MqttError when the connection is lost."""
        lost = asyncio.create_task(_lost(client), name="mqtt connection")
        news = asyncio.create_task(self._news.wait(), name="mqtt news")
        try:
            await asyncio.wait((lost, news), return_when=asyncio.FIRST_COMPLETED)
            if lost.done():
                lost.result()
        finally:
            for task in (lost, news):
                task.cancel()
            await asyncio.gather(lost, news, return_exceptions=True)

    async def _send(self, client: Client, topic: str, content: str, *, retain: bool = False) -> None:
        await client.publish(f"{self._stem}/{topic}", content, qos=1, retain=retain, timeout=10.0)
        if _cancelled():  # together with the broker's answer: on Python 3.11, wait_for in aiomqtt loses it
            raise asyncio.CancelledError

    def _client(self) -> Client:
        settings = self._settings
        password = None if settings.password_file is None else settings.password_file.read_text("utf-8").strip()
        return Client(
            settings.host,
            settings.connects_at,
            username=settings.user,
            password=password,
            identifier=f"sweepid-{topic_word(self._machine)}",
            will=Will(f"{self._stem}/status", "offline", qos=1, retain=True),
            keepalive=settings.keepalive,
            tls_context=self._tls(),
            timeout=10.0,  # s for one message
        )

    def _tls(self) -> ssl.SSLContext | None:
        settings = self._settings
        if not settings.tls:
            return None
        context = ssl.create_default_context(cafile=None if settings.authority is None else str(settings.authority))
        if settings.certificate is not None:
            context.load_cert_chain(settings.certificate, settings.key, password=lambda: "")
        return context

    def _tell(self, trouble: str) -> None:
        self._report(FromPublisher(part="mqtt", trouble=trouble, dropped=self._dropped, published=self._published))


def topic_word(machine: str) -> str:
    """The machine's name has no characters that are invalid in a topic; spaces are replaced for readability."""
    return machine.replace(" ", "_")


async def _lost(client: Client) -> None:
    """MqttError when the connection is lost; nothing is subscribed, so no message arrives."""
    async for _ in client.messages:
        pass


def _cancelled() -> bool:
    """Whether this task was cancelled, even if a library has suppressed the exception."""
    task = asyncio.current_task()
    return task is not None and task.cancelling() > 0
