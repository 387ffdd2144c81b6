"""`Idempotency-Key`: a client that does not know if its POST has arrived sends it again; it is executed once.

The key belongs to method, path and body. The same request gets the first answer again (with
``Idempotency-Replayed: true``). Another request with the same key gets 422, and 409 while the first one still runs
(draft-ietf-httpapi-idempotency-key-header). Answers of failed requests are not stored: nothing was done.
"""

import hashlib
import json
from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.routing import APIRoute
from starlette.concurrency import run_in_threadpool

from service.model.errors import BadInput
from service.store.lease_and_latch import IdempotencyKeys

Handler = Callable[[Request], Coroutine[Any, Any, Response]]

LONGEST_KEY = 255


class IdempotentRoute(APIRoute):
    """A route whose POST requests support `Idempotency-Key`."""

    def __init__(self, path: str, endpoint: Callable[..., Any], **options: Any) -> None:
        parameter = {
            "parameters": [
                {
                    "name": "Idempotency-Key",
                    "in": "header",
                    "required": False,
                    "description": "makes sending the request again safe",
                    "schema": {"type": "string", "minLength": 1, "maxLength": LONGEST_KEY},
                }
            ]
        }
        if "POST" in (options.get("methods") or ()):
            options["openapi_extra"] = parameter | (options.get("openapi_extra") or {})
        super().__init__(path, endpoint, **options)

    def get_route_handler(self) -> Handler:
        handle = super().get_route_handler()

        async def handle_once(request: Request) -> Response:
            key = request.headers.get("idempotency-key")
            if key is None or request.method != "POST":
                return await handle(request)
            if not 1 <= len(key) <= LONGEST_KEY:
                raise BadInput("header/Idempotency-Key", f"is {len(key)} characters long, limit 1 to {LONGEST_KEY}")
            return await _once(request.app.state.application.keys, key, request, handle)

        return handle_once


def head_of(request: Request) -> bytes:
    """The part of a request's fingerprint (SHA-256) before the body."""
    return b"\0".join([request.method.encode(), request.url.path.encode(), b""])


async def _once(keys: IdempotencyKeys, key: str, request: Request, handle: Handler) -> Response:
    read = getattr(request.state, "fingerprint", None)  # of a body that is already in a file
    if read is None:
        read = hashlib.sha256(head_of(request) + await request.body())
    stored = await run_in_threadpool(keys.claim, key, read.hexdigest())
    if stored is not None:
        kept = json.loads(stored.body)
        return Response(kept["content"], stored.status, kept["headers"] | {"Idempotency-Replayed": "true"})
    try:
        response = await handle(request)
    except BaseException:  # also at cancellation: the key must not stay reserved
        await run_in_threadpool(keys.release, key)
        raise
    headers = {
        name: response.headers[name] for name in ("etag", "location", "content-type") if name in response.headers
    }
    content = json.dumps({"headers": headers, "content": bytes(response.body).decode()})
    await run_in_threadpool(keys.answer, key, response.status_code, content)
    return response
