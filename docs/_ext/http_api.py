"""Appends all routes of `reference/openapi.json` to `reference/http-api.md`."""

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from markdown_table import cell, table
from sphinx.application import Sphinx

PAGE = "reference/http-api"
_REF = "#/components/schemas/"


def setup(app: Sphinx) -> Mapping[str, bool]:
    app.connect("source-read", _append)
    return {"parallel_read_safe": True}


def _append(app: Sphinx, document: str, source: list[str]) -> None:
    if document == PAGE:
        app.env.note_dependency("reference/openapi.json")
        told = json.loads(Path(app.srcdir, "reference/openapi.json").read_text("utf-8"))
        source[0] += "\n".join((*_routes(told["paths"]), *_schemas(told["components"]["schemas"])))


def _routes(paths: Mapping[str, Any]) -> Iterator[str]:
    by_tag: dict[str, list[tuple[str, str, Any]]] = defaultdict(list)
    for path, methods in paths.items():
        for method, operation in methods.items():
            by_tag[operation["tags"][0]].append((method.upper(), path, operation))
    for tag, operations in by_tag.items():
        yield f"\n## {tag.capitalize()}\n"
        for method, path, operation in operations:
            yield from _route(method, path, operation)


def _route(method: str, path: str, operation: Mapping[str, Any]) -> Iterator[str]:
    yield f"\n### `{method} {path}`\n\n{cell(operation.get('description', ''))}\n"
    role = operation.get("x-least-role")
    yield f"Least role: {role}.\n" if role else "Needs no key.\n"
    yield from table(
        ("parameter", "in", "type", "what it says"),
        (
            (
                f"`{one['name']}`{' (required)' if one.get('required') else ''}",
                one["in"],
                _type(one["schema"]),
                cell(one.get("description", "")),
            )
            for one in operation.get("parameters", ())
        ),
    )
    for media, content in operation.get("requestBody", {}).get("content", {}).items():
        yield f"Body: `{media}`, {_type(content.get('schema', {}))}.\n"
    yield from table(
        ("answer", "content", "when"),
        (
            (status, ", ".join(_answers(answer.get("content", {}))), cell(answer["description"]))
            for status, answer in operation["responses"].items()
        ),
    )


def _answers(content: Mapping[str, Any]) -> Iterator[str]:
    for media, told in content.items():
        kind = _type(told.get("schema", {}))
        yield f"`{media}` {kind}" if kind.startswith(("[", "list")) else f"`{media}`"


def _schemas(schemas: Mapping[str, Any]) -> Iterator[str]:
    yield "\n## Documents\n"
    for name in sorted(schemas):
        schema = schemas[name]
        yield f"\n### {name}\n\n{cell(schema.get('description', ''))}\n"
        if "enum" in schema:
            yield f"One of {', '.join(f'`{one}`' for one in schema['enum'])}.\n"
        required = schema.get("required", ())
        yield from table(
            ("member", "type", "what it says"),
            (
                (f"`{member}`{' (required)' if member in required else ''}", _type(of), cell(of.get("description", "")))
                for member, of in schema.get("properties", {}).items()
            ),
        )


def _type(schema: Mapping[str, Any]) -> str:
    """A type in words, with links to other documents."""
    if "$ref" in schema:
        name = schema["$ref"].removeprefix(_REF)
        return f"[{name}](#{name.lower()})"
    for key in ("anyOf", "oneOf", "allOf"):
        if key in schema:
            return " or ".join(dict.fromkeys(_type(one) for one in schema[key]))
    if "enum" in schema:
        return ", ".join(f"`{one}`" for one in schema["enum"])
    if "const" in schema:
        return f"`{schema['const']}`"
    match schema.get("type"):
        case "array":
            return f"list of {_type(schema['items'])}" if schema.get("items") else "list"
        case "object" if isinstance(schema.get("additionalProperties"), dict) and schema["additionalProperties"]:
            return f"object of {_type(schema['additionalProperties'])}"
        case None:
            return "any"
        case str() as word:
            return word
        case words:
            return " or ".join(words)
