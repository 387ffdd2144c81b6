"""The publisher process, from both sides of its pipes.

Of the service (`Publisher`): data are kept, replaced or dropped; the service never waits. The process itself (`main`)
reads lines from stdin, writes reports to stdout, and runs at lower priority. It ends at the end of stdin: it closes the
OPC UA server and sends the status offline to the MQTT broker.
"""

import asyncio
import signal
import sys
from collections import deque
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING

import structlog

from service.process.logs import configure_logs
from service.process.tasks import Background, child_process, give_way
from service.publishing.state import Configuration, FromPublisher, Notice, PublishedState, ToPublisher

if TYPE_CHECKING:
    from service.publishing.mqtt import Broker
    from service.publishing.opcua import OpcUaServer


_log = structlog.get_logger(__name__)

NOTICES = 256  # waiting for the publisher; the oldest are dropped


class Publisher:
    """One process, restarted when it ends. Must be created in the event loop."""

    def __init__(self, configuration: Configuration) -> None:
        self._configuration = configuration
        self._state: PublishedState | None = None
        self._sent: PublishedState | None = None
        self._notices: deque[Notice] = deque(maxlen=NOTICES)
        self._news = asyncio.Event()
        self._dropped = 0
        self._sent_notices = 0  # to the current process
        self._life = FromPublisher(part="mqtt")  # its last report
        self._troubles: dict[str, str] = {}
        self.ports: dict[str, int] = {}
        """Ports of its servers, by part; may change at a restart if any free port is used."""

    @property
    def dropped(self) -> int:
        """Number of notices that were not published, since the start of the service."""
        return self._dropped + self._life.dropped

    @property
    def troubles(self) -> dict[str, str]:
        """Reason why a part does not work, by part; empty if all work."""
        return {part: trouble for part, trouble in self._troubles.items() if trouble}

    @property
    def parts(self) -> tuple[str, ...]:
        """The configured parts."""
        wanted = {"opcua": self._configuration.opcua, "mqtt": self._configuration.mqtt}
        return tuple(part for part, settings in wanted.items() if settings is not None)

    def state(self, state: PublishedState) -> None:
        """Set the state; it replaces one that was not sent yet. Returns at once."""
        self._state = state
        self._news.set()

    def notice(self, notice: Notice) -> None:
        """Add a notice; returns at once; drops the oldest if too many wait."""
        if len(self._notices) == NOTICES:
            self._dropped += 1
        self._notices.append(notice)
        self._news.set()

    async def run(self) -> None:
        """Run until cancelled."""
        while True:
            try:
                await self._serve()
            except (OSError, ValueError) as error:  # it ended, or sent an invalid line
                reason = str(error) or type(error).__name__
                _log.warning("publisher_ended", reason=reason)
                self._troubles = dict.fromkeys(self.parts, "the publisher is started anew")
            await asyncio.sleep(2.0)

    async def _serve(self) -> None:
        """Run the process once; OSError when it ends."""
        try:
            async with child_process("service.publishing.publisher", patience=5.0) as (process, stdin, stdout):
                hearing = asyncio.create_task(self._hear(stdout), name="publisher reports")
                writing = asyncio.create_task(self._write(stdin), name="to the publisher")
                both = (hearing, writing)
                try:
                    await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    for task in both:
                        task.cancel()
                    ends = await asyncio.gather(*both, return_exceptions=True)
        finally:
            self._lose()
        for end in ends:
            if isinstance(end, Exception):
                raise end
        raise BrokenPipeError(f"ended with code {process.returncode}")

    async def _write(self, stdin: asyncio.StreamWriter) -> None:
        self._sent = None  # a new process has no state
        await _send(stdin, ToPublisher(configuration=self._configuration))
        while True:
            self._news.clear()
            newest = self._state
            if newest is not None and newest is not self._sent:
                self._sent = newest
                await _send(stdin, ToPublisher(state=newest))
            while self._notices:
                self._sent_notices += 1
                await _send(stdin, ToPublisher(notice=self._notices.popleft()))
            await self._news.wait()

    async def _hear(self, stdout: asyncio.StreamReader) -> None:
        self._troubles = {}
        while line := await stdout.readline():
            said = FromPublisher.model_validate_json(line)
            if said.trouble != self._troubles.get(said.part) or said.port is not None:
                _log.info("publishing", part=said.part, port=said.port, trouble=said.trouble)
            self._troubles[said.part] = said.trouble
            if said.part == "mqtt":
                self._life = said
            if said.port is not None:
                self.ports[said.part] = said.port

    def _lose(self) -> None:
        """Count the notices that the ended process had received and not published as lost."""
        if self._configuration.mqtt is not None:
            self._dropped += self._sent_notices - self._life.published
        self._sent_notices, self._life = 0, FromPublisher(part="mqtt")


async def _send(pipe: asyncio.StreamWriter, line: ToPublisher) -> None:
    pipe.write(line.model_dump_json(exclude_none=False).encode() + b"\n")
    await pipe.drain()


def main() -> None:
    """Run until stdin ends."""
    give_way()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # SIGINT from the terminal is handled by the service
    asyncio.run(_publish())


def _report(line: FromPublisher) -> None:
    """Report to the service, which reads it at once or has ended."""
    sys.stdout.write(line.model_dump_json() + "\n")
    sys.stdout.flush()


async def _publish() -> None:
    lines = asyncio.StreamReader(limit=16 * 2**20)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    first = ToPublisher.model_validate_json(await lines.readline()).configuration
    if first is None:
        raise ValueError("the first line has no configuration")
    configure_logs(first.log_level)
    async with AsyncExitStack() as stack:
        background = Background()
        stack.push_async_callback(background.close)
        opcua, mqtt = _opened(first, background)
        while line := await lines.readline():
            said = ToPublisher.model_validate_json(line)
            if said.state is not None:
                if opcua is not None:
                    opcua.state(said.state)
                if mqtt is not None:
                    mqtt.state(said.state)
            if said.notice is not None and mqtt is not None:
                mqtt.notice(said.notice)


def _opened(configuration: Configuration, background: Background) -> "tuple[OpcUaServer | None, Broker | None]":
    """Each library is only imported if used: both belong to extras."""
    opcua = mqtt = None
    if configuration.opcua is not None:
        from service.publishing.opcua import OpcUaServer

        opcua = OpcUaServer(configuration.opcua, configuration.machine, _report)
        background.begin("opcua", opcua.run())
    if configuration.mqtt is not None:
        from service.publishing.mqtt import Broker

        mqtt = Broker(configuration.mqtt, configuration.machine, _report)
        background.begin("mqtt", mqtt.run())
    return opcua, mqtt


if __name__ == "__main__":
    main()
