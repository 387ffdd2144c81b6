"""Settings of the service: ``config/service.yaml``, overridden by the environment (``SWEEPID_DATA_DIR`` ...).

First those of other systems (identity provider, object store, workers, OPC UA, MQTT, traces), then all of them. Pure
but for the checks, which look at the files that are named.
"""

import ssl
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from ipaddress import ip_address, ip_network
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, IPvAnyNetwork, StringConstraints, ValidationError
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from service import BadInput
from service.model.configuration import bad_field, read_yaml

AUDIT_HEADS = "audit-heads.txt"  # default name, in the data directory


def is_loopback(host: str) -> bool:
    """Whether this name always means the local computer."""
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:  # a name may resolve to any address
        return False


def checked_address(address: str) -> str:
    """An https address; http only for this computer. ValueError for any other."""
    parts = urlsplit(address)
    if parts.scheme != "https" and not (parts.scheme == "http" and is_loopback(parts.hostname or "")):
        raise ValueError("is not an https address (http only of this computer, 127.0.0.1, ::1 or localhost)")
    if not parts.hostname or parts.username is not None or parts.query or parts.fragment:
        raise ValueError("is not an address of host and path alone")
    return address


Address = Annotated[str, StringConstraints(max_length=500), AfterValidator(checked_address)]
Word = Annotated[str, StringConstraints(min_length=1, max_length=200)]
PeerName = Annotated[str, StringConstraints(min_length=1, max_length=253)]
HostName = Annotated[str, StringConstraints(to_lower=True, pattern=r"^([A-Za-z0-9_.-]+|[0-9A-Fa-f:.]+)$")]
FileName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")]  # without its ending
MachineName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]{0,63}$")]
Origin = Annotated[str, StringConstraints(to_lower=True, pattern=r"^https?://[^/\s*]+$")]
TopicPrefix = Annotated[str, StringConstraints(pattern=r"^[^/+#$\x00][^+#\x00]{0,199}$")]


