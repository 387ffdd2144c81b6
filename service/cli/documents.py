"""Results as files, and as JSON on stdout."""

from pathlib import Path

import typer

from service.model.errors import writing
from service.model.results.part import Part


def put_json(document: Part, json_to: str | None) -> bool:
    """Write a result to a file (None: to none) or, for -, to stdout: True, and nothing else may be written there."""
    if json_to == "-":
        typer.echo(document.to_json())
    elif json_to is not None:
        write_file(Path(json_to), document.to_json())
    return json_to == "-"


def write_file(path: Path, content: str | bytes) -> None:
    """Write a result where a person asked for it, text with an end of line; BadInput if that cannot be."""
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else f"{content}\n".encode())
