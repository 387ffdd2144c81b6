"""Two pseudo-terminals as a null-modem cable, pumped by hand."""

import os
import selectors
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest

from simulator.modbus.line import PtyPair

pytestmark = pytest.mark.slow


@contextmanager
def terminal(path: str) -> Iterator[int]:
    end = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tty.setraw(end)
        yield end
    finally:
        os.close(end)


def test_bytes_cross_and_nobody_waits_for_a_reader() -> None:
    selector = selectors.SelectSelector()
    pair = PtyPair(selector)

    def pump(patience: float = 0.2) -> None:
        while ready := selector.select(patience):
            for key, mask in ready:
                key.data(mask)

    with terminal(pair.near) as near, terminal(pair.far) as far:
        os.write(near, b"\x01\x03\x0d\x0a")
        pump()
        assert os.read(far, 64) == b"\x01\x03\x0d\x0a"
        os.write(far, b"\x00\xff\x11\x13")
        pump()
        assert os.read(near, 64) == b"\x00\xff\x11\x13"
        for _ in range(64):  # far more than any terminal keeps for a reader that is not there
            with suppress(BlockingIOError):
                os.write(near, bytes(4096))
            pump(0.0)
        pump()
        lost = 64 * 4096
        with suppress(BlockingIOError):
            while data := os.read(far, 65536):
                lost -= len(data)
        assert 0 < lost < 64 * 4096
    pair.close()
    assert not selector.get_map()
    selector.close()