class _Other(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class IdentityProvider(_Other):
    """Settings given by its administrator, and the role of each of its groups."""

    issuer: Address  # exactly as in its metadata, which are below .well-known/openid-configuration
    client_id: Word
    client_secret_file: Path | None = None  # None: a public client, protected by PKCE only
    scopes: tuple[Word, ...] = ("openid", "profile")
    name_claim: Word = "preferred_username"  # source of the name of a new person
    groups_claim: Word = "groups"
    roles: dict[Word, Literal["viewer", "operator", "engineer", "admin"]] = Field(min_length=1)  # by group
    label: Annotated[str, StringConstraints(min_length=1, max_length=60)] = "Log in with the company's account"
    page: Address | None = None  # address of the operator page in browsers, registered there; None: on this computer


@dataclass(frozen=True, slots=True)
class StoreAddress:
    """Address without any secret: jobs carry it to workers, which read the key file (or their environment)."""

    protocol: Literal["file", "s3"]
    root: str  # absolute path, or bucket/prefix
    endpoint: str | None = None  # None: Amazon's
    key_file: Path | None = None  # None: the rules of AWS's own programs
    wait: float = 60.0  # s, longest wait for an answer

    def key(self, sha256: str) -> str:
        """The name of a recording's object below `root`; it depends only on the content."""
        return f"{self.root}/{sha256[:2]}/{sha256}.parquet"

    def shown(self, sha256: str) -> str:
        """The address of the object for display."""
        return f"{self.protocol}://{self.key(sha256)}"


def store_address(url: str, endpoint: str | None, key_file: Path | None, wait: float) -> StoreAddress:
    """BadInput for a URL that names neither a folder nor a bucket."""
    parts, setting = urlsplit(url), "recordings_url"
    if parts.username is not None or parts.password is not None or parts.query or parts.fragment:
        reason = "must contain only bucket and folder; a key belongs in `recordings_key_file` or the environment"
        raise BadInput(setting, reason)
    path = str(PurePosixPath(parts.path or "/"))
    if ".." in PurePosixPath(path).parts:
        raise BadInput(setting, f"{url} has .. in it")
    if parts.scheme == "file" and not parts.netloc and len(path) > 1:
        if endpoint is not None or key_file is not None:
            raise BadInput(setting, f"{url} is a folder, which has neither endpoint nor key file")
        return StoreAddress("file", path, wait=wait)
    if parts.scheme == "s3" and parts.netloc:
        root = (parts.netloc + path).rstrip("/")
        return StoreAddress("s3", root, endpoint, None if key_file is None else key_file.absolute(), wait)
    raise BadInput(setting, f"{url} is neither s3://BUCKET/PREFIX nor file:///FOLDER")


@dataclass(frozen=True, slots=True)
class Certificates:
    """PEM files; the key has no password. Every certificate of `authority` is accepted, with any name."""

    authority: Path
    certificate: Path
    key: Path


@dataclass(frozen=True, slots=True)
class Cluster:
    """A Dask scheduler whose workers execute the jobs. `scheduler`: its address in Dask's notation.

    A client of it can run any code on its workers, and it can return any answer. So beyond this computer both sides
    need a certificate of one authority (mutual TLS); `certificates` is None only on this computer.
    """

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
    _check_certificate("dask_certificate", certificate, key, authority)
    return Cluster(scheduler, Certificates(authority.absolute(), certificate.absolute(), key.absolute()))


class OpcUa(_Other):
    """The server: clients can read and subscribe, but not write."""

    host: PeerName = "127.0.0.1"
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
        folder = {} if self.trusted is None else {"trusted": self.trusted.absolute()}
        if self.trusted is not None and not self.trusted.is_dir():
            raise BadInput("opcua.trusted", f"{self.trusted} is not a folder")
        own = _files("opcua", {"certificate": self.certificate, "key": self.key})
        return self.model_copy(update=own | folder)


class Mqtt(_Other):
    """The broker, and the root topic of the machine."""

    host: PeerName
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
        names = ("authority", "certificate", "key", "password_file")
        return self.model_copy(update=_files("mqtt", {name: getattr(self, name) for name in names}))


class Telemetry(_Other):
    """Destination of spans, by OTLP over HTTP (protobuf)."""

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
        return self.model_copy(update=_files("otel", {"authority": self.authority}))


def _installed(extra: str, module: str, place: str | None = None) -> None:
    if find_spec(module) is None:
        raise BadInput(place or extra, f"needs an extra that is not installed: pip install 'sweepid[{extra}]'")


def _files(place: str, paths: Mapping[str, Path | None]) -> dict[str, Path]:
    """The paths that are given, made absolute. BadInput for one that is not a file."""
    given = {name: path for name, path in paths.items() if path is not None}
    for name, path in given.items():
        if not path.is_file():
            raise BadInput(f"{place}.{name}", f"{path} is not a file")
    return {name: path.absolute() for name, path in given.items()}


def _check_certificate(setting: str, certificate: Path, key: Path, authority: Path | None = None) -> None:
    """BadInput for a file that is unreadable, no PEM or has a password, or a wrong key."""
    try:
        if authority is None:
            context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        else:
            context = ssl.create_default_context(cafile=str(authority))
        context.load_cert_chain(certificate, key, password=lambda: "")  # otherwise it would ask at the terminal
    except OSError as error:
        files = " and ".join(str(path) for path in (authority, certificate, key) if path is not None)
        raise BadInput(setting, f"{files} cannot be used: {error.strerror or error}") from None


class Settings(BaseSettings):
    """All settings that differ between two installations. Paths are relative to the working directory."""

    model_config = SettingsConfigDict(env_prefix="SWEEPID_", frozen=True, extra="forbid", allow_inf_nan=False)

    data_dir: Path = Path("var")  # database and recordings
    database_url: str | None = None  # None: SQLite in the data directory
    database_password_file: Path | None = None  # of the PostgreSQL user; None: libpq's PGPASSFILE, or no password
    recordings_url: str | None = None  # s3://bucket/prefix or file:///shared/folder; None: only in the data directory
    recordings_endpoint: Origin | None = None  # of an S3-compatible store; None: Amazon's
    recordings_key_file: Path | None = None  # as ~/.aws/credentials; None: the environment, as for AWS's own programs
    recordings_cache: int = Field(default=10 * 2**30, ge=0)  # bytes of moved recordings kept here, the newest ones
    recordings_retry: float = Field(
        default=300.0, gt=0, le=86400
    )  # s, longest time between two attempts to reach the store
    recordings_wait: float = Field(default=60.0, gt=0, le=600)  # s, longest wait for an answer of the store
    machine_name: MachineName = "machine"  # of the cell's machine; unique in a shared database
    no_machine: bool = False  # True: own no machine, only show the plant; no drive, no lease, no change
    drive: Path = Path("config/drives/virtual-max100.yaml")  # profile of the machine
    robot: FileName | None = None  # of `robots_dir`: the robot of the machine; None: the only one that fits the drives
    cell: FileName | None = None  # of `cells_dir`: the cell of the machine; None: the only one that fits the robot
    robots_dir: Path = Path("config/robots")
    cells_dir: Path = Path("config/cells")
    host: str = "127.0.0.1"
    allowed_hosts: tuple[HostName, ...] = ()  # accepted host names in addition to this computer's own; see `answers_to`
    login: bool = False  # False: every caller is "local" with all rights
    wrong_keys: int = Field(default=10, ge=1, le=10000)  # limit per address and minute
    session_idle: float = Field(default=8 * 3600.0, ge=60)  # s without a request; then a person must log in again
    session_longest: float = Field(default=24 * 3600.0, ge=60)  # s after the login, also with requests
    audit_heads: Path | None = None  # file for the heads of the audit, best elsewhere; None: in the data directory
    oidc: IdentityProvider | None = None  # OpenID Connect provider, in addition to the passwords here
    tls_certificate: Path | None = None  # PEM with its chain; for service and stop process
    tls_key: Path | None = None  # PEM, without a password
    cors_origins: tuple[Origin, ...] = ()  # origins whose pages may call the API with a key, e.g. https://cell7.example
    trusted_network: bool = False  # allows access by other computers without login: the network protects the service
    behind_proxy: bool = False  # a proxy terminates TLS; X-Forwarded-For and -Proto of `trusted_proxies` are used
    trusted_proxies: tuple[IPvAnyNetwork, ...] = Field(
        default=(ip_network("127.0.0.1"), ip_network("::1")), min_length=1
    )
    approval: bool = False  # True: an engineer must approve a plan before its start; with login another person
    approval_valid: float = Field(default=8.0, gt=0, le=720)  # h, validity of an approval
    port: int = Field(default=8642, ge=0, le=65535)  # 0: any free port
    stop_port: int | None = Field(default=None, ge=0, le=65535)  # of the stop process; None: one above `port`
    dask_scheduler: str | None = None  # e.g. tls://host:8786; None: one local worker process
    dask_authority: Path | None = None  # PEM: issuer of the certificates of scheduler, workers and this service
    dask_certificate: Path | None = None  # PEM, of this service
    dask_key: Path | None = None  # PEM, without a password
    opcua: OpcUa | None = None  # OPC UA server, read-only: machine, campaign, estimate, loads
    otel: Telemetry | None = None  # OpenTelemetry collector that receives traces
    mqtt: Mqtt | None = None  # broker that receives state and events
    least_free_disk: int = Field(default=256 * 2**20, ge=0)  # bytes; with less, the service is not ready
    lease_time: float = Field(default=6.0, ge=0.5, le=60.0)  # s without a sign of life; then the machine is free again
    pose_tolerance: float = Field(default=2e-3, gt=0)  # rad (m), actual against planned pose at the start of a sweep
    virtual_machine: bool = False  # True only if no real machine can move: a diagnosis may then measure unattended
    remeasure_days: float = Field(default=31.0, gt=0, le=3660)  # then the next measurement of a robot is due
    fleet_false_alarms: float = Field(default=0.01, gt=0, le=0.5)  # probability of at least one in `fleet_campaigns`
    fleet_campaigns: int = Field(default=12, ge=3, le=240)  # newest campaigns of each robot in the control chart
    keep_samples_days: float | None = Field(default=None, ge=1)  # of campaigns that are over; None: forever. Applied
    keep_spectra_days: float | None = Field(default=None, ge=1)  # only by `sweepid data prune`
    keep_estimates_days: float | None = Field(default=None, ge=1)  # revisions before the newest of each campaign
    live_rate: float = Field(default=100.0, gt=0)  # Hz, rate of the decimated samples for subscribers
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = "INFO"

    @property
    def answers_to(self) -> tuple[str, ...]:
        """Accepted host names of requests; empty: all.

        All are accepted if the service listens beyond this computer and `allowed_hosts` is empty. A web page can then
        reach it through an operator's browser if the page's own host name resolves to this address (DNS rebinding).
        """
        own = ("127.0.0.1", "localhost", "::1")
        return () if self.host not in own and not self.allowed_hosts else (*own, self.host, *self.allowed_hosts)

    def check_reach(self) -> None:
        """BadInput if other computers can reach a service without login."""
        if self.trusted_network or is_loopback(self.host):
            return
        if self.login:
            if self.tls is None and not self.behind_proxy:
                raise BadInput(
                    "host",
                    f"{self.host!r} is reachable from other computers, and without TLS passwords and "
                    "keys can be read on the network; set `tls_certificate` and `tls_key`, or "
                    "`behind_proxy: true` (SWEEPID_BEHIND_PROXY=true) if a proxy terminates TLS",
                )
            return
        raise BadInput(
            "host",
            f"{self.host!r} is reachable from other computers, and without `login: true` every client "
            "may move the machine; set `login: true` (SWEEPID_LOGIN=true) and add people with "
            "`sweepid people add-user`, or `trusted_network: true` (SWEEPID_TRUSTED_NETWORK=true) if "
            "only trusted clients can connect",
        )

    @property
    def tls(self) -> tuple[Path, Path] | None:
        """Certificate and key; None: HTTP without TLS."""
        certificate, key = self.tls_certificate, self.tls_key
        return None if certificate is None or key is None else (certificate, key)

    def check_tls(self) -> None:
        """BadInput if the certificate or the key is missing, or if they cannot be used."""
        if (self.tls_certificate is None) != (self.tls_key is None):
            missing = "tls_key" if self.tls_key is None else "tls_certificate"
            raise BadInput(missing, "is missing: TLS needs `tls_certificate` and `tls_key`")
        if self.tls is not None:
            _check_certificate("tls_certificate", *self.tls)

    def check_oidc(self) -> None:
        """BadInput if the settings of the identity provider do not allow a login."""
        if self.oidc is None:
            return
        if not self.login:
            raise BadInput("oidc", "requires `login: true` (SWEEPID_LOGIN=true)")
        if self.oidc.page is None and (self.behind_proxy or not is_loopback(self.host)):
            raise BadInput(
                "oidc.page",
                "is missing: set the address of the operator page as browsers see it, for example "
                "https://cell7.example/, and register it at the provider as redirect URI",
            )

    def check(self) -> None:
        """BadInput for settings that are unusable or unsafe, alone or together; looks at the files that they name."""
        self.check_tls()
        self.check_reach()
        self.check_oidc()
        _ = self.recordings_store, self.cluster, self.traces
        if self.opcua is not None:
            self.opcua.checked()
        if self.mqtt is not None:
            self.mqtt.checked(trusted_network=self.trusted_network)

    @property
    def recordings_store(self) -> StoreAddress | None:
        """Destination of recordings after their sweep; None: they are not moved. BadInput if it is invalid."""
        endpoint, key_file = self.recordings_endpoint, self.recordings_key_file
        if self.recordings_url is None:
            if endpoint is not None or key_file is not None:
                raise BadInput("recordings_url", "is missing: endpoint and key file of a store are set without it")
            return None
        return store_address(self.recordings_url, endpoint, key_file, self.recordings_wait)

    @property
    def cluster(self) -> Cluster | None:
        """The cluster whose workers execute the jobs; None: one local process. BadInput if unusable or unsafe."""
        files = (self.dask_authority, self.dask_certificate, self.dask_key)
        if self.dask_scheduler is None:
            if any(path is not None for path in files):
                raise BadInput("dask_scheduler", "is missing: certificates for it are set")
            return None
        _installed("dask", "distributed", place="dask_scheduler")
        return cluster_at(self.dask_scheduler, *files)

    @property
    def traces(self) -> Telemetry | None:
        """Destination of traces, with absolute paths; None: no traces. BadInput if unusable or unsafe."""
        return None if self.otel is None else self.otel.checked(trusted_network=self.trusted_network)

    @property
    def stop_listens_at(self) -> int:
        """The port of the stop process; 0: any free port, also if `port` is 0."""
        if self.stop_port is not None:
            return self.stop_port
        return self.port + 1 if 0 < self.port < 65535 else 0

    @property
    def url(self) -> str:
        """The database's SQLAlchemy URL."""
        return self.database_url or f"sqlite:///{self.data_dir.absolute() / 'sweepid.sqlite'}"

    @property
    def audit_heads_file(self) -> Path:
        """File to which the heads of the audit are added."""
        return self.audit_heads or self.data_dir / AUDIT_HEADS

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """The environment has priority over the file, which `load_settings` passes."""
        return env_settings, init_settings


def load_settings(path: Path | None = None) -> Settings:
    """Settings of a YAML file (None: ``config/service.yaml`` if it exists). BadInput names file, field and reason."""
    place = path or Path("config/service.yaml")
    if path is not None or place.exists():
        return read_yaml(place, Settings)
    try:
        return Settings()
    except ValidationError as error:
        raise bad_field("environment SWEEPID_", error) from None
