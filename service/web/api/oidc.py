"""Login of a person at an identity provider (OpenID Connect, code with PKCE); the session is as after a password.

The provider always redirects the browser to the operator page, never to an address from a request. The page then
sends state and code to the service. Needs `sweepid[oidc]`: Authlib, which makes the checks of the ID token (OpenID
Connect Core 1.0, 3.1.3.7), is imported at the first login. No request is sent to the provider before.
"""

import asyncio
import secrets
import time
from collections import OrderedDict
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from http import HTTPStatus
from importlib.util import find_spec
from typing import TYPE_CHECKING, Annotated, TypeVar, cast
from urllib.parse import quote

import httpx
from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, JsonValue, StringConstraints, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers

from service import BadInput, Conflict, NotNow, SweepidError
from service.process.settings import Address, IdentityProvider, is_loopback
from service.store.access import Role, is_name, unique_name
from service.web.api.access import AuditTrail, Guesses, audit_trail_of, cookie_name, too_many, unauthorized
from service.web.api.dependencies import ApplicationOf, SettingsOf
from service.web.api.gate import from_own_page
from service.web.api.login import Me, begin_session, secure
from service.web.api.problem import RequestRefused
from service.web.api.route_roles import allow

if TYPE_CHECKING:  # optional: only an installation with an identity provider has it
    from joserfc.jwk import KeySetSerialization

_LASTS = 600.0  # s to log in at the provider
_PROVIDER_PATIENCE = 8.0  # s for all requests of one step


@dataclass(frozen=True)
class Ticket:
    """`state` returns with the code, `nonce` in the ID token; `verifier` (PKCE, RFC 7636) proves who started the login.

    `page`: the page to which the browser returns. `ends`: s, monotonic.
    """

    state: str
    nonce: str
    verifier: str
    page: str
    ends: float


class Tickets:
    """By the value of the browser's cookie. A time `now` is in s and monotonic."""

    def __init__(self) -> None:
        self._open: OrderedDict[str, Ticket] = OrderedDict()

    def issue(self, page: str, now: float) -> tuple[str, Ticket]:
        """The value of the cookie, and the ticket."""
        cookie, state, nonce, verifier = (secrets.token_urlsafe(32) for _ in range(4))
        ticket = self._open[cookie] = Ticket(state, nonce, verifier, page, now + _LASTS)
        if len(self._open) > 1000:  # logins in progress; the oldest is removed first
            self._open.popitem(last=False)
        return cookie, ticket

    def take(self, cookie: str, state: str, now: float) -> Ticket | None:
        """The ticket of this browser; None if it has expired or `state` is wrong. The ticket is always removed."""
        ticket = self._open.pop(cookie, None)
        if ticket is None or now >= ticket.ends:
            return None
        return ticket if secrets.compare_digest(ticket.state.encode(), state.encode()) else None


Model = TypeVar("Model", bound=BaseModel)


class BadIdToken(SweepidError):
    """The identity provider's answer does not identify a person: it is forged, expired, or for another client."""


@dataclass(frozen=True)
class Named:
    """The person that the provider names. `issuer` and `subject` never change; `name` is for display."""

    issuer: str
    subject: str
    name: str
    groups: tuple[str, ...]


