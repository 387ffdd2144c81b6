"""What routes ask for by `Depends`: parts of the application, caller, intention, a page of a list, the version read.

`Idempotency-Key`: a client that does not know if its POST has arrived sends it again; it is executed once.

The key belongs to method, path and body. The same request gets the first answer again (with
``Idempotency-Replayed: true``). Another request with the same key gets 422, and 409 while the first one still runs
(draft-ietf-httpapi-idempotency-key-header). Answers of failed requests are not stored: nothing was done.
"""

import hashlib
import json
import re
from collections.abc import Callable, Coroutine, Mapping
from typing import Annotated, Any, Generic, TypeVar

from fastapi import Depends, Header, Path, Query, Request, Response
from fastapi.routing import APIRoute
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send

from service import BadInput
from service.jobs.diagnosing import Diagnosing
from service.jobs.experiments import Experiments
from service.jobs.jobs import Batches
from service.jobs.worker import Worker
from service.machine.execution.energising import Approvals, Intention
from service.machine.execution.machine import Machine
from service.machine.execution.runner import Runner
from service.planning.campaigns.stored_results import FleetHistory
from service.process.settings import Settings
from service.store.diagnoses import DiagnosisStore, ModelStore
from service.store.documents import LARGEST_ID
from service.store.files.recordings import RecordingFiles
from service.store.lease_and_latch import IdempotencyKeys
from service.store.people.audit import AuditWriter
from service.store.people.users import SessionStore
from service.store.plant import BatchStore
from service.store.store import Store
from service.web.api.access import audit_trail_of
from service.web.application import Application

EPOCH = "Sweepid-Epoch"
_ARRIVED = "sweepid.epoch"  # in the scope


class Arrival:
    """ASGI middleware."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            application: Application | None = getattr(scope["app"].state, "application", None)
            if application is not None and application.cell is not None:
                scope[_ARRIVED] = application.machine.epochs.given(Headers(scope=scope).get(EPOCH))
        await self._app(scope, receive, send)


def epoch_of(scope: Scope) -> str:
    """Of the arrival; empty without a machine, which nothing can move."""
    return scope.get(_ARRIVED, "")


async def _application(connection: HTTPConnection) -> Application:
    # async: a plain function would wait for a free thread of the pool, and the stop would wait too
    application = connection.app.state.application
    if not isinstance(application, Application):
        raise TypeError("the application runs outside its lifespan")
    return application


ApplicationOf = Annotated[Application, Depends(_application)]
Part = TypeVar("Part")


def _part(of: Callable[[Application], Part]) -> Callable[..., Coroutine[None, None, Part]]:
    """One part of the application; NoMachine where it is of the machine and there is none."""

    async def part(application: ApplicationOf) -> Part:
        return of(application)

    return part


SettingsOf = Annotated[Settings, Depends(_part(lambda application: application.settings))]
StoreOf = Annotated[Store, Depends(_part(lambda application: application.store))]
FilesOf = Annotated[RecordingFiles, Depends(_part(lambda application: application.files))]
DiagnosesOf = Annotated[DiagnosisStore, Depends(_part(lambda application: application.diagnoses))]
ModelsOf = Annotated[ModelStore, Depends(_part(lambda application: application.models))]
BatchesOf = Annotated[BatchStore, Depends(_part(lambda application: application.batches))]
FleetOf = Annotated[FleetHistory, Depends(_part(lambda application: application.fleet_history))]
SessionsOf = Annotated[SessionStore, Depends(_part(lambda application: application.sessions))]
AuditOf = Annotated[AuditWriter, Depends(_part(lambda application: application.audit))]
WorkerOf = Annotated[Worker, Depends(_part(lambda application: application.worker))]
MachineOf = Annotated[Machine, Depends(_part(lambda application: application.machine))]
RunnerOf = Annotated[Runner, Depends(_part(lambda application: application.runner))]
DiagnosingOf = Annotated[Diagnosing, Depends(_part(lambda application: application.own.diagnosing))]
ExperimentsOf = Annotated[Experiments, Depends(_part(lambda application: application.own.experiments))]
ApprovalsOf = Annotated[Approvals, Depends(_part(lambda application: application.own.approvals))]
ReidentifyingOf = Annotated[Batches, Depends(_part(lambda application: application.own.batches))]


async def _caller(request: Request, application: ApplicationOf) -> str:
    return audit_trail_of(request.scope).actor if application.settings.login else ""


CallerOf = Annotated[str, Depends(_caller)]
"""The name of the authenticated caller; "" without login."""


async def _intention(
    request: Request,
    by: CallerOf,
    _shown: Annotated[
        str | None,
        Header(
            alias=EPOCH,
            description="`epoch` of the state that the person saw; default: that of the arrival. 409 `superseded` "
            "if a stop came since",
        ),
    ] = None,
) -> Intention:
    return Intention(epoch_of(request.scope), by)


IntentionOf = Annotated[Intention, Depends(_intention)]


def _if_match(
    if_match: Annotated[str | None, Header(description='ETag of the version the client has read, or "*"')] = None,
) -> int | None:
    if if_match is None or if_match.strip() == "*":
        return None
    tag = if_match.strip()
    if re.fullmatch(r'"[0-9]{1,10}"', tag) is None:
        raise BadInput("header/If-Match", f'{tag!r} is not one strong ETag of this service, e.g. "3", or *')
    return int(tag[1:-1])


IfMatch = Annotated[int | None, Depends(_if_match)]
Id = Annotated[int, Path(ge=1, le=LARGEST_ID)]
After = Annotated[int, Query(ge=0, le=LARGEST_ID, description="the `next` of the page before; 0 for the first page")]
Limit = Annotated[int, Query(ge=1, le=200)]
Item = TypeVar("Item", bound=BaseModel)


class Page(BaseModel, Generic[Item]):
    """Part of a list, oldest first. `next`: the `after` of the following page; null on the last page."""

    items: tuple[Item, ...]
    next: int | None


def page(items: tuple[Item, ...], limit: int, number: str = "id") -> Page[Item]:
    """`number`: the field by which the list is in order."""
    return Page(items=items, next=getattr(items[-1], number) if len(items) == limit else None)


def set_etag(response: Response, version: int) -> None:
    """Set the strong ETag of a resource's version."""
    response.headers["ETag"] = f'"{version}"'


def media(*kinds: str, schema: Mapping[str, str] | None = None) -> dict[int | str, dict[str, Any]]:
    """The answer 200 of a route as the OpenAPI document declares it: of these media types; default: bytes."""
    body = {"schema": schema or {"type": "string", "format": "binary"}}
    return {200: {"content": dict.fromkeys(kinds, body)}}


def download(content: str | bytes, media_type: str, name: str) -> Response:
    """An answer that a browser stores as a file with this name."""
    return Response(content, media_type=media_type, headers={"Content-Disposition": f'attachment; filename="{name}"'})


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
