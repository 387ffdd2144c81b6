"""The YAML files that a machine is described by: profile, device map, register map."""

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import yaml

from drivers.errors import BadProfile


def read_mapping(path: Path, key: str) -> Mapping[str, object]:
    """The file's content; BadProfile gives the reason, not the file. `key`: the one that it must have, for people."""
    try:
        content: object = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadProfile(str(error.strerror)) from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise BadProfile(f"not YAML: {error}") from None
    if not isinstance(content, Mapping):
        raise BadProfile(f"must be a mapping with the key '{key}'")
    return cast("Mapping[str, object]", content)
