"""Login of a person with name and password; afterwards this browser has a session."""

from typing import Annotated

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, SecretStr, StringConstraints
from starlette.concurrency import run_in_threadpool

from service.model.errors import Conflict
from service.web.api.dependencies import ApplicationOf
from service.web.api.people.audit_trail import audit_trail_of
from service.web.api.people.credentials import cookie_name
from service.web.api.people.me import Me, begin_session
from service.web.api.people.password_check import PasswordCheck

router = APIRouter(tags=["people"])


class Credentials(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: Annotated[str, StringConstraints(max_length=100)]
    password: SecretStr


@router.post("/login")
async def log_in(credentials: Credentials, request: Request, response: Response, application: ApplicationOf) -> Me:
    """Sets the cookie of a session. 401 for a wrong name or password, 429 after too many wrong ones.

    409 if the service has no login.
    """
    settings = application.settings
    if not settings.login:
        raise Conflict("login is disabled: the service runs with the setting `login: false`")
    trail = audit_trail_of(request.scope)
    check: PasswordCheck = request.app.state.password_check
    password = credentials.password.get_secret_value()
    user = await check.user(application.users, credentials.name, password, trail)
    return await begin_session(user, request, response, application)


class LoggedOut(BaseModel):
    """`session`: number of the closed session."""

    session: int


@router.post("/logout")
async def log_out(request: Request, response: Response, application: ApplicationOf) -> LoggedOut:
    """Closes the session of the caller. 409 for a caller without session: an admin revokes keys."""
    trail = audit_trail_of(request.scope)
    if trail.session is None:
        raise Conflict(f"{trail.actor} uses a key, not a session; revoke the key with `sweepid people revoke-key`")
    await run_in_threadpool(application.sessions.end, trail.session, trail.entry("session ended"))
    response.delete_cookie(cookie_name(request.scope), httponly=True, samesite="strict")
    return LoggedOut(session=trail.session)
