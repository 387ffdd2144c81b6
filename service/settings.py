"""Settings of the service: ``config/service.yaml``, overridden by the environment (``SWEEPID_DATA_DIR`` ...)."""

import ssl
from ipaddress import ip_address, ip_network
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, IPvAnyNetwork, StringConstraints, ValidationError
from pydantic_settings import BaseSettings, PydanticBaseSettingsSource, SettingsConfigDict

from service.configuration import bad_field, read_yaml
from service.errors import BadInput

_LOOPBACK = ("127.0.0.1", "localhost", "::1")
_THIS_COMPUTER = (ip_network("127.0.0.1"), ip_network("::1"))

HostName = Annotated[str, StringConstraints(to_lower=True, pattern=r"^([A-Za-z0-9_.-]+|[0-9A-Fa-f:.]+)$")]


Origin = Annotated[str, StringConstraints(to_lower=True, pattern=r"^https?://[^/\s*]+$")]


class Settings(BaseSettings):
    """Everything that differs between two installations. Paths are relative to the working directory."""

    model_config = SettingsConfigDict(env_prefix="SWEEPID_", frozen=True, extra="forbid", allow_inf_nan=False)

    data_dir: Path = Path("var")  # database and recordings
    database_url: str | None = None  # None: SQLite in the data directory
    drive: Path = Path("config/drives/virtual-max100.yaml")  # profile of the machine
    robots_dir: Path = Path("config/robots")
    cells_dir: Path = Path("config/cells")
    host: str = "127.0.0.1"
    allowed_hosts: tuple[HostName, ...] = ()  # names it answers to besides this computer's own; see `answers_to`
    login: bool = False  # who is it? False: whoever reaches the service is "local" with all rights
    wrong_keys: int = Field(default=10, ge=1, le=10000)  # that an address may show in a minute
    session_idle: float = Field(default=8 * 3600.0, ge=60)  # s without a request until a person logs in again
    session_longest: float = Field(default=24 * 3600.0, ge=60)  # s, the same in any case
    tls_certificate: Path | None = None  # PEM, with those above it; of service and stop process
    tls_key: Path | None = None  # PEM, without a password
    cors_origins: tuple[Origin, ...] = ()  # whose pages may call the API with a key, e.g. https://cell7.example
    trusted_network: bool = False  # without login, beyond this computer: something else lets only trusted ones in
    behind_proxy: bool = False  # a proxy ends TLS; X-Forwarded-For and -Proto are believed of `trusted_proxies`
    trusted_proxies: tuple[IPvAnyNetwork, ...] = Field(default=_THIS_COMPUTER, min_length=1)
    approval: bool = False  # True: an engineer approves a plan before a campaign of it starts, with login another one
    approval_valid: float = Field(default=8.0, gt=0, le=720)  # h for which an approval holds
    port: int = Field(default=8642, ge=0, le=65535)  # 0: any free port
    stop_port: int | None = Field(default=None, ge=0, le=65535)  # of the stop process; None: one above `port`
    dask_scheduler: str | None = None  # e.g. tcp://host:8786; None: one worker process of our own
    least_free_disk: int = Field(default=256 * 2**20, ge=0)  # bytes; with less, the service is not ready
    lease_time: float = Field(default=6.0, ge=0.5, le=60.0)  # s without a sign of life until the machine is free again
    pose_tolerance: float = Field(default=2e-3, gt=0)  # rad (m), actual against planned pose at the start of a sweep
    virtual_machine: bool = False  # True only where nothing real can move: a diagnosis may then measure unattended
    live_rate: float = Field(default=100.0, gt=0)  # Hz, thinned samples for subscribers
    log_level: Literal["DEBUG", "INFO", "WARNING", "ERROR"] = "INFO"

    @property
    def answers_to(self) -> tuple[str, ...]:
        """Host names in requests that are meant for this service; empty: any.

        Any only where it listens beyond this computer and nobody said under which names: then a web page anywhere can
        reach it through an operator's browser by letting its own name point here (DNS rebinding).
        """
        if self.host not in _LOOPBACK and not self.allowed_hosts:
            return ()
        return (*_LOOPBACK, self.host, *self.allowed_hosts)

    def check_reach(self) -> None:
        """BadInput where others could reach a service that asks nobody who he is."""
        if self.trusted_network or _is_loopback(self.host):
            return
        if self.login:
            if self.tls is None and not self.behind_proxy:
                raise BadInput(
                    "host",
                    f"{self.host!r} is not this computer alone, and without TLS others can read passwords and keys; "
                    "set `tls_certificate` and `tls_key`, or, where a proxy before it ends TLS, `behind_proxy: true` "
                    "(SWEEPID_BEHIND_PROXY=true)",
                )
            return
        raise BadInput(
            "host",
            f"{self.host!r} is not this computer alone, and without `login: true` whoever reaches it may move the "
            "machine; set `login: true` (SWEEPID_LOGIN=true) and add people with `sweepid people add-user`, or, where "
            "something else lets only trusted ones in, `trusted_network: true` (SWEEPID_TRUSTED_NETWORK=true)",
        )

    @property
    def tls(self) -> tuple[Path, Path] | None:
        """Certificate and key; None: HTTP without TLS."""
        certificate, key = self.tls_certificate, self.tls_key
        return None if certificate is None or key is None else (certificate, key)

    def check_tls(self) -> None:
        """BadInput where one of certificate and key is missing, or the two cannot be used."""
        if (self.tls_certificate is None) != (self.tls_key is None):
            missing = "tls_key" if self.tls_key is None else "tls_certificate"
            raise BadInput(missing, "is missing: TLS needs `tls_certificate` and `tls_key`")
        if self.tls is not None:
            try:
                tls_context(*self.tls)
            except OSError as error:
                files = " and ".join(str(path) for path in self.tls)
                raise BadInput("tls_certificate", f"{files} cannot be used: {error.strerror or error}") from None

    @property
    def stop_listens_at(self) -> int:
        """The port of the stop process; 0: any free one, as where `port` is 0."""
        if self.stop_port is not None:
            return self.stop_port
        return self.port + 1 if 0 < self.port < 65535 else 0

    @property
    def url(self) -> str:
        """The database's SQLAlchemy URL."""
        return self.database_url or f"sqlite:///{self.data_dir.absolute() / 'sweepid.sqlite'}"

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """The environment stands above the file, which `load_settings` hands in."""
        return env_settings, init_settings


def tls_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """Of a server. OSError where a file cannot be read, is no PEM, needs a password, or the two do not fit."""
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(certificate, key, password=lambda: "")  # else it asks for one at the terminal
    return context


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:  # a name may lead anywhere
        return False


def load_settings(path: Path | None = None) -> Settings:
    """Settings of a YAML file (None: ``config/service.yaml`` if it is there); BadInput names file, field, reason."""
    place = path or Path("config/service.yaml")
    if path is not None or place.exists():
        return read_yaml(place, Settings)
    try:
        return Settings()
    except ValidationError as error:
        raise bad_field("environment SWEEPID_", error) from None
