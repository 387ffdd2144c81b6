"""The publisher process: reads lines of the service from stdin, writes reports to stdout; runs at lower priority.

It ends at the end of stdin: it closes the OPC UA server and sends the status offline to the MQTT broker.
"""

import asyncio
import signal
import sys
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING

from service.process.logs import configure_logs
from service.process.tasks import Background, give_way
from service.publishing.state import Configuration, FromPublisher, ToPublisher

if TYPE_CHECKING:
    from service.publishing.mqtt import Broker
    from service.publishing.opcua.server import Server

_LINE = 16 * 2**20  # bytes


def main() -> None:
    """Run until stdin ends."""
    give_way()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # SIGINT from the terminal is handled by the service
    asyncio.run(_publish())


def report(line: FromPublisher) -> None:
    """Report to the service, which reads it at once or has ended."""
    sys.stdout.write(line.model_dump_json() + "\n")
    sys.stdout.flush()


async def _publish() -> None:
    lines = asyncio.StreamReader(limit=_LINE)
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


def _opened(configuration: Configuration, background: Background) -> "tuple[Server | None, Broker | None]":
    """Each library is only imported if used: both belong to extras."""
    opcua = mqtt = None
    if configuration.opcua is not None:
        from service.publishing.opcua.server import Server

        opcua = Server(configuration.opcua, configuration.machine, report)
        background.begin("opcua", opcua.run())
    if configuration.mqtt is not None:
        from service.publishing.mqtt import Broker

        mqtt = Broker(configuration.mqtt, configuration.machine, report)
        background.begin("mqtt", mqtt.run())
    return opcua, mqtt


if __name__ == "__main__":
    main()
