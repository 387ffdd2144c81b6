"""The log of a start of the service."""

import logging
import logging.handlers


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
        """Forget what was held, and what else is said of this start: what is closed after it speaks of it as well."""
        self.buffer.clear()
        self.setTarget(logging.NullHandler())
