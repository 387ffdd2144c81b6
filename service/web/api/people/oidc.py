"""Login of a person at an identity provider (OpenID Connect, code with PKCE); the session is as after a password.

The provider always redirects the browser to the operator page, never to an address from a request. The page then
sends state and code to the service.
"""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, StringConstraints
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers

from service.model.errors import Conflict
from service.web.api.dependencies import ApplicationOf
from service.web.api.gate import from_own_page
from service.web.api.people.audit_trail import audit_trail_of
from service.web.api.people.credentials import cookie_name
from service.web.api.people.me import Me, begin_session, secure
from service.web.api.people.oidc_login import OidcLogin
from service.web.api.people.provider.tickets import LASTS
from service.web.api.people.refusals import unauthorized
from service.web.api.problem import Refused

router = APIRouter(prefix="/login", tags=["people"])
_Token = Annotated[str, StringConstraints(min_length=1, max_length=4000)]


class LoginWays(BaseModel):
    """`login`: whether the service has a login; `oidc`: the label of the identity provider, null without one."""

    login: bool
    oidc: str | None


class LoginAddress(BaseModel):
    """`url`: where the browser logs in; it then returns to the operator page with `state` and `code`."""

    url: str


class Code(BaseModel):
    model_config = ConfigDict(extra="forbid")
    code: _Token
    state: _Token


@router.get("")
async def login_ways(request: Request, application: ApplicationOf) -> LoginWays:
    """The available ways to log in; needs no login."""
    oidc: OidcLogin | None = request.app.state.oidc
    return LoginWays(login=application.settings.login, oidc=None if oidc is None else oidc.settings.label)


@router.post("/oidc")
async def begin_oidc(request: Request, response: Response, application: ApplicationOf) -> LoginAddress:
    """Start a login at the identity provider, in this browser. 409 if none is set, 503 while it does not answer."""
    oidc, trail = _set(request), audit_trail_of(request.scope)
    trail.hushed = True  # nothing has happened yet
    cookie, url = await oidc.begin(f"{request.url.scheme}://{request.headers['host']}/")
    response.set_cookie(
        f"{cookie_name(request.scope)}-oidc",
        cookie,
        max_age=int(LASTS),
        httponly=True,
        samesite="strict",  # the page sends it after the redirect; the redirect itself does not
        secure=secure(request, application),
    )
    return LoginAddress(url=url)


@router.post("/oidc/code")
async def end_oidc(code: Code, request: Request, response: Response, application: ApplicationOf) -> Me:
    """Takes state and code from the identity provider, and sets the cookie of a session.

    401 for an invalid state or code, 403 for a person without a role here, 429 after too many invalid ones,
    503 while the provider does not answer.
    """
    oidc, trail = _set(request), audit_trail_of(request.scope)
    cookie = f"{cookie_name(request.scope)}-oidc"
    named = await oidc.named(request.cookies.get(cookie, ""), code.state, code.code, trail)
    trail.facts |= {"issuer": named.issuer, "subject": named.subject}
    role = oidc.role(named.groups)
    user = await run_in_threadpool(
        application.external_users.renew, named.issuer, named.subject, named.name, role, trail.entry("login")
    )
    if user is None:
        detail = (
            f"no group of {named.name} at {named.issuer} is assigned to a role: ask the administrator of this service"
        )
        raise Refused(HTTPStatus.FORBIDDEN, "no-role", detail)
    trail.actor, trail.role = user.name, user.role
    if user.trouble:
        raise unauthorized(user.trouble)
    response.delete_cookie(cookie, httponly=True, samesite="strict")
    return await begin_session(user, request, response, application, **trail.facts)


def _set(request: Request) -> OidcLogin:
    """Conflict if no provider is set; Refused for a request that does not come from a page of this service."""
    oidc: OidcLogin | None = request.app.state.oidc
    if oidc is None:
        raise Conflict("no identity provider is configured: set `oidc`")
    if not from_own_page(Headers(scope=request.scope)):
        detail = (
            "request that does not come from a page of this service: programs send a key, as Authorization: Bearer KEY"
        )
        raise Refused(HTTPStatus.FORBIDDEN, "foreign-request", detail)
    return oidc
