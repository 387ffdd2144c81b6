"""A service without a machine (`--no-machine`) is read-only: it refuses all other requests before it reads them."""

from http import HTTPStatus

from starlette.requests import Request
from starlette.types import ASGIApp, Receive, Scope, Send

from service.store.access.permissions import API, LOGINS, STOP
from service.store.rows import NoMachine
from service.web.api.people.audit_trail import audit_trail_of
from service.web.api.problem import problem_response

_ALLOWED = (STOP, *LOGINS, ("POST", f"{API}/logout"))  # the route of the stop answers a stop itself: 503, no machine


class ReadOnly:
    """ASGI middleware inside `Access`: callers without permission get that answer first. The audit has the refusal."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            trail = audit_trail_of(scope)
            if trail.changes and trail.route is not None and trail.route not in _ALLOWED:
                refusal = problem_response(Request(scope), HTTPStatus.CONFLICT, "no-machine", str(NoMachine()))
                await refusal(scope, receive, send)
                return
        await self._app(scope, receive, send)
