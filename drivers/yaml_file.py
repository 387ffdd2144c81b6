"""The YAML files that a machine is described by: profile, device map, register map."""

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import yaml

from drivers.errors import BadProfile

LARGEST = 2**20  # bytes
# PyYAML's own for a value that is not of its tag (`2001-13-45`, `!!bool x`, 5000 digits), beside YAMLError
_NO_VALUE = (ValueError, LookupError, AttributeError)


def read_mapping(path: Path, key: str) -> Mapping[str, object]:
    """The file's content; BadProfile gives the reason, not the file. `key`: the one that it must have, for people."""
    try:
        with path.open("rb") as file:
            text = file.read(LARGEST + 1)
        if len(text) > LARGEST:
            raise BadProfile(f"is larger than {LARGEST} bytes")
        content: object = yaml.safe_load(text.decode("utf-8"))
    except OSError as error:
        raise BadProfile(str(error.strerror)) from None
    except RecursionError:
        raise BadProfile("not YAML of any use: nested too deeply") from None
    except (yaml.YAMLError, *_NO_VALUE) as error:
        raise BadProfile(f"not YAML: {error}") from None
    if not isinstance(content, Mapping):
        raise BadProfile(f"must be a mapping with the key '{key}'")
    return cast("Mapping[str, object]", content)
