"""The committed OpenAPI document: it is not stale, and each answer has schema, description and a valid example."""

import json
from collections.abc import Iterator
from typing import Any

import jsonschema_rs
import pytest

from service.api.openapi import COMMITTED
from service.api.openapi import document as made

pytestmark = pytest.mark.slow

Json = dict[str, Any]


DOCUMENT: Json = json.loads(COMMITTED.read_text("utf-8"))


def test_the_committed_document_is_not_stale() -> None:
    assert COMMITTED.read_text(encoding="utf-8") == made(), "run: python -m service.api.openapi"


def answers(document: Json) -> Iterator[tuple[str, Json, Json]]:
    """Where it is, the answer, and its body in one media type."""
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            for status, response in operation["responses"].items():
                for media, body in response.get("content", {"nothing": {}}).items():
                    yield f"{method.upper()} {path} {status} {media}", response, body


def missing(document: Json) -> list[str]:
    """The answers that lack something, and what."""
    found: list[str] = []
    for where, response, body in answers(document):
        lacks = [name for name in ("schema", "examples") if not body.get(name)]
        if response.get("description", "Successful Response") == "Successful Response":
            lacks.append("description (the docstring of its model)")
        found += [f"{where}: {', '.join(lacks)}"] if lacks else []
    return found


def test_every_answer_has_schema_description_and_example() -> None:
    assert next(iter(missing(DOCUMENT)), "") == ""


def test_every_example_is_what_its_schema_says() -> None:
    checked: set[str] = set()
    for where, _, body in answers(DOCUMENT):
        if "json" not in where.rpartition(" ")[2]:
            continue
        told = body["examples"]["answer"]
        name = told.get("$ref", "").rpartition("/")[2]
        value = DOCUMENT["components"]["examples"][name]["value"] if name else told["value"]
        schema = {**body["schema"], "components": DOCUMENT["components"]}
        problem = next(iter(jsonschema_rs.Draft202012Validator(schema).iter_errors(value)), None)
        assert problem is None, f"{where}, example {name}: {problem}"
        checked.add(name)
    assert checked
