"""The application; its OpenAPI document declares problems with the media type that is sent."""

from typing import Any, cast

from fastapi import FastAPI

from service.store.access.permissions import PERMISSIONS, Role
from service.web.api.declared.answers import complete
from service.web.api.problem import MEDIA_TYPE, Problem

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
    """FastAPI declares every model as `application/json`; problems have another media type."""

    def openapi(self) -> dict[str, Any]:
        document = super().openapi()
        document["components"].setdefault("securitySchemes", {}).update(key=_KEY, session=_SESSION)
        for where, path in cast("dict[str, dict[str, Any]]", document["paths"]).items():
            for method, operation in path.items():
                needed = PERMISSIONS.get((method.upper(), where))
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
