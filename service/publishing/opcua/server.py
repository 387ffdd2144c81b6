"""The OPC UA server of the publisher process."""

import asyncio
import logging
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import asyncua
from asyncua.crypto.permission_rules import SimpleRoleRuleset, User, UserRole
from asyncua.server.user_managers import UserManager
from asyncua.ua.uaerrors import UaError
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from service.process.settings import OpcUa
from service.publishing.opcua.nodes import Node, Nodes, ua
from service.publishing.state import FromPublisher, PublishedState

_log = logging.getLogger(__name__)


class OpcUaServer:
    """Runs until `run` is cancelled; a state set while it does not listen is shown later."""

    def __init__(self, settings: OpcUa, machine: str, report: Callable[[FromPublisher], None]) -> None:
        self._settings, self._machine, self._report = settings, machine, report
        self._state: PublishedState | None = None
        self._news = asyncio.Event()

    def state(self, state: PublishedState) -> None:
        """Set the state; it replaces one that is not shown yet."""
        self._state = state
        self._news.set()

    async def run(self) -> None:
        """Run until cancelled; tries again if it cannot listen or a file is invalid."""
        while True:
            try:
                await self._serve()
            except (OSError, ValueError, UaError) as error:
                self._report(FromPublisher(part="opcua", trouble=f"{type(error).__name__}: {error}"))
            await asyncio.sleep(2.0)

    async def _serve(self) -> None:
        settings = self._settings
        trusted = None if settings.trusted is None else trusted_in(settings.trusted)
        server: Any = cast(Any, asyncua).Server(user_manager=Clients(trusted))
        uri = "urn:sweepid:opcua"
        server.name = f"sweepid {self._machine}"
        server.product_uri, server.manufacturer_name = uri, "sweepid"
        server.limits.max_message_size, server.limits.max_chunk_count = 2**20, 64  # bytes and parts of a request
        await server.init()
        policies = ua.SecurityPolicyType
        # None permits requests for endpoints; `Requests` refuses all others of a session that `Clients` did not accept
        allowed = [policies.NoSecurity]
        if trusted is not None:
            allowed += [
                policies.Basic256Sha256_SignAndEncrypt,
                policies.Aes128Sha256RsaOaep_SignAndEncrypt,
                policies.Aes256Sha256RsaPss_SignAndEncrypt,
            ]
        server.set_security_policy(allowed, Requests())
        server.set_identity_tokens([ua.AnonymousIdentityToken])
        if settings.certificate is not None and settings.key is not None:
            certificate = certificate_in(settings.certificate)
            uri = _uri_of(certificate)
            await server.load_certificate(certificate.public_bytes(Encoding.DER), "der")
            await server.load_private_key(settings.key, None, "pem")
        await server.set_application_uri(uri)
        host = f"[{settings.host}]" if ":" in settings.host else settings.host
        server.set_endpoint(f"opc.tcp://{host}:{settings.port}/sweepid")
        server.iserver.max_session_timeout_ms = 5 * 60_000  # of an inactive session
        nodes = await Nodes.added(server)
        await server.start()
        try:
            if trusted is not None:  # no client can use it: not advertised
                none = ua.MessageSecurityMode.None_
                offered = server.iserver.endpoints
                offered[:] = [endpoint for endpoint in offered if endpoint.SecurityMode != none]
            self._report(FromPublisher(part="opcua", port=_port(server)))
            while True:
                self._news.clear()
                if self._state is not None:
                    await nodes.show(self._state)
                await self._news.wait()
        finally:
            with suppress(asyncio.CancelledError):
                await server.stop()


def _uri_of(certificate: x509.Certificate) -> str:
    """The application URI in a certificate; ValueError without one."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        names = None
    uris = [] if names is None else names.get_values_for_type(x509.UniformResourceIdentifier)
    if not uris:
        raise ValueError("the server's certificate has no application URI (subjectAltName URI)")
    return str(uris[0])


def _port(server: Node) -> int:
    if server.bserver is None:
        raise OSError("does not listen")
    return int(server.bserver.port)


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


class Requests(SimpleRoleRuleset):
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
