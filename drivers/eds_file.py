"""Reads EDS and DCF files (CiA 306) within limits: the libraries that parse them trust the lengths stated in the
file.
"""

import re
from configparser import RawConfigParser
from pathlib import Path

LARGEST = 2**22  # bytes; typical files of manufacturers have 0.1 MB
MOST_ENTRIES = 254  # maximum number of sub-indices of an object


def read_eds(path: Path) -> bytes:
    """The content of the file. Raises OSError, or ValueError if the file is too large."""
    with path.open("rb") as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise ValueError(f"is larger than {LARGEST} bytes")
    return content


def check_entries(content: bytes) -> None:
    """Raises ValueError (including UnicodeError) if a section states more sub-indices than an object can have, and
    configparser.Error if the file cannot be parsed.
    """
    parser = RawConfigParser(inline_comment_prefixes=(";",), strict=False)
    parser.read_string(content.decode("utf-8"))
    for section in parser.sections():
        stated = parser.get(section, "NrOfEntries", fallback="0")
        if re.match("[0-9A-Fa-f]{4}Name", section) and int(stated) > MOST_ENTRIES:
            raise ValueError(f"section {section}: NrOfEntries is {stated[:20]}, limit {MOST_ENTRIES}")
