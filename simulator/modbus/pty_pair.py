"""Two pseudo-terminals connected like by a null-modem cable: a serial line without hardware."""

import contextlib
import os
import selectors
from functools import partial

PTY = "pty"  # device name that requests a pair
_CHUNK = 4096


class PtyPair:
    """Bytes written to `near` can be read from `far` and vice versa, transferred by the owner's selector.

    Data is lost if the reader leaves the terminal's buffer full, as on any serial line.
    """

    def __init__(self, selector: selectors.BaseSelector) -> None:
        self._selector = selector
        near, self._near_end = os.openpty()
        far, self._far_end = os.openpty()  # ends stay open here: a master without an open slave is an error
        self.near, self.far = os.ttyname(self._near_end), os.ttyname(self._far_end)
        self._masters = (near, far)
        for source, sink in ((near, far), (far, near)):
            os.set_blocking(source, False)
            selector.register(source, selectors.EVENT_READ, partial(self._carry, source, sink))

    def close(self) -> None:
        """Remove both terminals."""
        for master in self._masters:
            self._selector.unregister(master)
        for end in (*self._masters, self._near_end, self._far_end):
            os.close(end)

    @staticmethod
    def _carry(source: int, sink: int, _: int) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(sink, os.read(source, _CHUNK))