def named(
    token: str, keys: "KeySetSerialization", settings: IdentityProvider, nonce: str, access_token: str, now: float
) -> Named:
    """The person that the ID token names. `keys`: the provider's JWK set; `now`: s since 1970. BadIdToken."""
    from authlib.oidc.core import CodeIDToken
    from joserfc import jwt
    from joserfc.errors import JoseError
    from joserfc.jwk import KeySet

    # signatures with a private key of the provider; `none` and signatures with a shared secret are not allowed
    signatures = [f"{kind}{bits}" for kind in ("RS", "PS", "ES") for bits in (256, 384, 512)]
    try:
        signed = jwt.decode(token, KeySet.import_key_set(keys), algorithms=signatures)
        claims = CodeIDToken(
            signed.claims,
            signed.header,
            {
                "iss": {"essential": True, "value": settings.issuer},
                "aud": {"essential": True, "value": settings.client_id},
            },
            {"client_id": settings.client_id, "nonce": nonce, "access_token": access_token},
        )
        claims.validate(now=int(now), leeway=60)  # pyright: ignore[reportUnknownMemberType]  # s, between the clocks
    except (JoseError, ValueError, TypeError, KeyError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise BadIdToken(f"the ID token of {settings.issuer} is not valid: {reason[:200]}") from None
    facts: dict[str, object] = dict(signed.claims)
    subject = facts["sub"]
    if not isinstance(subject, str) or not 1 <= len(subject) <= 255:
        raise BadIdToken(f"the ID token of {settings.issuer} is not valid: sub is no text of 1 to 255 characters")
    claimed = facts.get(settings.name_claim)
    name = claimed.strip() if isinstance(claimed, str) else ""
    return Named(
        settings.issuer,
        subject,
        name if is_name(name) else unique_name("person", subject),
        _texts(facts.get(settings.groups_claim)),
    )


def _texts(value: object) -> tuple[str, ...]:
    """Some providers send a single group as a text."""
    given: list[object] = [value] if isinstance(value, str) else list(value) if isinstance(value, list) else []  # pyright: ignore[reportUnknownArgumentType]
    return tuple(one for one in given if isinstance(one, str))


class ProviderSilent(NotNow):
    """The identity provider gives no valid answer; login with passwords and keys still works."""


class CodeRefused(BadIdToken):
    """The identity provider refuses the code: it was used before, has expired, or belongs to another client."""


class _Metadata(BaseModel):
    """OpenID Connect Discovery 1.0, 3."""

    issuer: str
    authorization_endpoint: Address
    token_endpoint: Address
    jwks_uri: Address
    token_endpoint_auth_methods_supported: tuple[str, ...] = ("client_secret_basic",)


class _Tokens(BaseModel):
    id_token: str
    access_token: str = ""


class _Keys(BaseModel):
    keys: list[dict[str, JsonValue]]


class _OAuthError(BaseModel):
    error: str = "without a word"


class Exchange:
    """One provider."""

    def __init__(self, settings: IdentityProvider) -> None:
        """BadInput if the file of the secret cannot be used."""
        self.settings = settings
        self._secret = _secret(settings)
        self._metadata: _Metadata | None = None
        # no proxy from the environment for a loopback address
        self._trust_env = not is_loopback(httpx.URL(settings.issuer).host)

    async def address(self, ticket: Ticket) -> str:
        """The address where the browser logs in. ProviderSilent."""
        try:
            async with asyncio.timeout(_PROVIDER_PATIENCE), self._client() as client:
                metadata = await self._found(client)
        except (httpx.HTTPError, TimeoutError) as error:
            raise self._silent(error) from None
        from authlib.oauth2.rfc7636 import create_s256_code_challenge  # pyright: ignore[reportUnknownVariableType]

        asked = {
            "client_id": self.settings.client_id,
            "response_type": "code",
            "redirect_uri": ticket.page,
            "scope": " ".join(self.settings.scopes),
            "state": ticket.state,
            "nonce": ticket.nonce,
            "code_challenge": cast("str", create_s256_code_challenge(ticket.verifier)),
            "code_challenge_method": "S256",
        }
        return str(httpx.URL(metadata.authorization_endpoint).copy_merge_params(asked))

    async def named(self, code: str, ticket: Ticket) -> Named:
        """The person to whom the code belongs. ProviderSilent; CodeRefused; BadIdToken."""
        try:
            async with asyncio.timeout(_PROVIDER_PATIENCE), self._client() as client:
                metadata = await self._found(client)
                tokens = await self._tokens(client, metadata, code, ticket)
                keys = await self._keys(client, metadata)
        except (httpx.HTTPError, TimeoutError) as error:
            raise self._silent(error) from None
        return named(tokens.id_token, keys, self.settings, ticket.nonce, tokens.access_token, time.time())

    def _client(self) -> httpx.AsyncClient:
        return httpx.AsyncClient(timeout=_PROVIDER_PATIENCE, trust_env=self._trust_env)

    async def _found(self, client: httpx.AsyncClient) -> _Metadata:
        """Requested once while the service runs."""
        if self._metadata is None:
            address = f"{self.settings.issuer.rstrip('/')}/.well-known/openid-configuration"
            metadata = self._read(await client.get(address), _Metadata)
            if metadata.issuer != self.settings.issuer:
                raise ProviderSilent(
                    f"the identity provider at {self.settings.issuer} reports the issuer "
                    f"{metadata.issuer[:200]!r}: correct the setting `oidc.issuer` if this is the "
                    "right provider; login by password still works"
                )
            self._metadata = metadata
        return self._metadata

    async def _tokens(self, client: httpx.AsyncClient, metadata: _Metadata, code: str, ticket: Ticket) -> _Tokens:
        form = {
            "grant_type": "authorization_code",
            "code": code,
            "redirect_uri": ticket.page,
            "code_verifier": ticket.verifier,
            "client_id": self.settings.client_id,
        }
        basic = httpx.USE_CLIENT_DEFAULT
        if self._secret and "client_secret_basic" in metadata.token_endpoint_auth_methods_supported:
            basic = httpx.BasicAuth(quote(self.settings.client_id, safe=""), quote(self._secret, safe=""))
        elif self._secret:
            form["client_secret"] = self._secret
        answer = await client.post(metadata.token_endpoint, data=form, auth=basic)
        if answer.is_client_error:
            word = self._read(answer, _OAuthError, checked=False).error
            if word == "invalid_client":
                raise self._silent(
                    "it does not know the client of the settings `oidc.client_id` and `client_secret_file`"
                )
            raise CodeRefused(f"{self.settings.issuer} returned no token for the code: {word[:100]!r}; log in again")
        return self._read(answer, _Tokens)

    async def _keys(self, client: httpx.AsyncClient, metadata: _Metadata) -> "KeySetSerialization":
        """Requested for each login: providers change their keys."""
        found = self._read(await client.get(metadata.jwks_uri), _Keys)
        return cast("KeySetSerialization", found.model_dump())

    def _read(self, answer: httpx.Response, kind: type[Model], checked: bool = True) -> Model:
        try:
            return kind.model_validate_json((answer.raise_for_status() if checked else answer).content)
        except ValidationError as error:
            first = error.errors(include_input=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            raise self._silent(f"{answer.request.url.path}: {where} {first['msg']}") from None

    def _silent(self, why: Exception | str) -> ProviderSilent:
        reason = why if isinstance(why, str) else f"{type(why).__name__} {why}".strip()
        return ProviderSilent(
            f"the identity provider {self.settings.issuer} does not answer correctly ({reason[:300]}): "
            "log in with a password or a key, or check that it is reachable from this computer and "
            "try again"
        )


def _secret(settings: IdentityProvider) -> str:
    path = settings.client_secret_file
    if path is None:
        return ""
    try:
        secret = path.read_text("utf-8").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput("oidc.client_secret_file", f"{path} cannot be read: {error}") from None
    if not secret:
        raise BadInput("oidc.client_secret_file", f"{path} is empty")
    return secret


class OidcLogin:
    """Counts invalid states and codes together with the wrong keys and passwords of an address."""

    def __init__(self, exchange: Exchange, guesses: Guesses) -> None:
        self.settings = exchange.settings
        self._exchange, self._guesses = exchange, guesses
        self._tickets = Tickets()
        self._waiting = 0

    def page(self, own: str) -> str:
        """The page to which browsers return. `own`: address of this request. Conflict if another page is configured."""
        if self.settings.page is None or self.settings.page.rstrip("/") == own.rstrip("/"):
            return self.settings.page or own
        raise Conflict(
            f"the identity provider redirects to {self.settings.page}: open the operator page at that address"
        )

    async def begin(self, own: str) -> tuple[str, str]:
        """The value of the cookie, and the address where the browser logs in. ProviderSilent; Conflict."""
        cookie, ticket = self._tickets.issue(self.page(own), time.monotonic())
        with self._place():
            return cookie, await self._exchange.address(ticket)

    async def named(self, cookie: str, state: str, code: str, trail: AuditTrail) -> Named:
        """The person of the provider. RequestRefused: 401 for invalid input, 429 for too many. ProviderSilent."""
        self._guesses.check(trail.address, None, f"wrong keys, passwords and codes from {trail.address}", trail)
        ticket = self._tickets.take(cookie, state, time.monotonic())
        if ticket is None:
            raise self._wrong("unknown or expired login state in this browser: start the login again", trail)
        try:
            with self._place():
                return await self._exchange.named(code, ticket)
        except BadIdToken as error:
            raise self._wrong(str(error), trail) from None

    def role(self, groups: tuple[str, ...]) -> Role | None:
        """The highest role of these groups here; None without one."""
        roles = self.settings.roles
        return max((Role[roles[one].upper()] for one in groups if one in roles), default=None)

    @contextmanager
    def _place(self) -> Generator[None]:
        """One of the few places of requests that may wait for the provider at once. RequestRefused if there is none."""
        if self._waiting >= 8:
            raise too_many("logins at the identity provider", 1.0)
        self._waiting += 1
        try:
            yield
        finally:
            self._waiting -= 1

    def _wrong(self, detail: str, trail: AuditTrail) -> RequestRefused:
        self._guesses.wrong(trail.address, time.monotonic())
        return unauthorized(detail)


def open_oidc(settings: IdentityProvider | None, guesses: Guesses) -> OidcLogin | None:
    """None if no provider is set. BadInput if the extra or the file of the secret is missing."""
    if settings is None:
        return None
    if find_spec("authlib") is None:
        raise BadInput("oidc", "requires sweepid[oidc], which is not installed")
    return OidcLogin(Exchange(settings), guesses)


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
@allow(None)
async def login_ways(request: Request, settings: SettingsOf) -> LoginWays:
    """The available ways to log in; needs no login."""
    oidc: OidcLogin | None = request.app.state.oidc
    return LoginWays(login=settings.login, oidc=None if oidc is None else oidc.settings.label)


@router.post("/oidc")
@allow(None)
async def begin_oidc(request: Request, response: Response, application: ApplicationOf) -> LoginAddress:
    """Start a login at the identity provider, in this browser. 409 if none is set, 503 while it does not answer."""
    oidc, trail = _set(request), audit_trail_of(request.scope)
    trail.hushed = True  # nothing has happened yet
    cookie, url = await oidc.begin(f"{request.url.scheme}://{request.headers['host']}/")
    response.set_cookie(
        f"{cookie_name(request.scope)}-oidc",
        cookie,
        max_age=int(_LASTS),
        httponly=True,
        samesite="strict",  # the page sends it after the redirect; the redirect itself does not
        secure=secure(request, application),
    )
    return LoginAddress(url=url)


@router.post("/oidc/code")
@allow(None)
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
        raise RequestRefused(HTTPStatus.FORBIDDEN, "no-role", detail)
    trail.actor, trail.role = user.name, user.role
    if user.trouble:
        raise unauthorized(user.trouble)
    response.delete_cookie(cookie, httponly=True, samesite="strict")
    return await begin_session(user, request, response, application, **trail.facts)


def _set(request: Request) -> OidcLogin:
    """Conflict if no provider is set; RequestRefused for a request that does not come from a page of this service."""
    oidc: OidcLogin | None = request.app.state.oidc
    if oidc is None:
        raise Conflict("no identity provider is configured: set `oidc`")
    if not from_own_page(Headers(scope=request.scope)):
        detail = (
            "request that does not come from a page of this service: programs send a key, as Authorization: Bearer KEY"
        )
        raise RequestRefused(HTTPStatus.FORBIDDEN, "foreign-request", detail)
    return oidc
