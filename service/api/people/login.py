"""A person logs in with name and password, and has a session in this browser from then on."""

from typing import Annotated

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, SecretStr, StringConstraints
from starlette.concurrency import run_in_threadpool

from service.api.dependencies import ApplicationOf
from service.api.people.me import Me, me_of
from service.api.people.password_check import PasswordCheck
from service.api.people.shown import cookie_name
from service.api.people.trail import trail_of
from service.errors import Conflict

router = APIRouter(tags=["people"])


class Credentials(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: Annotated[str, StringConstraints(max_length=100)]
    password: SecretStr


@router.post("/login")
async def log_in(credentials: Credentials, request: Request, response: Response, application: ApplicationOf) -> Me:
    """Sets the cookie of a session. 401 for a wrong name or password, 429 after too many of them.

    409 where the service asks nobody who he is.
    """
    settings = application.settings
    if not settings.login:
        raise Conflict("this service asks nobody who he is: it has the setting `login: false`")
    trail = trail_of(request.scope)
    check: PasswordCheck = request.app.state.password_check
    password = credentials.password.get_secret_value()
    user = await check.user(application.users, credentials.name, password, trail)
    session, token = await run_in_threadpool(application.sessions.open, user, trail.entry("logged in"))
    trail.session, trail.hushed = session.id, True  # the session's own entry is in the audit
    response.set_cookie(
        cookie_name(request.scope),
        token,
        max_age=int(settings.session_longest),
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https" or settings.behind_proxy,
    )
    return me_of(request, application)


class LoggedOut(BaseModel):
    """`session`: the number of the one that is over."""

    session: int


@router.post("/logout")
async def log_out(request: Request, response: Response, application: ApplicationOf) -> LoggedOut:
    """Ends the session that asks. 409 for who has none: keys are revoked by an admin."""
    trail = trail_of(request.scope)
    if trail.session is None:
        raise Conflict(f"{trail.actor} has no session; a key is revoked with `sweepid people revoke-key`")
    await run_in_threadpool(application.sessions.end, trail.session, trail.entry("session ended"))
    response.delete_cookie(cookie_name(request.scope), httponly=True, samesite="strict")
    return LoggedOut(session=trail.session)
