"""Requests to an OpenID Connect provider: metadata, keys, and an ID token for a code.

No request is sent before the first login with the provider. Needs `sweepid[oidc]`.
"""

import asyncio
import time
from collections.abc import Callable
from typing import TypeVar, cast
from urllib.parse import quote

import httpx
from authlib.oauth2.rfc6749.parameters import (
    prepare_grant_uri,  # pyright: ignore[reportUnknownVariableType]
)
from authlib.oauth2.rfc7636 import (
    create_s256_code_challenge,  # pyright: ignore[reportUnknownVariableType]
)
from joserfc.jwk import KeySetSerialization
from pydantic import BaseModel, JsonValue, ValidationError

from service.model.errors import BadInput, NotNow
from service.process.settings import Address, IdentityProvider, is_loopback
from service.web.api.people.provider.id_token import BadIdToken, Named, named
from service.web.api.people.provider.tickets import Ticket

_PATIENCE = 8.0  # s for all requests of one step
# Authlib has no type information
_grant_uri = cast("Callable[..., str]", prepare_grant_uri)
_challenge = cast("Callable[[str], str]", create_s256_code_challenge)
Model = TypeVar("Model", bound=BaseModel)


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
            async with asyncio.timeout(_PATIENCE), self._client() as client:
                metadata = await self._found(client)
        except (httpx.HTTPError, TimeoutError) as error:
            raise self._silent(error) from None
        asked: dict[str, str] = {
            "client_id": self.settings.client_id,
            "response_type": "code",
            "redirect_uri": ticket.page,
            "scope": " ".join(self.settings.scopes),
            "state": ticket.state,
            "nonce": ticket.nonce,
            "code_challenge": _challenge(ticket.verifier),
            "code_challenge_method": "S256",
        }
        return _grant_uri(metadata.authorization_endpoint, **asked)

    async def named(self, code: str, ticket: Ticket) -> Named:
        """The person to whom the code belongs. ProviderSilent; CodeRefused; BadIdToken."""
        try:
            async with asyncio.timeout(_PATIENCE), self._client() as client:
                metadata = await self._found(client)
                tokens = await self._tokens(client, metadata, code, ticket)
                keys = await self._keys(client, metadata)
        except (httpx.HTTPError, TimeoutError) as error:
            raise self._silent(error) from None
        return named(tokens.id_token, keys, self.settings, ticket.nonce, tokens.access_token, time.time())

    def _client(self) -> httpx.AsyncClient:
        return httpx.AsyncClient(timeout=_PATIENCE, trust_env=self._trust_env)

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

    async def _keys(self, client: httpx.AsyncClient, metadata: _Metadata) -> KeySetSerialization:
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
