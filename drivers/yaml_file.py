"""Reads the YAML files that describe a machine: profile, device map, register map."""

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import yaml

from drivers.bounded_yaml import NO_VALUE, BoundedLoader
from drivers.errors import BadProfile

LARGEST = 2**20  # bytes


def read_mapping(path: Path, key: str) -> Mapping[str, object]:
    """The content of the file, which must have the key `key`. BadProfile has the reason but not the file name."""
    try:
        with path.open("rb") as file:
            text = file.read(LARGEST + 1)
        if len(text) > LARGEST:
            raise BadProfile(f"is larger than {LARGEST} bytes")
        content: object = yaml.load(text.decode("utf-8"), Loader=BoundedLoader)
    except OSError as error:
        raise BadProfile(str(error.strerror)) from None
    except (yaml.YAMLError, *NO_VALUE) as error:
        raise BadProfile(f"not YAML: {' '.join(str(error).split())}") from None
    if not isinstance(content, Mapping):
        raise BadProfile(f"must be a mapping with the key '{key}'")
    return cast("Mapping[str, object]", content)
