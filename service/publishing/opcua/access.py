"""Permissions: trusted clients read and subscribe; all others may only request endpoints."""

import logging
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from asyncua.crypto.permission_rules import SimpleRoleRuleset, User, UserRole
from asyncua.server.user_managers import UserManager
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from service.publishing.opcua.library import ua

_log = logging.getLogger(__name__)

_ALLOWED = frozenset(
    ua.NodeId(getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary"))
    for name in (
        "CreateSession",
        "ActivateSession",
        "CloseSession",
        "CloseSecureChannel",
        "FindServers",
        "GetEndpoints",
        "Read",
        "Browse",
        "BrowseNext",
        "TranslateBrowsePathsToNodeIds",
        "CreateSubscription",
        "ModifySubscription",
        "DeleteSubscriptions",
        "SetPublishingMode",
        "CreateMonitoredItems",
        "ModifyMonitoredItems",
        "DeleteMonitoredItems",
        "SetMonitoringMode",
        "Publish",
        "Republish",
    )
)


class ReadOnly(SimpleRoleRuleset):
    """Permitted requests: all others are refused, and all requests of a session that is not activated."""

    def check_validity(self, user: User, action_type_id: object, body: object) -> bool:
        return user.role is UserRole.User and action_type_id in _ALLOWED


class Clients(UserManager):
    """Identifies a client by the certificate of its secure channel; without a list, all clients on this computer."""

    def __init__(self, trusted: Mapping[bytes, x509.Certificate] | None) -> None:
        self._trusted = trusted

    def get_user(
        self, iserver: object, username: str | None = None, password: str | None = None, certificate: Any = None
    ) -> User | None:
        """None rejects the session."""
        if self._trusted is None:
            return User(role=UserRole.User)
        known = self._trusted.get(bytes(certificate)) if certificate else None
        now = datetime.now(UTC)
        if known is None or not known.not_valid_before_utc <= now <= known.not_valid_after_utc:
            return None
        return User(role=UserRole.User, name=known.subject.rfc4514_string())


def trusted_in(folder: Path) -> dict[bytes, x509.Certificate]:
    """The certificates of a folder, by their DER form. OSError if it cannot be read; invalid files are reported."""
    found: dict[bytes, x509.Certificate] = {}
    for path in sorted(folder.iterdir()):
        try:
            certificate = certificate_in(path)
        except ValueError as error:
            _log.error("%s is no certificate and trusts nobody: %s", path, error)
            continue
        found[certificate.public_bytes(Encoding.DER)] = certificate
    return found


def certificate_in(path: Path) -> x509.Certificate:
    """PEM or DER. OSError, ValueError."""
    content = path.read_bytes()
    if b"-----BEGIN" in content:
        return x509.load_pem_x509_certificate(content)
    return x509.load_der_x509_certificate(content)
