"""Settings of the service: ``config/service.yaml``, overridden by the environment (``SWEEPID_DATA_DIR`` ...)."""

import ssl
from ipaddress import ip_network
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, IPvAnyNetwork, StringConstraints, ValidationError
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from service.model.configuration import bad_field, read_yaml
from service.model.errors import BadInput
from service.process.settings.identity_provider import IdentityProvider, is_loopback
from service.process.settings.object_store import StoreAddress, store_address
from service.process.settings.publishing import Mqtt, OpcUa
from service.process.settings.telemetry import Telemetry
from service.process.settings.workers import Cluster, cluster_at

AUDIT_HEADS = "audit-heads.txt"  # default name, in the data directory
_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_THIS_COMPUTER = (ip_network("127.0.0.1"), ip_network("::1"))

HostName = Annotated[str, StringConstraints(to_lower=True, pattern=r"^([A-Za-z0-9_.-]+|[0-9A-Fa-f:.]+)$")]


FileName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")]  # without its ending
MachineName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9 ._-]{0,63}$")]
Origin = Annotated[str, StringConstraints(to_lower=True, pattern=r"^https?://[^/\s*]+$")]


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
    trusted_proxies: tuple[IPvAnyNetwork, ...] = Field(default=_THIS_COMPUTER, min_length=1)
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
        if self.host not in _LOOPBACK and not self.allowed_hosts:
            return ()
        return (*_LOOPBACK, self.host, *self.allowed_hosts)

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
            try:
                tls_context(*self.tls)
            except OSError as error:
                files = " and ".join(str(path) for path in self.tls)
                raise BadInput("tls_certificate", f"{files} cannot be used: {error.strerror or error}") from None

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

    @property
    def recordings_store(self) -> StoreAddress | None:
        """Destination of recordings after their sweep; None: they are not moved. BadInput if it is invalid."""
        endpoint, key_file = self.recordings_endpoint, self.recordings_key_file
        if self.recordings_url is None:
            if endpoint is not None or key_file is not None:
                raise BadInput("recordings_url", "is missing: endpoint and key file of a store are set without it")
            return None
        return store_address(self.recordings_url, endpoint, key_file, self.recordings_wait)

    def check_recordings(self) -> None:
        """BadInput as `recordings_store`."""
        _ = self.recordings_store

    @property
    def cluster(self) -> Cluster | None:
        """The cluster whose workers execute the jobs; None: one local process. BadInput if unusable or unsafe."""
        files = (self.dask_authority, self.dask_certificate, self.dask_key)
        if self.dask_scheduler is None:
            if any(path is not None for path in files):
                raise BadInput("dask_scheduler", "is missing: certificates for it are set")
            return None
        return cluster_at(self.dask_scheduler, *files)

    def check_cluster(self) -> None:
        """BadInput as `cluster`."""
        _ = self.cluster

    def check_publishing(self) -> None:
        """BadInput if OPC UA, MQTT or the collector of traces is unusable or unsafe."""
        if self.opcua is not None:
            self.opcua.checked()
        if self.mqtt is not None:
            self.mqtt.checked(trusted_network=self.trusted_network)
        _ = self.traces

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


def tls_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """TLS context of a server. OSError for a file that is unreadable, no PEM or has a password, or a wrong key."""
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(certificate, key, password=lambda: "")  # otherwise it would ask at the terminal
    return context


def load_settings(path: Path | None = None) -> Settings:
    """Settings of a YAML file (None: ``config/service.yaml`` if it exists). BadInput names file, field and reason."""
    place = path or Path("config/service.yaml")
    if path is not None or place.exists():
        return read_yaml(place, Settings)
    try:
        return Settings()
    except ValidationError as error:
        raise bad_field("environment SWEEPID_", error) from None
