"""Logs of the service: one JSON object a line on stderr, ours and those of the libraries."""

import logging
import logging.handlers
import sys

import structlog

# they report every frame and every transfer; what goes wrong there the drive adapter says itself
_CHATTY = ("can", "canopen")


def configure_logs(level: str) -> None:
    """To be called once, by the process that serves."""
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.stdlib.add_logger_name,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.stdlib.ExtraAdder(),
        structlog.processors.format_exc_info,
    ]
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[
                structlog.stdlib.ProcessorFormatter.remove_processors_meta,
                structlog.processors.JSONRenderer(),
            ],
        )
    )
    logging.basicConfig(handlers=[handler], level=level, force=True)
    for name in _CHATTY:
        logging.getLogger(name).setLevel(logging.ERROR)
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
    )


class HeldBack(logging.handlers.MemoryHandler):
    """Holds what is logged until `let_through`: of a start that fails for a known reason one line is enough."""

    def __init__(self) -> None:
        """To be made after `configure_logs`."""
        root = logging.getLogger()
        (written,) = root.handlers
        super().__init__(capacity=10**6, flushLevel=logging.CRITICAL + 1, target=written)
        root.handlers = [self]

    def let_through(self) -> None:
        """Write what was held, and from now on everything at once."""
        self.flush()
        self.flushLevel = logging.NOTSET

    def drop(self) -> None:
        """Forget what was held."""
        self.buffer.clear()
