"""Reads text and YAML files that describe a virtual machine."""

from pathlib import Path

import yaml

from drivers.bounded_yaml import NO_VALUE, BoundedLoader

LARGEST = 2**26  # bytes
LARGEST_YAML = 2**20  # bytes


def read_text(path: Path) -> str:
    """The UTF-8 text of a file. Raises OSError, and ValueError if it is not UTF-8 or too large."""
    with path.open("rb") as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise ValueError(f"is larger than {LARGEST} bytes")
    return content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")


def parse_yaml(text: str) -> object:
    """The content of a YAML text. Raises ValueError with the reason if it is invalid."""
    if len(text) > LARGEST_YAML:
        raise ValueError(f"YAML of {len(text)} characters, limit {LARGEST_YAML}")
    try:
        return yaml.load(text, Loader=BoundedLoader)
    except (yaml.YAMLError, *NO_VALUE) as error:
        raise ValueError(f"not YAML: {' '.join(str(error).split())}") from None
