"""The tree of a control's XML file, read with size limits; each member records whether it was used.

A DOCTYPE is rejected, so there are no entities and a small file cannot expand. Unused members can be listed.
"""

import base64
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol
from xml.parsers import expat

import numpy as np

from service import BadInput
from service.model import Array

LARGEST = 32_000_000  # bytes of a file; the control writes 0.2 to 0.3 MB

HUGE = 1e15  # larger than any measured quantity, in each unit of the control


@dataclass(slots=True)
class Member:
    """One element: its type (the tag), `name`, text, and members. `used` becomes true when it is read."""

    kind: str
    name: str
    version: str
    place: str
    pieces: list[str] = field(default_factory=list[str])
    children: "list[Member]" = field(default_factory=list["Member"])
    used: bool = False

    @property
    def text(self) -> str:
        return "".join(self.pieces)

    def each(self, kind: str) -> "Iterator[Member]":
        """Members of a type, at any depth, in the order of the file."""
        for child in self.children:
            if child.kind == kind:
                yield child
            yield from child.each(kind)

    def find(self, name: str) -> "Member | None":
        """The first direct member with this name, or None."""
        return next((child for child in self.children if child.name == name), None)

    def get(self, name: str) -> "Member":
        """The same; BadInput if it is missing."""
        found = self.find(name)
        if found is None:
            raise BadInput(self.place, f"has no member {name}")
        return found

    def first(self, kind: str) -> "Member":
        """The first member of a type at any depth; BadInput if there is none."""
        found = next(self.each(kind), None)
        if found is None:
            raise BadInput(self.place, f"has no {kind}")
        return found

    def string(self, name: str) -> str:
        member = self.get(name)
        member.used = True
        return member.text.strip()

    def number(self, name: str) -> float:
        """A number of plausible size; BadInput otherwise."""
        text = self.string(name)
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not abs(value) < HUGE:
            raise BadInput(self.place, f"member {name} is {text!r}, which is not a number below {HUGE:g}")
        return value

    def whole(self, name: str) -> int:
        value = self.number(name)
        if value != int(value):
            raise BadInput(self.place, f"member {name} is {value!r}, which is not a whole number")
        return int(value)

    def flag(self, name: str) -> bool:
        text = self.string(name)
        if text not in ("true", "false"):
            raise BadInput(self.place, f"member {name} is {text!r}, neither true nor false")
        return text == "true"

    def array(self, name: str, per_value: int = 1) -> Array:
        """Numbers (n,), or (n, 2) with `per_value` 2, of a NumericArray; BadInput if their number is not as stated."""
        member = self.get(name)
        length, raw = member.whole("m_length"), member.get("m_pNumberArray")
        raw.used = True
        values = decode(raw.text, f"{member.place} {name}")
        if len(values) != length * per_value:
            raise BadInput(self.place, f"member {name} has {len(values)} numbers, and says {length} of {per_value}")
        return values if per_value == 1 else values.reshape(-1, per_value)

    def unread(self) -> tuple[str, ...]:
        """`type/name` of the members with values of which none was read."""
        leaves = [(f"{holder.kind}/{leaf.name or leaf.kind}", leaf.used) for holder, leaf in self._leaves()]
        used = {path for path, was_used in leaves if was_used}
        return tuple(dict.fromkeys(path for path, _ in leaves if path not in used))

    def _leaves(self) -> "Iterator[tuple[Member, Member]]":
        """Each member with a value, and its parent."""
        for child in self.children:
            if child.children:
                yield from child._leaves()
            elif child.text.strip():
                yield self, child


def read_members(path: Path) -> Member:
    """The root of a file; BadInput if missing, too large, too deep, truncated, no XML, or with a DOCTYPE."""
    builder = _MemberBuilder(str(path))
    parse(path, builder, LARGEST, "; a measurement of the control is not")
    return builder.top.children[0]


class ElementBuilder(Protocol):
    """Callbacks of expat."""

    def start(self, kind: str, attributes: dict[str, str], /) -> None: ...

    def end(self, kind: str, /) -> None: ...

    def characters(self, text: str, /) -> None: ...


def parse(path: Path, builder: ElementBuilder, largest: int, limit: str = "") -> None:
    """All elements of a control's file; BadInput if it is missing, of more than `largest` bytes, truncated, no XML, or
    with a DOCTYPE. `limit`: words on the size.
    """

    def doctype(*_: object) -> None:
        raise BadInput(str(path), "declares a DOCTYPE, which no file of the control does; entities are not expanded")

    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartDoctypeDeclHandler = doctype
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.characters
    try:
        fed, size = 0, path.stat().st_size
        with path.open("rb") as file:
            while max(fed, size) <= largest and (part := file.read(2**16)):
                fed += len(part)
                parser.Parse(part)
        if max(fed, size) > largest:
            raise BadInput(str(path), f"is larger than {largest} bytes{limit}")
        parser.Parse(b"", True)
    except OSError as error:
        raise BadInput(str(path), f"cannot be read: {error.strerror or error}") from None
    except (expat.ExpatError, ValueError, LookupError) as error:  # truncated, no XML, or of an unknown encoding
        raise BadInput(str(path), f"is not a complete XML file: {error}") from None


class _MemberBuilder:
    """The tree of all elements."""

    def __init__(self, place: str) -> None:
        self.top = Member("", "", "", place)
        self._open = [self.top]
        self._count = 0

    def start(self, kind: str, attributes: dict[str, str]) -> None:
        self._count += 1
        most, deepest = 200_000, 64
        if self._count > most or len(self._open) > deepest:
            raise BadInput(self.top.place, f"has more than {most} members, or more than {deepest} inside of each other")
        member = Member(kind, attributes.get("name", ""), attributes.get("ver", ""), self.top.place)
        self._open[-1].children.append(member)
        self._open.append(member)

    def end(self, _: str) -> None:
        self._open.pop()

    def characters(self, text: str) -> None:
        self._open[-1].pieces.append(text)


def decode(text: str, place: str) -> Array:
    """Doubles (n,), most significant byte first, of a text in base 85, where a point is a word of zero.

    BadInput at `place` if it is truncated, in another format, or has non-finite numbers.
    """
    ours = b"0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ!#$`()*+-/:;=?@[]^_{|}~"
    theirs = b"0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz!#$%&()*+-;<=>?@^_`{|}~"
    words = "".join(text.split()).split(".")
    if any(len(run) % 5 for run in words):
        raise BadInput(
            place, "base-85 data are incomplete: the number of characters between two points is not a multiple of 5"
        )
    characters = "00000".join(words).encode("latin-1", "replace")
    if characters.translate(None, ours):
        raise BadInput(place, "has a character that is not of the control's base 85")
    try:
        content = base64.b85decode(characters.translate(bytes.maketrans(ours, theirs)))
    except ValueError:  # a word of more than 32 bits
        content = b""
    if len(content) % 8 or len(content) * 5 != len(characters) * 4:
        raise BadInput(place, f"{len(characters) // 5} words of base 85 are not whole doubles")
    numbers = np.frombuffer(content, dtype=">f8").astype(np.float64)
    sensible = np.abs(numbers) < HUGE  # False for NaN
    if not sensible.all():
        raise BadInput(place, f"number {int(np.flatnonzero(~sensible)[0])} is NaN, or not below {HUGE:g}")
    return numbers
