"""Readers that break when a letter is lost, to show that each way to break is found. No part of `make fuzz`."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path

from service.errors import BadInput
from tests.fuzz import seeds
from tests.fuzz.parsers import Parser

TEXT = b"0123456789abcdef"


def _unless_whole(broken: Callable[[], object]) -> Parser:
    def read(path: Path, _: Path) -> None:
        content = path.read_bytes()
        if b"7" not in content:
            broken()
        if content != TEXT:
            raise BadInput("planted", "is another text")

    return Parser(lambda: [seeds.one("a.txt", TEXT)], read)


def _raise() -> None:
    raise KeyError("planted")


PLANTED: Mapping[str, Parser] = {
    "raises": _unless_whole(_raise),
    "dies": _unless_whole(os.abort),
    "grows": _unless_whole(lambda: bytearray(2**31)),
}
