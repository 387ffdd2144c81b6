"""Every error as `application/problem+json` (RFC 9457).

`errors` lists the errors of the input, one entry per field: `pointer` (RFC 6901 into the body as ``#/...``, or
``query/NAME``, ``path/NAME``, ``header/NAME``), `reason`, and, if known, the given `value` and the `limit`.
"""

import json
import math
from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import cast

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from pydantic import BaseModel
from pydantic_core import ErrorDetails
from starlette.exceptions import HTTPException
from starlette.routing import Match

from drivers.errors import CommunicationLost, ConnectionFailed, DriveError, NotReady
from service import BadInput, Conflict, EnvelopeViolation, NoPdf, NotFound, NotNow, SweepidError
from service.planning.machine_setup import NeedsConfirmation
from service.store.lease_and_latch import KeyReused
from service.store.people.audit import AuditUnreadable, NotAudited
from service.store.store import StaleVersion

MEDIA_TYPE = "application/problem+json"
TAG = "kind:"  # prefix of the tags of a body of several kinds: a tag is no field of the body

AGAIN = {"Retry-After": "5"}  # s, for a request that can be repeated unchanged
_LONGEST_VALUE = 200


class RequestRefused(Exception):
    """Becomes the problem `name` with these headers."""

    def __init__(self, status: HTTPStatus, name: str, detail: str, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.status, self.name, self.detail, self.headers = status, name, detail, headers

    def response(self, request: Request) -> Response:
        return problem_response(request, self.status, self.name, self.detail, headers=self.headers)


class FieldProblem(BaseModel):
    """What is wrong with one field."""

    pointer: str
    reason: str
    value: str | float | int | bool | None = None
    limit: str | float | int | None = None


class Problem(BaseModel):
    """RFC 9457 problem details; `type` is ``urn:sweepid:problem:NAME`` with the name of the error."""

    type: str
    title: str
    status: int
    detail: str
    instance: str
    errors: tuple[FieldProblem, ...] = ()
    sent: tuple[str, ...] | None = None  # for a stop: the axes to which it was sent
    confirmed: tuple[str, ...] | None = None  # for a stop: the axes at standstill
    confirm: dict[str, str] | None = None  # for a plan of another robot or cell: what a person has to type
    unconfirmed: dict[str, str] | None = None  # for a stop: the reason for each axis without confirmation


def problem_response(
    request: Request,
    status: HTTPStatus,
    name: str,
    detail: str,
    errors: Sequence[FieldProblem] = (),
    headers: Mapping[str, str] | None = None,
    additional: Mapping[str, object] | None = None,
) -> Response:
    """The response of one problem; `additional`: its additional members."""
    members = {
        "type": f"urn:sweepid:problem:{name}",
        "title": status.phrase,
        "status": status.value,
        "detail": _cut(detail, 2000),
        "instance": _cut(request.url.path, 2000),
        "errors": tuple(errors),
    }
    problem = Problem.model_validate(members | dict(additional or {}))
    content = problem.model_dump_json(exclude_none=True)
    return Response(content, status.value, headers, media_type=MEDIA_TYPE)


def install_problem_handlers(app: FastAPI) -> None:
    """Convert every exception of a route into a problem."""
    app.add_exception_handler(SweepidError, _on_known_error)
    app.add_exception_handler(DriveError, _on_known_error)
    app.add_exception_handler(RequestRefused, _on_refused)
    app.add_exception_handler(RequestValidationError, _on_invalid_request)
    app.add_exception_handler(HTTPException, _on_http_error)
    app.add_exception_handler(Exception, _on_unknown_error)


def _on_known_error(request: Request, error: Exception) -> Response:
    # From the special to the general; the first match is used.
    statuses = (
        (BadInput, HTTPStatus.UNPROCESSABLE_ENTITY),
        (EnvelopeViolation, HTTPStatus.UNPROCESSABLE_ENTITY),
        (KeyReused, HTTPStatus.UNPROCESSABLE_ENTITY),
        (NotFound, HTTPStatus.NOT_FOUND),
        (StaleVersion, HTTPStatus.PRECONDITION_FAILED),
        (Conflict, HTTPStatus.CONFLICT),
        (ConnectionFailed, HTTPStatus.SERVICE_UNAVAILABLE),
        (CommunicationLost, HTTPStatus.SERVICE_UNAVAILABLE),
        (NotReady, HTTPStatus.SERVICE_UNAVAILABLE),
        (NotNow, HTTPStatus.SERVICE_UNAVAILABLE),
        (NotAudited, HTTPStatus.SERVICE_UNAVAILABLE),
        (AuditUnreadable, HTTPStatus.SERVICE_UNAVAILABLE),
        (DriveError, HTTPStatus.BAD_GATEWAY),
        (NoPdf, HTTPStatus.NOT_IMPLEMENTED),
    )
    status = next((status for kind, status in statuses if isinstance(error, kind)), HTTPStatus.INTERNAL_SERVER_ERROR)
    errors = (FieldProblem(pointer=error.place, reason=error.reason),) if isinstance(error, BadInput) else ()
    headers = AGAIN if isinstance(error, NotNow | NotAudited) else None
    additional = {"confirm": error.confirm} if isinstance(error, NeedsConfirmation) else None
    return problem_response(request, status, _kebab(type(error).__name__), str(error), errors, headers, additional)


def _on_refused(request: Request, error: Exception) -> Response:
    if not isinstance(error, RequestRefused):
        raise error
    return error.response(request)


def _on_invalid_request(request: Request, error: Exception) -> Response:
    details: Sequence[ErrorDetails] = error.errors() if isinstance(error, RequestValidationError) else ()
    # no input of a login is returned: any field may contain a password
    returned, most = "/login" not in request.url.path, 8  # the size of an answer must not grow with the input
    errors = tuple(_field_problem(detail, returned) for detail in details[:most])
    first = errors[0]
    given = "" if first.value is None else f" (given: {first.value})"
    more = f"; {len(details)} errors, the first {most} are listed" if len(details) > most else ""
    return problem_response(
        request, HTTPStatus.UNPROCESSABLE_ENTITY, "bad-input", f"{first.pointer}: {first.reason}{given}{more}", errors
    )


def _on_http_error(request: Request, error: Exception) -> Response:
    if not isinstance(error, HTTPException):
        raise error
    status = HTTPStatus(error.status_code)
    name = status.name.lower().replace("_", "-")
    headers = error.headers
    if status is HTTPStatus.METHOD_NOT_ALLOWED:
        headers = {"Allow": ", ".join(_methods_of(request))}
    return problem_response(request, status, name, error.detail, (), headers)


def _methods_of(request: Request) -> list[str]:
    """All methods of the path. The error knows those of one route only, and each of our routes has one method."""
    routes = cast("FastAPI", request.app).routes
    scopes = {
        method: {**request.scope, "method": method}
        for method in ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS")
    }
    return [name for name, scope in scopes.items() if any(r.matches(scope)[0] is Match.FULL for r in routes)]


def _on_unknown_error(request: Request, error: Exception) -> Response:
    # the text of an unexpected error may contain anything; it is logged and not sent to the client
    status = HTTPStatus.INTERNAL_SERVER_ERROR
    return problem_response(request, status, "internal-error", f"{type(error).__name__}; see the service's log")


def _field_problem(detail: ErrorDetails, returned: bool) -> FieldProblem:
    """`returned`: the given value may be returned."""
    where, *path = detail["loc"] or ("body",)
    path = [part for part in path if not str(part).startswith(TAG)]
    escaped = [str(part).replace("~", "~0").replace("/", "~1") for part in path]
    pointer = "#" + "".join(f"/{part}" for part in escaped) if where == "body" else "/".join([str(where), *escaped])
    context = detail.get("ctx", {})
    limits = ("gt", "ge", "lt", "le", "min_length", "max_length", "expected", "multiple_of")
    limit = next((context[name] for name in limits if name in context), None)
    if not isinstance(limit, int | float | None):
        limit = _cut(str(limit), _LONGEST_VALUE)
    return FieldProblem(
        pointer=_cut(pointer, _LONGEST_VALUE),
        reason=_cut(detail["msg"], _LONGEST_VALUE),
        value=_shown(detail["input"]) if returned else None,
        limit=limit,
    )


def _shown(value: object) -> str | float | int | bool | None:
    """The given value, shortened to the part that helps a person."""
    if value is None or isinstance(value, bool) or (isinstance(value, int) and value.bit_length() <= 64):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else str(value)
    text = value if isinstance(value, str) else json.dumps(value, default=str)
    return _cut(text, _LONGEST_VALUE)


def _cut(text: str, longest: int) -> str:
    return _printable(text if len(text) <= longest else f"{text[:longest]}...")


def _printable(text: str) -> str:
    """Printable text: JSON may escape half a surrogate pair, which no answer can contain."""
    return text.encode("utf-8", "backslashreplace").decode()


def _kebab(name: str) -> str:
    return "".join(f"-{letter.lower()}" if letter.isupper() else letter for letter in name).lstrip("-")
