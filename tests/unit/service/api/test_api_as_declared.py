"""The committed OpenAPI document is complete, and whatever is sent to a route, it answers as that says."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, cast

import jsonschema_rs
import pytest
import requests
import schemathesis
from hypothesis import HealthCheck, Phase, settings, strategies as st
from schemathesis.checks import not_a_server_error
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    negative_data_rejection,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
    unsupported_method,
)

from service.web.api.openapi import COMMITTED, document as made_now
from tests.unit.service.api.conftest import identified

pytestmark = pytest.mark.slow

Json = dict[str, Any]


DOCUMENT: Json = json.loads(COMMITTED.read_text("utf-8"))
# an answer of /events never ends (test_api_bundles reads them)
SCHEMA = schemathesis.openapi.from_dict(DOCUMENT).exclude(path="/api/v1/events")
EXAMPLES = 5  # beside those that each field's limits give
EACH = {"/api/v1/plans": 12, "/api/v1/robots": 5, "/api/v1/diagnoses/{diagnosis_id}/experiment": 3}
"""Of routes with many fields so many-th example of those is sent."""

schemathesis.openapi.format("binary", st.binary(max_size=200))


@schemathesis.serializer("application/zip", "application/octet-stream")
def as_it_is(_: object, value: object) -> bytes:
    return value if isinstance(value, bytes) else str(value).encode()


@pytest.fixture(scope="module")
def address(served: str, bundle: Path) -> str:
    """With campaign 1."""
    identified(served, bundle)
    return served


@pytest.fixture(scope="module")
def session() -> Iterator[requests.Session]:
    with requests.Session() as session:
        session.trust_env = False
        yield session


@pytest.fixture(scope="module")
def made() -> Counter[str]:
    """Examples of a route so far."""
    return Counter()


def checking(name: str) -> Callable[..., None]:
    """The test of the route with this operation id."""

    @SCHEMA.include(operation_id=name).parametrize()
    @settings(
        max_examples=EXAMPLES,
        derandomize=True,
        database=None,
        deadline=None,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(cast("Iterable[HealthCheck]", HealthCheck)),
    )
    def answers_are_as_declared(case: Any, address: str, session: requests.Session, made: Counter[str]) -> None:
        methods = DOCUMENT["paths"][case.path]
        made[case.path] += 1
        if case.method.lower() in methods and made[case.path] % EACH.get(case.path, 1):
            return
        answer = case.call(base_url=address, session=session, timeout=60)
        declared = methods.get(case.method.lower(), {}).get("responses", {})
        assert answer.status_code < 500 or (answer.status_code == 503 and "503" in declared), answer.text
        case.validate_response(
            answer,
            excluded_checks=[not_a_server_error],
            checks=[
                content_type_conformance,
                negative_data_rejection,
                response_headers_conformance,
                response_schema_conformance,
                status_code_conformance,
                unsupported_method,
            ],
        )

    return answers_are_as_declared


# each with a name of its own: of tests that share one, xdist does the first alone
NAMES = [route["operationId"] for methods in DOCUMENT["paths"].values() for route in methods.values()]
globals().update({f"test_{name}": checking(name) for name in NAMES if name != "follow_events"})


def test_the_committed_document_is_not_stale() -> None:
    assert COMMITTED.read_text(encoding="utf-8") == made_now(), "run: python -m service.web.api.openapi"


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


def test_generated_clients_find_a_name_for_every_schema_and_a_body_for_every_route() -> None:
    """Generators drop all but letters and digits of names, and know few types of bodies."""
    names = ["".join(filter(str.isalnum, name)).lower() for name in DOCUMENT["components"]["schemas"]]
    assert [name for name, count in Counter(names).items() if count > 1] == []
    assert [
        name for name in DOCUMENT["components"]["schemas"] if "__" in name or name.endswith(("-Input", "-Output"))
    ] == []
    known = {"application/json", "application/octet-stream", "application/x-www-form-urlencoded"}
    routes = [route for path in DOCUMENT["paths"].values() for route in path.values()]
    bodies = {route["operationId"]: set(route["requestBody"]["content"]) for route in routes if "requestBody" in route}
    assert [name for name, types in bodies.items() if not types & known] == []
