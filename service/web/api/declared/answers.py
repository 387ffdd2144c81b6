"""Gives every answer of the OpenAPI document a description and an example.

`examples.json` has one answer per model, as a service gave it; pages and lists are made from it. A model without an
example gets none: a test lists it.
"""

import json
from importlib.resources import files
from typing import Any

Json = dict[str, Any]

_EXAMPLES: Json = json.loads(files("service.web.api.declared").joinpath("examples.json").read_text("utf-8"))
_NO_DESCRIPTION = "Successful Response"  # FastAPI's text for an answer without description
_MODELS = "#/components/schemas/"
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
    of = some.get("items", some).get("$ref", "").removeprefix(_MODELS)
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
