"""Edits of what lies in lines: CSV, OBJ, STL as text, EDS and DCF."""

import re
from random import Random

from tests.fuzz import values

_CELLS = re.compile(r"([,;=\s])")


def edit(content: bytes, rng: Random) -> bytes:
    """UnicodeDecodeError where the content is not text any more."""
    lines = content.decode().splitlines(keepends=True)
    if not lines:
        return values.text(rng).encode()
    at = rng.choice((0, rng.randrange(len(lines)), rng.randrange(len(lines))))
    match rng.randrange(9):
        case 0 | 1 | 2 | 3:
            parts = _CELLS.split(lines[at].rstrip("\r\n"))
            parts[2 * rng.randrange((len(parts) + 1) // 2)] = values.text(rng)
            lines[at] = "".join(parts) + "\n"
        case 4:
            del lines[at]
        case 5:
            lines.insert(rng.randrange(len(lines)), lines[at])
        case 6:
            parts = _CELLS.split(lines[at])
            del parts[rng.randrange(len(parts))]
            lines[at] = "".join(parts)
        case 7:
            other = rng.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        case _:
            column, word = rng.randrange(8), values.text(rng)
            lines = [_with_cell(line, column, word) for line in lines]
    return "".join(lines).encode()


def _with_cell(line: str, column: int, word: str) -> str:
    parts = _CELLS.split(line.rstrip("\r\n"))
    if 2 * column < len(parts):
        parts[2 * column] = word
    return "".join(parts) + "\n"
