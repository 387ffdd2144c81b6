"""Settings of an OpenID Connect provider that identifies people. Pure."""

from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints


def checked_address(address: str) -> str:
    """An https address; http only for this computer. ValueError for any other."""
    parts = urlsplit(address)
    if parts.scheme != "https" and not (parts.scheme == "http" and is_loopback(parts.hostname or "")):
        raise ValueError("is not an https address (http only of this computer, 127.0.0.1, ::1 or localhost)")
    if not parts.hostname or parts.username is not None or parts.query or parts.fragment:
        raise ValueError("is not an address of host and path alone")
    return address


def is_loopback(host: str) -> bool:
    """Whether this name always means the local computer."""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:  # a name may resolve to any address
        return False


Address = Annotated[str, StringConstraints(max_length=500), AfterValidator(checked_address)]
Word = Annotated[str, StringConstraints(min_length=1, max_length=200)]


class IdentityProvider(BaseModel):
    """Settings given by its administrator, and the role of each of its groups."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    issuer: Address  # exactly as in its metadata, which are below .well-known/openid-configuration
    client_id: Word
    client_secret_file: Path | None = None  # None: a public client, protected by PKCE only
    scopes: tuple[Word, ...] = ("openid", "profile")
    name_claim: Word = "preferred_username"  # source of the name of a new person
    groups_claim: Word = "groups"
    roles: dict[Word, Literal["viewer", "operator", "engineer", "admin"]] = Field(min_length=1)  # by group
    label: Annotated[str, StringConstraints(min_length=1, max_length=60)] = "Log in with the company's account"
    page: Address | None = None  # address of the operator page in browsers, registered there; None: on this computer
