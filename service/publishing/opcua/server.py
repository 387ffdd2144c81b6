"""The OPC UA server of the publisher process."""

import asyncio
import logging
from collections.abc import Callable
from contextlib import suppress
from datetime import timedelta

from asyncua.ua.uaerrors import UaError
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from service.process.settings import OpcUa
from service.publishing.opcua.access import Clients, ReadOnly, certificate_in, trusted_in
from service.publishing.opcua.library import Node, UaServer, ua
from service.publishing.opcua.nodes import Nodes
from service.publishing.state import FromPublisher, State

_log = logging.getLogger(__name__)

URI = "urn:sweepid:opcua"
_AGAIN = 2.0  # s between attempts to open the port
_LARGEST = 2**20  # bytes of a request
_SLOWEST = timedelta(minutes=5)  # of an inactive session
_SECURE = [
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
    ua.SecurityPolicyType.Aes128Sha256RsaOaep_SignAndEncrypt,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
]


class Server:
    """Runs until `run` is cancelled; a state set while it does not listen is shown later."""

    def __init__(self, settings: OpcUa, machine: str, report: Callable[[FromPublisher], None]) -> None:
        self._settings, self._machine, self._report = settings, machine, report
        self._state: State | None = None
        self._news = asyncio.Event()

    def state(self, state: State) -> None:
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
            await asyncio.sleep(_AGAIN)

    async def _serve(self) -> None:
        settings = self._settings
        trusted = None if settings.trusted is None else trusted_in(settings.trusted)
        server = UaServer(user_manager=Clients(trusted))
        server.name = f"sweepid {self._machine}"
        server.product_uri, server.manufacturer_name = URI, "sweepid"
        server.limits.max_message_size, server.limits.max_chunk_count = _LARGEST, 64
        await server.init()
        # None permits requests for endpoints; `ReadOnly` refuses all others of a session that `Clients` did not accept
        open_ = [ua.SecurityPolicyType.NoSecurity]
        server.set_security_policy(open_ if trusted is None else [*open_, *_SECURE], ReadOnly())
        server.set_identity_tokens([ua.AnonymousIdentityToken])
        uri = URI
        if settings.certificate is not None and settings.key is not None:
            certificate = certificate_in(settings.certificate)
            uri = _uri_of(certificate)
            await server.load_certificate(certificate.public_bytes(Encoding.DER), "der")
            await server.load_private_key(settings.key, None, "pem")
        await server.set_application_uri(uri)
        host = f"[{settings.host}]" if ":" in settings.host else settings.host
        server.set_endpoint(f"opc.tcp://{host}:{settings.port}/sweepid")
        server.iserver.max_session_timeout_ms = _SLOWEST.total_seconds() * 1000
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
