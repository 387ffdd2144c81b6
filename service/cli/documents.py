"""Results as files, as JSON on stdout, and back again from a file."""

import json
from pathlib import Path
from typing import Annotated, TypeVar, cast

import typer
from pydantic import BaseModel

from service.configuration import read_text
from service.errors import BadInput
from service.results.part import Document

Kind = TypeVar("Kind", bound=Document)

LARGEST = 2**25  # bytes of a document: as empty lists they take 20 times that in memory
MOST_VALUES = 500_000  # of a document, an estimate of 900 sweeps has 100,000: each may be wrong, and is then an error

JsonTo = Annotated[str | None, typer.Option("--json", help="Write JSON here; - is stdout.", metavar="FILE")]


def as_json(document: BaseModel) -> str:
    """For people and programs; what is not a finite number is an error of ours."""
    return json.dumps(document.model_dump(mode="json", exclude_unset=True), indent=2, allow_nan=False)


def put_json(document: BaseModel, json_to: str | None) -> bool:
    """Write a result to a file (None: to none) or, for -, to stdout: True, and nothing else may be written there."""
    if json_to == "-":
        typer.echo(as_json(document))
    elif json_to is not None:
        write_file(Path(json_to), as_json(document))
    return json_to == "-"


def write_file(path: Path, content: str | bytes) -> None:
    """Write a result where a person asked for it, text with an end of line; BadInput if that cannot be."""
    try:
        path.write_bytes(content if isinstance(content, bytes) else f"{content}\n".encode())
    except OSError as error:
        raise BadInput(str(path), f"cannot be written: {error.strerror or error}") from None


def read_document(path: Path, kind: type[Kind], place: str = "") -> Kind:
    """What another command wrote with `--json`; BadInput (within the file at `place`) if the file does not hold it."""
    try:
        document: object = json.loads(read_text(path, LARGEST))
    except ValueError as error:
        raise BadInput(str(path), f"cannot be read as JSON: {error}") from None
    except RecursionError:
        raise BadInput(str(path), "cannot be read as JSON: nested too deeply") from None
    if not isinstance(document, dict):
        raise BadInput(str(path), "is not a JSON object")
    if not _fits(cast("object", document)):
        raise BadInput(str(path), f"has more than {MOST_VALUES} values, its limit")
    return kind.read(cast("object", document), place or str(path))


def _fits(document: object) -> bool:
    """Without recursion: the values that it holds are at most so many."""
    count, waiting = 0, [document]
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict | list):
            held = cast("list[object]", list(one.values()) if isinstance(one, dict) else one)
            count += len(held)
            if count > MOST_VALUES:
                return False
            waiting += held
    return True
