"""The caller, and what his role does not allow: a page shows such commands as disabled, with the reason."""

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from service.store.access.audit_chain import Fact
from service.store.access.permissions import Role, beyond
from service.store.people.users import UserDocument
from service.web.api.dependencies import ApplicationOf
from service.web.api.people.audit_trail import audit_trail_of
from service.web.api.people.credentials import cookie_name
from service.web.application import Application

router = APIRouter(prefix="/me", tags=["people"])


class Me(BaseModel):
    """`login`: whether the service has a login; `session`: the caller has a session and can log out.

    `refused`: the lowest sufficient role, or "scope" and its word, by "METHOD /path" below ``/api/v1``.
    """

    login: bool
    name: str
    role: str
    session: bool
    refused: dict[str, str]


@router.get("")
async def who_asks(request: Request, application: ApplicationOf) -> Me:
    """The caller. Without login every caller is `local`, and nothing is refused."""
    return me_of(request, application)


def me_of(request: Request, application: Application) -> Me:
    """The caller of a request, from its audit trail."""
    trail = audit_trail_of(request.scope)
    role = Role.VIEWER if trail.role is None else trail.role
    return Me(
        login=application.settings.login,
        name=trail.actor,
        role=role.word,
        session=trail.session is not None,
        refused=beyond(role, trail.scopes),
    )


async def begin_session(
    user: UserDocument, request: Request, response: Response, application: Application, **facts: Fact
) -> Me:
    """Opens a session and sets its cookie. `facts`: additional data of its audit entry."""
    trail, settings = audit_trail_of(request.scope), application.settings
    session, token = await run_in_threadpool(application.sessions.open, user, trail.entry("logged in", **facts))
    trail.session, trail.hushed = session.id, True  # the session has its own entry in the audit
    response.set_cookie(
        cookie_name(request.scope),
        token,
        max_age=int(settings.session_longest),
        httponly=True,
        samesite="strict",
        secure=secure(request, application),
    )
    return me_of(request, application)


def secure(request: Request, application: Application) -> bool:
    """Whether browsers may send a cookie through TLS only."""
    return request.url.scheme == "https" or application.settings.behind_proxy
