"""Settings of the data for other systems: an OPC UA server, and an MQTT broker. Pure."""

from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from service.model.errors import BadInput
from service.process.settings.identity_provider import is_loopback

Host = Annotated[str, StringConstraints(min_length=1, max_length=253)]
TopicPrefix = Annotated[str, StringConstraints(pattern=r"^[^/+#$\x00][^+#\x00]{0,199}$")]


class _Published(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class OpcUa(_Published):
    """The server: clients can read and subscribe, but not write."""

    host: Host = "127.0.0.1"
    port: int = Field(default=4840, ge=0, le=65535)  # 0: any free port
    certificate: Path | None = None  # PEM or DER, of this server; contains its application URI
    key: Path | None = None  # PEM, without a password
    trusted: Path | None = None  # folder with the certificates of the clients that may read (PEM or DER)

    def checked(self) -> Self:
        """With absolute paths. BadInput if the settings are unusable or unsafe."""
        _installed("opcua", "asyncua")
        files = {"certificate": self.certificate, "key": self.key, "trusted": self.trusted}
        given = [name for name, path in files.items() if path is not None]
        if not given and not is_loopback(self.host):
            raise BadInput(
                "opcua.host",
                f"{self.host!r} is not this computer alone, and without certificates everybody on that network could "
                "read; set `certificate`, `key` and `trusted`",
            )
        missing = [name for name in files if name not in given]
        if given and missing:
            raise BadInput(f"opcua.{missing[0]}", "is missing: OPC UA needs `certificate`, `key` and `trusted`")
        for name, path in files.items():
            if path is not None and not (path.is_dir() if name == "trusted" else path.is_file()):
                raise BadInput(f"opcua.{name}", f"{path} is not a {'folder' if name == 'trusted' else 'file'}")
        return self.model_copy(update={name: path.absolute() for name, path in files.items() if path is not None})


class Mqtt(_Published):
    """The broker, and the root topic of the machine."""

    host: Host
    port: int | None = Field(default=None, ge=1, le=65535)  # None: 8883 with TLS, 1883 without
    tls: bool = True  # False only for a broker on this computer, or with `trusted_network`
    authority: Path | None = None  # PEM, issuer of the broker's certificate; None: those that this computer trusts
    certificate: Path | None = None  # PEM, of this client, if the broker requires one
    key: Path | None = None  # PEM, without a password
    user: Annotated[str, StringConstraints(min_length=1, max_length=200)] | None = None
    password_file: Path | None = None
    topic: TopicPrefix = "sweepid"  # the machine's topics are below TOPIC/MACHINE
    keepalive: int = Field(default=15, ge=5, le=3600)  # s; the broker publishes the last will after 1.5 times this

    @property
    def connects_at(self) -> int:
        """The port."""
        return self.port or (8883 if self.tls else 1883)

    def checked(self, *, trusted_network: bool) -> Self:
        """With absolute paths. BadInput if the settings are unusable or unsafe."""
        _installed("mqtt", "aiomqtt")
        if not self.tls:
            if not (trusted_network or is_loopback(self.host)):
                raise BadInput(
                    "mqtt.tls",
                    f"{self.host!r} is not this computer, and without TLS others can read and change the messages; set "
                    "`tls: true`, or `trusted_network: true` where something else protects that network",
                )
            for name in ("authority", "certificate", "key"):
                if getattr(self, name) is not None:
                    raise BadInput(f"mqtt.{name}", "is set, but `tls` is false")
        if (self.certificate is None) != (self.key is None):
            missing = "key" if self.key is None else "certificate"
            raise BadInput(f"mqtt.{missing}", "is missing: a client certificate needs `certificate` and `key`")
        if self.password_file is not None and self.user is None:
            raise BadInput("mqtt.user", "is missing: `password_file` is set")
        files = {"authority": self.authority, "certificate": self.certificate, "key": self.key}
        files["password_file"] = self.password_file
        for name, path in files.items():
            if path is not None and not path.is_file():
                raise BadInput(f"mqtt.{name}", f"{path} is not a file")
        return self.model_copy(update={name: path.absolute() for name, path in files.items() if path is not None})


def _installed(extra: str, module: str) -> None:
    if find_spec(module) is None:
        raise BadInput(extra, f"needs an extra that is not installed: pip install 'sweepid[{extra}]'")
