"""The Dask scheduler whose workers execute the jobs, and the certificates of mutual TLS. Pure.

A client of a Dask scheduler can run any code on its workers, and the scheduler can return any answer. So beyond this
computer both sides need a certificate of one authority (mutual TLS), and no connection is unencrypted.
"""

import ssl
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from service.model.errors import BadInput
from service.process.settings.identity_provider import is_loopback


@dataclass(frozen=True, slots=True)
class Certificates:
    """PEM files; the key has no password. Every certificate of `authority` is accepted, with any name."""

    authority: Path
    certificate: Path
    key: Path


@dataclass(frozen=True, slots=True)
class Cluster:
    """`scheduler`: its address in Dask's notation; `certificates`: None only on this computer."""

    scheduler: str
    certificates: Certificates | None = None


def cluster_at(scheduler: str, authority: Path | None, certificate: Path | None, key: Path | None) -> Cluster:
    """BadInput for an invalid address, for an unencrypted one beyond this computer, and for certificates that are
    incomplete or cannot be used."""
    parts = urlsplit(scheduler)
    try:
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise BadInput("dask_scheduler", f"{scheduler} is not an address: {error}") from None
    if parts.scheme not in ("tcp", "tls") or not host or port is None or parts.path:
        raise BadInput("dask_scheduler", f"{scheduler} is not of the form tls://HOST:PORT (or tcp://127.0.0.1:PORT)")
    files = {"dask_authority": authority, "dask_certificate": certificate, "dask_key": key}
    if parts.scheme == "tcp":
        if not is_loopback(host):
            raise BadInput(
                "dask_scheduler",
                f"{scheduler} is not encrypted, and {host} is not this computer: anybody on that network could run "
                "code on the workers; use tls:// with `dask_authority`, `dask_certificate` and `dask_key`",
            )
        if given := [name for name, path in files.items() if path is not None]:
            raise BadInput(given[0], f"is set, but {scheduler} is not encrypted; use tls://")
        return Cluster(scheduler)
    if authority is None or certificate is None or key is None:
        missing = next(name for name, path in files.items() if path is None)
        raise BadInput(missing, f"is missing: {scheduler} needs `dask_authority`, `dask_certificate` and `dask_key`")
    found = Certificates(authority.absolute(), certificate.absolute(), key.absolute())
    try:
        context = ssl.create_default_context(cafile=str(found.authority))
        context.load_cert_chain(found.certificate, found.key, password=lambda: "")  # otherwise it asks at the terminal
    except OSError as error:
        shown = ", ".join(map(str, (authority, certificate, key)))
        raise BadInput("dask_certificate", f"{shown} cannot be used: {error.strerror or error}") from None
    return Cluster(scheduler, found)
