"""Refusals of authentication."""

import math
from http import HTTPStatus

from service.web.api.people.rate_limit import WINDOW
from service.web.api.problem import Refused

_CHALLENGE = {"WWW-Authenticate": 'Bearer realm="sweepid"'}


def unauthorized(detail: str) -> Refused:
    return Refused(HTTPStatus.UNAUTHORIZED, "unauthorized", detail, _CHALLENGE)


def too_many(what: str, wait: float) -> Refused:
    """`wait`: s until the next attempt is checked."""
    seconds = math.ceil(wait)
    detail = f"too many {what} within {WINDOW:g} s: wait {seconds} s. STOP works without a login"
    return Refused(HTTPStatus.TOO_MANY_REQUESTS, "too-many-wrong-keys", detail, {"Retry-After": str(seconds)})
