"""Two pseudo-terminals joined like a null-modem cable, so that a serial line exists without hardware."""

import contextlib
import os
import selectors
from functools import partial

_CHUNK = 4096


class PtyPair:
    """Bytes written to `near` can be read from `far` and the other way, carried by the owner's selector.

    What a reader leaves unread when the terminal's buffer is full is lost, as on any serial line.
    """

    def __init__(self, selector: selectors.BaseSelector) -> None:
        self._selector = selector
        near, self._near_end = os.openpty()
        far, self._far_end = os.openpty()  # ends stay open here: a master whose other end nobody has open is an error
        self.near, self.far = os.ttyname(self._near_end), os.ttyname(self._far_end)
        self._masters = (near, far)
        for source, sink in ((near, far), (far, near)):
            os.set_blocking(source, False)
            selector.register(source, selectors.EVENT_READ, partial(self._carry, source, sink))

    def close(self) -> None:
        """Both terminals vanish."""
        for master in self._masters:
            self._selector.unregister(master)
        for end in (*self._masters, self._near_end, self._far_end):
            os.close(end)

    @staticmethod
    def _carry(source: int, sink: int, _: int) -> None:
        with contextlib.suppress(BlockingIOError):
            os.write(sink, os.read(source, _CHUNK))
