"""The ID token of an identity provider: the person, if all checks pass (OpenID Connect Core 1.0, 3.1.3.7). Pure.

Authlib makes the checks; this module defines the required content. Needs `sweepid[oidc]`.
"""

from dataclasses import dataclass

from authlib.oidc.core import CodeIDToken
from joserfc import jwt
from joserfc.errors import JoseError
from joserfc.jwk import KeySet, KeySetSerialization

from service.model.errors import SweepidError
from service.process.settings.identity_provider import IdentityProvider
from service.store.access.credentials import is_name, unique_name

# Signatures with a private key of the provider. `none` and signatures with a shared secret are not allowed.
SIGNATURES = ["RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512"]
LEEWAY = 60  # s, allowed difference between the clocks of provider and service
_LONGEST_SUBJECT = 255


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
    token: str, keys: KeySetSerialization, settings: IdentityProvider, nonce: str, access_token: str, now: float
) -> Named:
    """`keys`: the provider's JWK set; `now`: s since 1970. BadIdToken."""
    try:
        signed = jwt.decode(token, KeySet.import_key_set(keys), algorithms=SIGNATURES)
        claims = CodeIDToken(
            signed.claims,
            signed.header,
            {
                "iss": {"essential": True, "value": settings.issuer},
                "aud": {"essential": True, "value": settings.client_id},
            },
            {"client_id": settings.client_id, "nonce": nonce, "access_token": access_token},
        )
        claims.validate(now=int(now), leeway=LEEWAY)  # pyright: ignore[reportUnknownMemberType]
    except (JoseError, ValueError, TypeError, KeyError) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise BadIdToken(f"the ID token of {settings.issuer} is not valid: {reason[:200]}") from None
    facts: dict[str, object] = dict(signed.claims)
    subject = facts["sub"]
    if not isinstance(subject, str) or not 1 <= len(subject) <= _LONGEST_SUBJECT:
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
