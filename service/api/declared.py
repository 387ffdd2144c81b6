"""The application whose OpenAPI document says of problems what is sent."""

from typing import Any, cast

from fastapi import FastAPI

from service.api.problem import MEDIA_TYPE, Problem
from service.people.permissions import PERMISSIONS, Role

_PROBLEM = {"$ref": f"#/components/schemas/{Problem.__name__}"}

_KEY = {
    "type": "http",
    "scheme": "bearer",
    "description": "an API key, where the service has the setting `login: true`",
}


_SESSION = {
    "type": "apiKey",
    "in": "cookie",
    "name": "sweepid-8642",
    "description": "a session, which POST /login opens; its cookie bears the number of the port",
}


class DeclaredApi(FastAPI):
    """FastAPI declares every model as `application/json`; problems are sent as something else."""

    def openapi(self) -> dict[str, Any]:
        document = super().openapi()
        document["components"].setdefault("securitySchemes", {}).update(key=_KEY, session=_SESSION)
        for where, path in cast("dict[str, dict[str, Any]]", document["paths"]).items():
            for method, operation in path.items():
                needed = PERMISSIONS.get((method.upper(), where))
                if needed is not None:
                    operation["security"] = [{}, {"key": []}, {"session": []}]  # none where the service has no login
                    operation["x-least-role"] = needed.word
                    operation["responses"] |= _refusals(needed)
                for response in operation["responses"].values():
                    content = cast("dict[str, Any]", response.get("content", {}))
                    for media in [name for name, body in content.items() if body.get("schema") == _PROBLEM]:
                        content[MEDIA_TYPE] = content.pop(media)
        return document


def _refusals(needed: Role) -> dict[str, Any]:
    content = {MEDIA_TYPE: {"schema": _PROBLEM}}
    asked = {"WWW-Authenticate": {"schema": {"type": "string"}}}
    return {
        "401": {"description": "no key, or none that opens anything", "headers": asked, "content": content},
        "403": {"description": f"needs {needed.word}, or was sent by another page", "content": content},
    }
