"""The file in which `sweepid identify --json` hands an estimate to other commands."""

import hashlib
import json
from pathlib import Path
from typing import Any, cast

from service.configuration import read_text
from service.errors import BadInput


def read_estimate(path: Path) -> dict[str, Any]:
    """The estimate's document; BadInput if the file is not a JSON object."""
    try:
        document: object = json.loads(read_text(path))
    except ValueError as error:
        raise BadInput(str(path), f"not JSON: {error}") from None
    if not isinstance(document, dict):
        raise BadInput(str(path), "is not the JSON object of an estimate")
    return cast("dict[str, Any]", document)


def source_of_file(path: Path) -> str:
    """Which file it was, with the hash of what it held."""
    return f"{path.name}, sha256 {hashlib.sha256(path.read_bytes()).hexdigest()}"
