"""Shared parts of the routes: the application, the caller and the intention, a page of a list, the version read."""

import re
from typing import Annotated, Generic, TypeVar

from fastapi import Depends, Header, Path, Query, Request, Response
from pydantic import BaseModel
from starlette.datastructures import Headers
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Receive, Scope, Send

from service.machine.execution.epoch import Intention
from service.model.errors import BadInput
from service.store.documents import LARGEST_ID
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


def who_asks(request: Request, application: Application) -> str:
    """The name of the authenticated caller; "" without login."""
    return audit_trail_of(request.scope).actor if application.settings.login else ""


async def _intention(
    request: Request,
    application: ApplicationOf,
    _shown: Annotated[
        str | None,
        Header(
            alias=EPOCH,
            description="`epoch` of the state that the person saw; default: that of the arrival. 409 `superseded` "
            "if a stop came since",
        ),
    ] = None,
) -> Intention:
    return Intention(epoch_of(request.scope), who_asks(request, application))


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
