"""Appends all commands with their options to `reference/options.md`, as the program itself tells them."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from markdown_table import cell, table
from sphinx.application import Sphinx

from service.cli import build

PAGE = "reference/options"


def setup(app: Sphinx) -> Mapping[str, bool]:
    app.connect("source-read", _append)
    return {"parallel_read_safe": True}


def _append(_app: Sphinx, document: str, source: list[str]) -> None:
    if document == PAGE:
        source[0] += "\n".join(
            line for name, command in sorted(build().every(), key=lambda one: one[0]) for line in _told(command, name)
        )


def _told(command: Any, name: str) -> Iterator[str]:
    """Of a command. `Any`: typer has no public type of what it builds."""
    yield f"\n## `sweepid {name}`\n\n{(command.help or '').strip()}\n"
    yield from table(("option", "default", "what it says"), map(_row, command.params))


def _row(parameter: Any) -> Iterable[str]:
    if parameter.param_type_name == "argument":
        return f"`{parameter.metavar or parameter.name.upper()}`", _default(parameter), cell(parameter.help or "")
    names = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
    return names, _default(parameter), cell(parameter.help or "")


def _default(parameter: Any) -> str:
    if parameter.required:
        return "required"
    return "" if parameter.default in (None, False, (), []) else f"`{parameter.default}`"
