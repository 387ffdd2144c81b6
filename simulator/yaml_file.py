"""Text and YAML of the files that a virtual machine is described by."""

from pathlib import Path

import yaml

LARGEST = 2**26  # bytes
# PyYAML's own for a value that is not of its tag (`2001-13-45`, `!!bool x`, 5000 digits), beside YAMLError
_NO_VALUE = (ValueError, LookupError, AttributeError)


def read_text(path: Path) -> str:
    """The UTF-8 text of a file. OSError; ValueError where it is no such text, or endless."""
    with path.open("rb") as file:
        content = file.read(LARGEST + 1)
    if len(content) > LARGEST:
        raise ValueError(f"is larger than {LARGEST} bytes")
    return content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")


def parse_yaml(text: str) -> object:
    """What a YAML text holds; ValueError says why it is none."""
    try:
        return yaml.safe_load(text)
    except RecursionError:
        raise ValueError("not YAML of any use: nested too deeply") from None
    except (yaml.YAMLError, *_NO_VALUE) as error:
        raise ValueError(f"not YAML: {error}") from None
