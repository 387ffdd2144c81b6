"""Settings of the collector that receives traces. Pure."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Self
from urllib.parse import urlsplit

from pydantic import BaseModel, ConfigDict, StringConstraints

from service.model.errors import BadInput
from service.process.settings.identity_provider import is_loopback


class Telemetry(BaseModel):
    """Destination of spans, by OTLP over HTTP (protobuf)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    endpoint: Annotated[str, StringConstraints(pattern=r"^https?://[^/\s?#@]+$")]  # spans go to its /v1/traces
    authority: Path | None = None  # PEM, issuer of its certificate; None: the issuers that this computer trusts

    def checked(self, *, trusted_network: bool) -> Self:
        """With absolute paths. BadInput if the settings are unusable or unsafe."""
        if find_spec("opentelemetry.sdk") is None or find_spec("opentelemetry.exporter.otlp.proto.http") is None:
            raise BadInput("otel", "needs an extra that is not installed: pip install 'sweepid[otel]'")
        parts = urlsplit(self.endpoint)
        if parts.scheme == "http" and not (trusted_network or is_loopback(parts.hostname or "")):
            raise BadInput(
                "otel.endpoint",
                f"{self.endpoint} is not encrypted, and {parts.hostname} is not this computer; use https, or "
                "`trusted_network: true` where something else protects that network",
            )
        if self.authority is not None and not self.authority.is_file():
            raise BadInput("otel.authority", f"{self.authority} is not a file")
        return self if self.authority is None else self.model_copy(update={"authority": self.authority.absolute()})
