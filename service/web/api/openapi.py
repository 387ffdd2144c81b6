"""Writes the committed OpenAPI document: ``python -m service.web.api.openapi`` (a test fails if it is out of date)."""

import json
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

from fastapi import FastAPI

from service.process.settings import Settings
from service.store.access import Role
from service.web.api.problem import MEDIA_TYPE, Problem
from service.web.api.route_roles import Permissions

COMMITTED = Path(__file__).parents[3] / "docs" / "reference" / "openapi.json"


def document() -> str:
    """The document as JSON text; needs neither an application nor a machine."""
    from service.web.app import create_app

    return json.dumps(create_app(Settings()).openapi(), indent=2, ensure_ascii=False) + "\n"


Json = dict[str, Any]


if __name__ == "__main__":
    COMMITTED.write_text(document(), encoding="utf-8")


_PROBLEM = {"$ref": f"#/components/schemas/{Problem.__name__}"}


class DeclaredApi(FastAPI):
    """FastAPI declares every model as `application/json`; problems have another media type."""

    def openapi(self) -> dict[str, Any]:
        document = super().openapi()
        permissions: Permissions = self.state.permissions
        document["components"].setdefault("securitySchemes", {}).update(
            key={
                "type": "http",
                "scheme": "bearer",
                "description": "an API key, where the service has the setting `login: true`",
            },
            session={
                "type": "apiKey",
                "in": "cookie",
                "name": "sweepid-8642",
                "description": "a session, which POST /login opens; its cookie bears the number of the port",
            },
        )
        for where, path in cast("dict[str, dict[str, Any]]", document["paths"]).items():
            for method, operation in path.items():
                needed = permissions.roles[method.upper(), where]
                if needed is not None:
                    operation["security"] = [{}, {"key": []}, {"session": []}]  # no security in a service without login
                    operation["x-least-role"] = needed.word
                    operation["responses"] |= _refusals(needed)
                for response in operation["responses"].values():
                    content = cast("dict[str, Any]", response.get("content", {}))
                    for media in [name for name, body in content.items() if body.get("schema") == _PROBLEM]:
                        content[MEDIA_TYPE] = content.pop(media)
        complete(document)
        return document


def _refusals(needed: Role) -> dict[str, Any]:
    content = {MEDIA_TYPE: {"schema": _PROBLEM}}
    asked = {"WWW-Authenticate": {"schema": {"type": "string"}}}
    return {
        "401": {"description": "no API key, or a key that is not valid", "headers": asked, "content": content},
        "403": {"description": f"requires {needed.word}, or was sent by a page of another origin", "content": content},
    }


_EXAMPLES: Json = json.loads(files("service.web.api").joinpath("examples.json").read_text("utf-8"))
_NO_DESCRIPTION = "Successful Response"  # FastAPI's text for an answer without description
_TEXTS: dict[str, tuple[str, str]] = {
    "application/pdf": ("The file: pages of A4, or the tables.", "%PDF and pages"),
    "application/vnd.apache.parquet": ("The recording's file, with the columns of a bundle.", "PAR1 and columns"),
    "application/xml": ("The identified robot.", '<?xml version="1.0"?>\n<robot name="max100-class">...</robot>'),
    "application/yaml": ("A YAML file.", "robot: max100-class-robot.yaml\n"),
    "application/zip": ("The bundle: bundle.json, the robot's files and one recording a sweep.", "PK and files"),
    "text/event-stream": (
        "Events as they happen, until the connection ends.",
        'id: 7\nevent: sweep\ndata: {"id":7,"campaign_id":1,"kind":"sweep","data":{"number":1,"state":"running",'
        '"cause":"","axis":"joint_1","attempt":1},"at":"2026-11-23T12:00:00Z"}\n\n',
    ),
    "text/html": ("One page with figures, complete in one file.", '<!doctype html>\n<html lang="en">...</html>'),
    "text/markdown": ("A page of text.", "# Dynamics of max100-class for its control\n"),
    "text/plain": ("Metrics in the text format of Prometheus.", "sweepid_machine_connected 1.0\n"),
}
"""Description of the answers without a model, and their first bytes."""


def complete(document: Json) -> None:
    """Add descriptions and examples to the answers of an OpenAPI document, in place."""
    examples: Json = document["components"].setdefault("examples", {})
    for path in document["paths"].values():
        for operation in path.values():
            for status, response in operation["responses"].items():
                for media, body in response.get("content", {}).items():
                    schema = body.setdefault("schema", {"type": "string"})
                    description, name = _described(document, schema, media)
                    if response.get("description", _NO_DESCRIPTION) == _NO_DESCRIPTION:
                        response["description"] = description
                    example = _example(name, status, media)
                    if example is not None and "examples" not in body:
                        key = name if status in ("200", "201", "202", "default") else f"{name}_{status}"
                        examples[key] = {"value": example}
                        body["examples"] = {"answer": {"$ref": f"#/components/examples/{key}"}}


def _described(document: Json, schema: Json, media: str) -> tuple[str, str]:
    """Description of the answer, and the name of its example."""
    some = schema.get("anyOf", [schema])[0]  # an alternative null needs no description of its own
    of = some.get("items", some).get("$ref", "").removeprefix("#/components/schemas/")
    if not of:
        return _TEXTS.get(media, ("", ""))[0] or _NO_DESCRIPTION, media.replace("/", ".")
    page, item = of.startswith("Page_"), of.removeprefix("Page_").removesuffix("_")
    description = " ".join(
        document["components"]["schemas"][item].get("description", _NO_DESCRIPTION).split("\n\n")[0].split()
    )
    if page:
        return f"Part of a list, oldest first. {description}", of
    return (f"A list. {description}", f"List_{of}_") if "items" in schema else (description, of)


def _example(name: str, status: str, media: str) -> Any:
    """The example; None if there is none."""
    kind, _, of = name.removesuffix("_").partition("_")
    if kind == "Page" and of in _EXAMPLES:
        return {"items": [_EXAMPLES[of]], "next": None}
    if kind == "List" and of in _EXAMPLES:
        return [_EXAMPLES[of]]
    if media in _TEXTS:
        return _TEXTS[media][1]
    return _EXAMPLES.get(f"{name}_{status}", _EXAMPLES.get(name))
