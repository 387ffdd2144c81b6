"""Types of the API for JSDoc comments (namespace `Api`), written from its OpenAPI document."""

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

DOCUMENT = Path(__file__).parents[2] / "docs" / "reference" / "openapi.json"
PREFIX = "/api/v1"
_SCALARS = {"string": "string", "integer": "number", "number": "number", "boolean": "boolean", "null": "null"}

Schema = Mapping[str, Any]


def declarations(document: Schema) -> str:
    """`Api.NAME` for each schema, and `Api.Answers`: what a method and a path answer when they succeed."""
    schemas = document["components"]["schemas"]
    lines = [f"  type {_name(name)} = {_type(schema)};" for name, schema in schemas.items()]
    answers = [
        f"    {json.dumps(f'{method.upper()} {path.removeprefix(PREFIX)}')}: {_answer(operation)};"
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    ]
    return "\n".join(["declare namespace Api {", *lines, "  interface Answers {", *answers, "  }", "}", ""])


def fields(document: Schema) -> set[str]:
    """The names of all properties of all schemas."""
    return {name for schema in document["components"]["schemas"].values() for name in schema.get("properties", ())}


def _answer(operation: Schema) -> str:
    for status, answer in operation["responses"].items():
        if status.startswith("2"):
            schemas = [media.get("schema", {}) for media in answer.get("content", {}).values()]
            return _type(schemas[0]) if schemas else "never"
    return "never"


def _type(schema: Schema) -> str:
    if "$ref" in schema:
        return _name(schema["$ref"].rpartition("/")[2])
    if "const" in schema:
        return json.dumps(schema["const"])
    if "enum" in schema:
        return " | ".join(json.dumps(value) for value in schema["enum"])
    for several in ("anyOf", "oneOf"):
        if several in schema:
            return "(" + " | ".join(_type(one) for one in schema[several]) + ")"
    if "allOf" in schema:
        return "(" + " & ".join(_type(one) for one in schema["allOf"]) + ")"
    kind = schema.get("type")
    if kind == "array":
        if "prefixItems" in schema:
            return "[" + ", ".join(_type(one) for one in schema["prefixItems"]) + "]"
        return f"{_type(schema.get('items', {}))}[]"
    if kind == "object":
        return _object(schema)
    return _SCALARS.get(str(kind), "unknown")


def _object(schema: Schema) -> str:
    named = schema.get("properties", {})
    required = schema.get("required", ())
    lines = [f"{json.dumps(name)}{'' if name in required else '?'}: {_type(one)}" for name, one in named.items()]
    rest = schema.get("additionalProperties")
    if isinstance(rest, Mapping) and not named:
        return f"{{ [name: string]: {_type(rest)} }}"
    return "{ " + "; ".join(lines) + " }" if named else "{ [name: string]: unknown }"


def _name(name: str) -> str:
    return re.sub(r"\W", "_", name)


def read() -> Schema:
    """The committed document, which another test compares with the service."""
    return json.loads(DOCUMENT.read_text("utf-8"))
