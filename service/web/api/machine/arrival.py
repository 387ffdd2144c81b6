"""The outermost layer: notes the epoch in which a request arrives, before it waits for anything.

A client that shows the machine to a person may send `Sweepid-Epoch`, as `GET /stop` and `GET /drives` give it: then the
epoch counts that the person saw.
"""

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Receive, Scope, Send

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
